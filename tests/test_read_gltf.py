"""glTF: every way to give triangles, what is refused by name, and nothing from outside the file's folder."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from layerfix import load_mesh
from layerfix.errors import InputError
from layerfix.mesh.triangles import Mesh
from tests.making import box

CUBE = box([0, 0, 0], [10, 10, 10])
Y_UP = np.stack([CUBE.vertices[:, 0], CUBE.vertices[:, 2], -CUBE.vertices[:, 1]], axis=1) / 1000
KINDS = {"<f4": 5126, "<u1": 5121, "<i1": 5120, "<u2": 5123, "<i2": 5122, "<u4": 5125}


class Document:
    """A glTF document that grows by accessors; one buffer."""

    def __init__(self) -> None:
        self.binary = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{"byteLength": 0}],
        }

    def values(self, values: Any, kind: str = "<f4", stride: int = 0, **more: Any) -> int:
        """Another accessor; its number."""
        array = np.asarray(values, kind)
        width = array.shape[1] if array.ndim > 1 else 1
        rows = np.zeros((len(array), max(stride, width * array.itemsize)), np.uint8)
        rows[:, : width * array.itemsize] = np.ascontiguousarray(array).view(np.uint8).reshape(len(array), -1)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": rows.size}
        self.json["bufferViews"].append(view | ({"byteStride": stride} if stride else {}))
        self.binary += rows.tobytes() + bytes(-rows.size % 4)
        self.json["buffers"][0]["byteLength"] = len(self.binary)
        name = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[width]
        accessor = {
            "bufferView": len(self.json["bufferViews"]) - 1,
            "componentType": KINDS[kind],
            "count": len(array),
        }
        self.json["accessors"].append({**accessor, "type": name, **more})
        return len(self.json["accessors"]) - 1

    def mesh(self, *primitives: dict[str, Any], **more: Any) -> Document:
        self.json["meshes"].append({"primitives": list(primitives), **more})
        return self

    def glb(self) -> bytes:
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.binary), 0x004E4942) + self.binary
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def cube(points: Any = Y_UP) -> tuple[Document, dict[str, Any]]:
    """A document and the primitive of a cube in it."""
    document = Document()
    return document, {
        "attributes": {"POSITION": document.values(points)},
        "indices": document.values(CUBE.faces.reshape(-1), "<u2"),
    }


def plain(**more: Any) -> Document:
    document, primitive = cube()
    document.mesh(primitive)
    document.json.update(more)
    return document


def loaded(path: Path, data: bytes | Document) -> Mesh:
    path.write_bytes(data.glb() if isinstance(data, Document) else data)
    return load_mesh(path)


def is_the_cube(mesh: Mesh, *notes: str, times: float = 1) -> None:
    assert mesh.volume_mm3 == pytest.approx(1000 * times)
    assert mesh.notes == notes


def test_a_cube_stands_upright(tmp_path):
    """Metres, y up: millimetres, z up, facing outwards."""
    mesh = loaded(tmp_path / "a.glb", plain())
    is_the_cube(mesh)
    assert mesh.bounds_mm == pytest.approx(np.array([[0, 0, 0], [10, 10, 10]]))


@pytest.mark.parametrize("mode", [4, 5, 6])
@pytest.mark.parametrize("indexed", [True, False])
def test_triangles_strips_and_fans(tmp_path, mode, indexed):
    """Six quads as triangles, as strips of four, as fans of four; with indices and without."""
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    order = {4: [0, 1, 2, 0, 2, 3], 5: [0, 1, 3, 2], 6: [0, 1, 2, 3]}[mode]
    document, primitives = Document(), []
    shared = document.values(Y_UP) if indexed else 0
    for quad in quads[:, order]:
        if indexed:
            primitives.append(
                {"attributes": {"POSITION": shared}, "indices": document.values(quad, "<u1"), "mode": mode}
            )
        else:
            primitives.append({"attributes": {"POSITION": document.values(Y_UP[quad])}, "mode": mode})
    is_the_cube(loaded(tmp_path / "a.glb", document.mesh(*primitives)))


def test_points_and_lines_are_left_out_with_a_note(tmp_path):
    """Alone they are no mesh, and the error says what there was."""
    document, primitive = cube()
    lines = {"attributes": primitive["attributes"], "mode": 1}
    mesh = loaded(tmp_path / "a.glb", document.mesh(primitive, lines))
    is_the_cube(mesh, "1 set of lines left out")
    document, primitive = cube()
    with pytest.raises(InputError, match=r"no triangles \(1 set of points left out\)"):
        loaded(tmp_path / "b.glb", document.mesh({"attributes": primitive["attributes"], "mode": 0}))


@pytest.mark.parametrize(
    ("node", "times"),
    [
        ({"scale": [-1, 1, 1]}, 1),
        ({"scale": [2, 2, 2]}, 8),
        ({"rotation": [0, 0.6, 0, 0.8], "translation": [0.1, 0.2, 0.3]}, 1),
        ({"matrix": [0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0.5, 0.5, 0.5, 1]}, 1),
    ],
)
def test_nodes_place_meshes(tmp_path, node, times):
    """Also by mirroring, and below another node; a mesh that two nodes show is there twice."""
    document = plain(nodes=[{"children": [1, 2]}, {"mesh": 0, **node}, {"mesh": 0, "translation": [0.9, 0.9, 0.9]}])
    is_the_cube(loaded(tmp_path / "a.glb", document), times=times + 1)


def test_instances(tmp_path):
    """EXT_mesh_gpu_instancing: places, turns and sizes; without places there is one at each turn."""
    document, primitive = cube()
    where = document.values([[0, 0, 0], [0.02, 0, 0], [0.04, 0, 0]])
    size = document.values([[1, 1, 1], [1, 1, 1], [2, 2, -2]])
    document.mesh(primitive)
    attributes = {"TRANSLATION": where, "SCALE": size}
    document.json["nodes"] = [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}]
    document.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    mesh = loaded(tmp_path / "a.glb", document)
    is_the_cube(mesh, times=10)
    assert mesh.size_mm == pytest.approx((60, 30, 20))


def test_quantized_positions(tmp_path):
    """KHR_mesh_quantization: normalized shorts, four bytes apart from each other's end."""
    document = Document()
    position = document.values((Y_UP * 100 * 32767).round(), "<i2", stride=8, normalized=True)
    document.mesh({"attributes": {"POSITION": position}, "indices": document.values(CUBE.faces.reshape(-1), "<u4")})
    document.json["nodes"] = [{"mesh": 0, "scale": [0.01] * 3}]
    document.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    is_the_cube(loaded(tmp_path / "a.glb", document))


def test_sparse_accessors(tmp_path):
    """Zeros but for the vertices that are listed."""
    document, primitive = cube()
    far = np.flatnonzero(Y_UP.any(axis=1))
    places, points = document.values(far, "<u1"), document.values(Y_UP[far])
    sparse = {
        "count": len(far),
        "indices": {"bufferView": places, "componentType": 5121},
        "values": {"bufferView": points},
    }
    document.json["accessors"].append({"componentType": 5126, "count": 8, "type": "VEC3", "sparse": sparse})
    primitive["attributes"] = {"POSITION": len(document.json["accessors"]) - 1}
    is_the_cube(loaded(tmp_path / "a.glb", document.mesh(primitive)))


def test_morph_targets_and_skins(tmp_path):
    """Weights move vertices; joints do, by their own matrices and not by the node's."""
    document, primitive = cube()
    primitive["targets"] = [{"POSITION": document.values(Y_UP)}, {"POSITION": document.values(Y_UP * 7)}]
    is_the_cube(loaded(tmp_path / "a.glb", document.mesh(primitive, weights=[1.0, 0.0])), times=8)
    document, primitive = cube()
    primitive["attributes"] |= {
        "JOINTS_0": document.values(np.zeros((8, 4)), "<u1"),
        "WEIGHTS_0": document.values([[1.0, 0, 0, 0]] * 8),
    }
    bind = np.eye(4)
    bind[3, :3] = [0, 0, 1]
    document.json["skins"] = [{"joints": [1], "inverseBindMatrices": document.values(bind.reshape(1, 16))}]
    document.json["nodes"] = [{"mesh": 0, "skin": 0, "translation": [5, 5, 5]}, {"scale": [3, 3, 3]}]
    document.json["scenes"] = [{"nodes": [0, 1]}]
    mesh = loaded(tmp_path / "b.glb", document.mesh(primitive))
    is_the_cube(mesh, times=27)
    assert mesh.bounds_mm[0] == pytest.approx([0, -3000, 0])


def test_other_scenes_are_told(tmp_path):
    """The document says which one is shown."""
    document = plain(nodes=[{"mesh": 0}, {"mesh": 0}], scenes=[{"nodes": [1]}, {"nodes": [0]}], scene=1)
    is_the_cube(loaded(tmp_path / "a.glb", document), "1 node of another scene left out")


@pytest.mark.parametrize("required", [False, True])
def test_hidden_nodes_are_left_out_and_told(tmp_path, required):
    """KHR_node_visibility: with all that hangs from them. `visible` is true where nothing is said."""
    hidden, shown = ({"extensions": {"KHR_node_visibility": {"visible": v}}} for v in (False, True))
    nodes = [
        {"mesh": 0, **shown},
        {"mesh": 0, "translation": [9, 0, 0], "children": [2], **hidden},
        {"mesh": 0, **shown},
        {"children": [4], **hidden},
        {"mesh": 0, "extensions": {"KHR_node_visibility": {}}},
    ]
    more = {"extensionsRequired": ["KHR_node_visibility"]} if required else {}
    document = plain(nodes=nodes, scenes=[{"nodes": [0, 1, 3]}], **more)
    is_the_cube(loaded(tmp_path / "a.glb", document), "3 hidden nodes left out")
    document = plain(nodes=nodes[1:3], scenes=[{"nodes": [0]}]) if not required else None
    if document is not None:
        document.json["nodes"][0]["children"] = [1]
        with pytest.raises(InputError, match=r"has no triangles \(2 hidden nodes left out\)"):
            loaded(tmp_path / "b.glb", document)


# Refused by name ------------------------------------------------------------------------------------------------


def test_compressed_geometry_is_refused_by_name(tmp_path):
    """Draco and meshopt; a Draco mesh that has plain data beside it is read."""
    document, primitive = cube()
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    is_the_cube(loaded(tmp_path / "a.glb", document.mesh(primitive)))
    del document.json["accessors"][0]["bufferView"]
    document.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    with pytest.raises(InputError, match=r"a\.glb.*compressed with Draco \(KHR_draco_mesh_compression\)"):
        loaded(tmp_path / "a.glb", document)
    document = plain()
    document.json["buffers"].append({"byteLength": 96})
    document.json["bufferViews"][0] |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {"buffer": 0}}}
    with pytest.raises(InputError, match=r"b\.glb.*compressed with meshopt \(EXT_meshopt_compression\)"):
        loaded(tmp_path / "b.glb", document)


def test_a_required_extension_that_is_unknown_is_refused(tmp_path):
    """Those that change only looks are not."""
    is_the_cube(
        loaded(tmp_path / "a.glb", plain(extensionsRequired=["KHR_materials_unlit", "KHR_texture_transform"]))
    )
    with pytest.raises(InputError, match="requires the extension FOO_shapes"):
        loaded(tmp_path / "a.glb", plain(extensionsRequired=["FOO_shapes"]))


@pytest.mark.parametrize(
    "uri",
    [
        "../x.bin",
        "/etc/hostname",
        "http://example.org/x.bin",
        "file:///etc/hostname",
        "%2e%2e/x.bin",
        "sub/../../x.bin",
        "..\\x.bin",
        "C:\\x.bin",
        "//server/x.bin",
        "link.bin",
    ],
)
def test_nothing_is_read_from_outside_the_folder(tmp_path, uri):
    """Neither by paths that climb, nor addresses, nor links."""
    document = plain()
    folder = tmp_path / "in"
    folder.mkdir()
    (tmp_path / "x.bin").write_bytes(document.binary)
    (folder / "link.bin").symlink_to(tmp_path / "x.bin")
    document.json["buffers"][0]["uri"] = uri
    (folder / "a.gltf").write_text(json.dumps(document.json))
    with pytest.raises(InputError, match=r"a\.gltf.*outside the file's folder"):
        load_mesh(folder / "a.gltf")


def test_buffers_beside_the_file_and_in_it(tmp_path):
    """With a space in the name, and as data; a missing one is named."""
    document = plain()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "the data.bin").write_bytes(document.binary)
    data = "data:application/octet-stream;base64," + base64.b64encode(document.binary).decode()
    for uri in ("sub/the%20data.bin", data):
        document.json["buffers"][0]["uri"] = uri
        (tmp_path / "a.gltf").write_text(json.dumps(document.json))
        is_the_cube(load_mesh(tmp_path / "a.gltf"))
    document.json["buffers"][0]["uri"] = "none.bin"
    (tmp_path / "a.gltf").write_text(json.dumps(document.json))
    with pytest.raises(InputError, match=r"its file 'none\.bin' is missing"):
        load_mesh(tmp_path / "a.gltf")


def test_a_glb_cut_short_anywhere(tmp_path):
    """It says so; bytes after its end are told."""
    data = plain().glb()
    for stop in [*range(4, len(data), 37), len(data) - 1]:
        with pytest.raises(InputError, match=r"a\.glb.*cut short"):
            loaded(tmp_path / "a.glb", data[:stop])
    is_the_cube(loaded(tmp_path / "a.glb", data + b"end"), "3 bytes after the end left out")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scenes": [{}]}, "no triangles"),
        ({"meshes": []}, "does not add up"),
        ({"nodes": 7}, "'nodes' is no list"),
        ({"nodes": [{"mesh": "a"}]}, "does not add up"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "node 0 is used twice"),
        ({"nodes": [{"children": [7]}]}, "node 7 is missing"),
        ({"accessors": [{}, {}]}, "does not add up"),
        ({"asset": {"version": "1.0"}}, "only version 2"),
        ({"buffers": []}, "does not add up"),
    ],
)
def test_a_document_that_does_not_add_up(tmp_path, changes, words):
    """Whatever is in it, one sentence."""
    with pytest.raises(InputError, match=rf"a\.glb: .*{words}") as caught:
        loaded(tmp_path / "a.glb", plain(**changes))
    assert "\n" not in str(caught.value)


def test_numbers_made_to_hurt(tmp_path):
    """A thousand million zeros, a view past its buffer, indices past the vertices, JSON of brackets."""
    for change, words in (
        ({"count": 10**9, "bufferView": None}, "1000000000 elements and no data"),
        ({"count": 10**9}, "cut short"),
        ({"byteOffset": -4}, "does not add up"),
        ({"count": 3}, "vertex 7 of 3"),
    ):
        document = plain()
        document.json["accessors"][0] |= change
        if "bufferView" in change:
            del document.json["accessors"][0]["bufferView"]
        with pytest.raises(InputError, match=words):
            loaded(tmp_path / "a.glb", document)
    with pytest.raises(InputError, match="JSON is broken"):
        loaded(tmp_path / "a.gltf", b'{"asset":' + b"[" * 100_000)
