"""glTF 2.0, as GLB or as JSON with its buffers beside it. Specification: Khronos glTF 2.0 and its extensions.

Triangles, strips and fans, quantized positions, instances, morph weights and poses of skeletons are read; compressed
geometry (Draco, meshopt) is refused by name, points and lines are left out with a note. Our own reader, because
trimesh's (4.12, 5.2) loses fans, ignores instances and extensions that a file requires, and reads any file of the
machine that a buffer's address names. y is up in glTF, z in layerfix.
"""

from __future__ import annotations

import base64
import json
import struct
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.bodies import NO_COLOUR, Bodies, bodies_of, of_corners
from layerfix.mesh.gltf_buffers import Buffers
from layerfix.mesh.reading import MOST_TRIANGLES, Read, several, unreadable
from layerfix.mesh.strips import fan_to_triangles, strips_to_triangles
from layerfix.mesh.triangles import Mesh

MAGIC = b"glTF"
JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
INSTANCING, VISIBILITY = "EXT_mesh_gpu_instancing", "KHR_node_visibility"
READ = (
    INSTANCING,
    VISIBILITY,
    "KHR_mesh_quantization",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
)
# Extensions that change how a part looks, and not where it is: a file may require them.
LOOKS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "EXT_lights_", "KHR_xmp", "MSFT_texture_",
         "KHR_animation_", "MSFT_packing_", "EXT_materials_", "ADOBE_materials_", "KHR_audio")  # fmt: skip
TO_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
MOST_USES = 1_000_000  # nodes and instances

Shape = tuple[NDArray[np.float64], NDArray[np.int64]]


class Placed(NamedTuple):
    """Triangles of one primitive in their place: those with the same `body` are of one node, or instance of it."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    body: int
    name: str
    colours: NDArray[np.int32]


def recognises(head: bytes, size: int) -> bool:
    """GLB's magic word, or JSON with an "asset"."""
    return head[:4] == MAGIC or (head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{" and b'"asset"' in head)


def read(path: Path) -> Read:
    """Every mesh of the file's scene, in its place. Raises InputError for what cannot be read as such."""
    with reading(path):
        data = path.read_bytes()
    document, binary, notes = _document(path, data)
    try:
        scene = _Scene(path, document, binary)
        vertices, faces, bodies = scene.shape()
    except (TypeError, AttributeError, LookupError, ValueError) as problem:
        # A document of the wrong shape: every value of it may be of any type.
        reason = " ".join(str(problem).split())[:120] or type(problem).__name__
        raise unreadable(path, "glTF", f"its document does not add up ({reason})") from problem
    return Read(Mesh(vertices, faces.astype(np.int32), path.name, (*notes, *scene.notes()), bodies=bodies), "m")


def _document(path: Path, data: bytes) -> tuple[dict[str, Any], bytes | None, list[str]]:
    """(the JSON, the binary chunk of a GLB, what was not read)."""
    notes: list[str] = []
    binary: bytes | None = None
    text = data
    if data[:4] == MAGIC:
        if len(data) < 20:
            raise unreadable(path, "glTF", f"cut short: {len(data)} bytes")
        version, length, json_length, kind = struct.unpack_from("<IIII", data, 4)
        if version != 2:
            raise unreadable(path, "glTF", f"version {version}; only version 2 is read")
        if length > len(data):
            raise unreadable(path, "glTF", f"cut short: it says {length} bytes and has {len(data)}")
        if kind != JSON_CHUNK or 20 + json_length > length:
            raise unreadable(path, "glTF", "its first chunk is not the whole JSON")
        text = data[20 : 20 + json_length]
        at = 20 + json_length
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", data, at)
            if at + 8 + size > length:
                raise unreadable(path, "glTF", "cut short within a chunk")
            if kind == BIN_CHUNK and binary is None:
                binary = data[at + 8 : at + 8 + size]
            at += 8 + size + (-size) % 4
        if length < len(data):
            notes.append(f"{several(len(data) - length, 'byte')} after the end left out")
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as problem:
        raise unreadable(path, "glTF", f"its JSON is broken ({' '.join(str(problem).split())[:100]})") from problem
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        raise unreadable(path, "glTF", "its JSON has no 'asset'")
    version = str(document["asset"].get("version", ""))
    if not version.startswith("2"):
        raise unreadable(path, "glTF", f"version '{version[:20]}'; only version 2 is read")
    for name in document.get("extensionsRequired") or ():
        if name not in READ and not str(name).startswith(LOOKS):
            raise unreadable(path, "glTF", f"it requires the extension {str(name)[:80]}, which is not known")
    return document, binary, notes


class _Scene:
    """The document while it is read."""

    def __init__(self, path: Path, document: dict[str, Any], binary: bytes | None) -> None:
        self._path, self._document = path, document
        self._buffers = Buffers(
            path, document, [self._buffer(k, b, binary) for k, b in enumerate(_list(document, "buffers"))]
        )
        self._meshes: dict[tuple[int, tuple[float, ...]], list[tuple[Shape, dict[str, Any]]]] = {}
        self._left_out = Counter[str]()
        self._uses = 0
        self._triangles = 0

    def _buffer(self, number: int, buffer: dict[str, Any], binary: bytes | None) -> bytes | None:
        """One buffer's bytes: the binary chunk, a data address, or a file in the folder; None for what has none."""
        uri = buffer.get("uri")
        if uri is None:
            return binary if number == 0 else None
        uri = str(uri)
        if uri.startswith("data:"):
            head, _, data = uri.partition(",")
            return (
                base64.b64decode(data, validate=False)
                if head.endswith(";base64")
                else unquote(data).encode("latin-1")
            )
        parts = urlsplit(uri)
        name = unquote(parts.path)
        folder = self._path.absolute().parent.resolve()
        target = (folder / name).resolve() if "\0" not in name else folder
        if (
            parts.scheme
            or parts.netloc
            or not target.is_relative_to(folder)
            or Path(name).is_absolute()
            or "\\" in name
        ):
            raise unreadable(self._path, "glTF", f"buffer {number} is at '{uri[:80]}', outside the file's folder")
        if not target.is_file():
            raise unreadable(self._path, "glTF", f"its file '{uri[:80]}' is missing")
        with reading(target):
            return target.read_bytes()

    def shape(self) -> tuple[NDArray[np.float64], NDArray[np.int64], Bodies | None]:
        """(vertices in metres, z up; faces; bodies) of the scene."""
        placed: list[Placed] = []
        for node, matrix in self._nodes():
            placed += self._of_node(node, matrix)
        if not placed:
            only = self.notes()
            why = f" ({', '.join(only)})" if only else ""
            raise InputError(f"{self._path}: the mesh has no triangles{why}")
        placed.sort(key=lambda one: one.body)
        starts = np.cumsum([0, *(len(one.points) for one in placed)])
        faces = [one.triangles + start for one, start in zip(placed, starts[:-1], strict=True)]
        names = {one.body: one.name for one in placed}
        count = Counter[int]()
        for one in placed:
            count[one.body] += len(one.triangles)
        sizes = [count[body] for body in names]
        colours = np.split(np.concatenate([one.colours for one in placed]), np.cumsum(sizes)[:-1])
        bodies = bodies_of(sizes, list(names.values()), colours)
        return np.concatenate([one.points for one in placed]), np.concatenate(faces), bodies

    def notes(self) -> list[str]:
        """What was left out, each with its number."""
        return [f"{several(count, what)} left out" for what, count in self._left_out.items()]

    def _nodes(self) -> list[tuple[dict[str, Any], NDArray[np.float64]]]:
        """(node, its matrix in the scene, z up) of what the scene shows; also sets the matrices of joints."""
        nodes = _list(self._document, "nodes")
        scenes = _list(self._document, "scenes")
        children = {c for node in nodes for c in _list(node, "children")}
        roots = [k for k in range(len(nodes)) if k not in children]
        if scenes:
            chosen = self._document.get("scene", 0)
            roots = _list(scenes[chosen], "nodes")
            others = {r for k, scene in enumerate(scenes) if k != chosen for r in _list(scene, "nodes")} - set(roots)
            if others:
                self._left_out["node of another scene"] = len(others)
        self._matrices: dict[int, NDArray[np.float64]] = {}
        found = []
        todo = [(root, TO_Z_UP, True) for root in reversed(roots)]
        while todo:
            number, above, shown = todo.pop()
            if not 0 <= number < len(nodes) or number in self._matrices:
                raise ValueError(f"node {number} is {'used twice' if number in self._matrices else 'missing'}")
            self._matrices[number] = above @ _local(nodes[number])
            shown = shown and _dict(_dict(nodes[number], "extensions"), VISIBILITY).get("visible") is not False
            if shown:
                found.append((nodes[number], self._matrices[number]))
            elif "mesh" in nodes[number]:
                self._left_out["hidden node"] += 1
            todo += [(child, self._matrices[number], shown) for child in reversed(_list(nodes[number], "children"))]
        return found

    def _of_node(self, node: dict[str, Any], matrix: NDArray[np.float64]) -> list[Placed]:
        if "mesh" not in node:
            return []
        matrices = [matrix]
        instances = _dict(node, "extensions").get(INSTANCING)
        if instances is not None:
            matrices = [matrix @ local for local in self._instances(_dict(instances, "attributes"))]
        self._uses += len(matrices)
        shapes, first = [], self._uses - len(matrices)
        name = str(node.get("name") or _list(self._document, "meshes")[node["mesh"]].get("name") or "")[:200]
        for (points, triangles), primitive in self._mesh(node["mesh"], node.get("weights")):
            colours = self._colours(primitive, triangles)
            self._triangles += len(matrices) * len(triangles)
            if self._uses > MOST_USES or self._triangles > MOST_TRIANGLES // 16:
                raise unreadable(self._path, "glTF", f"its copies come to over {self._triangles} triangles")
            if "skin" in node:
                posed = self._posed(points, primitive, _list(self._document, "skins")[node["skin"]])
                shapes.append(Placed(posed, triangles, first, name, colours))
                continue
            for k, m in enumerate(matrices):
                turned = triangles[:, ::-1] if np.linalg.det(m[:3, :3]) < 0 else triangles
                shapes.append(Placed(points @ m[:3, :3].T + m[:3, 3], turned, first + k, name, colours))
        return shapes

    def _colours(self, primitive: dict[str, Any], triangles: NDArray[np.int64]) -> NDArray[np.int32]:
        """(m,) of the material's base colour times that of the vertices; textures are not looked at."""
        materials = _list(self._document, "materials")
        number = primitive.get("material")
        material = materials[number] if number is not None else {}
        factor = _list(_dict(material, "pbrMetallicRoughness"), "baseColorFactor")
        own = _dict(primitive, "attributes").get("COLOR_0")
        if own is None and not factor:
            return np.full(len(triangles), NO_COLOUR, np.int32)
        linear = np.array(factor[:3] or (1, 1, 1), np.float64)[None]
        if own is not None:
            linear = linear * self._buffers.values(own)[:, :3]
            return of_corners(srgb(linear), triangles)
        return of_corners(srgb(linear), np.zeros_like(triangles))

    def _instances(self, attributes: dict[str, Any]) -> list[NDArray[np.float64]]:
        """Matrices of the instances of a node (EXT_mesh_gpu_instancing)."""
        columns = {
            name: self._buffers.values(attributes[name])
            for name in ("TRANSLATION", "ROTATION", "SCALE")
            if name in attributes
        }
        counts = {len(values) for values in columns.values()}
        if len(counts) != 1 or max(counts) > MOST_USES:
            raise ValueError("instances whose numbers differ, or too many")
        names = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        return [
            _local({names[name]: values[k].tolist() for name, values in columns.items()}) for k in range(counts.pop())
        ]

    def _mesh(self, number: int, weights: list[float] | None) -> list[tuple[Shape, dict[str, Any]]]:
        """Shapes of a mesh's primitives, made once, in the mesh's own place."""
        mesh = _list(self._document, "meshes")[number]
        morph = tuple(float(w) for w in (weights if weights is not None else _list(mesh, "weights")))
        if (number, morph) not in self._meshes:
            shapes = [(self._primitive(p, morph), p) for p in _list(mesh, "primitives")]
            self._meshes[number, morph] = [(shape, p) for shape, p in shapes if len(shape[1])]
        return self._meshes[number, morph]

    def _primitive(self, primitive: dict[str, Any], morph: tuple[float, ...]) -> Shape:
        mode = primitive.get("mode", 4)
        nothing = np.empty((0, 3)), np.empty((0, 3), np.int64)
        if mode not in (4, 5, 6):
            kind = {0: "set of points", 1: "set of lines", 2: "loop of lines", 3: "strip of lines"}.get(
                mode, "unknown primitive"
            )
            self._left_out[kind] += 1
            return nothing
        if "POSITION" not in _dict(primitive, "attributes"):
            self._left_out["primitive without positions"] += 1
            return nothing
        position = primitive["attributes"]["POSITION"]
        compressed = "KHR_draco_mesh_compression" in _dict(primitive, "extensions")
        if compressed and not self._buffers.is_stored(position):
            raise unreadable(
                self._path, "glTF", "its geometry is compressed with Draco (KHR_draco_mesh_compression), which is not"
                " read; export it without compression"
            )  # fmt: skip
        points = self._buffers.values(position)
        if points.shape[1] != 3:
            raise ValueError("positions that are not x y z")
        for weight, target in zip(morph, _list(primitive, "targets"), strict=False):
            if weight and "POSITION" in target:
                points = points + weight * self._buffers.values(target["POSITION"])
        corners = self._buffers.indices(primitive["indices"]) if "indices" in primitive else np.arange(len(points))
        if len(corners) and corners.max() >= len(points):
            raise ValueError(f"a face names vertex {corners.max()} of {len(points)}")
        if mode == 4:
            return points, corners[: len(corners) // 3 * 3].reshape(-1, 3)
        return points, strips_to_triangles(corners) if mode == 5 else fan_to_triangles(corners)

    def _posed(
        self, points: NDArray[np.float64], primitive: dict[str, Any], skin: dict[str, Any]
    ) -> NDArray[np.float64]:
        """Points moved by their joints, as section 3.7.3.3 says; the node's own matrix does not count."""
        joints = _list(skin, "joints")
        bind = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        if "inverseBindMatrices" in skin:
            bind = self._buffers.values(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = np.stack([self._matrices[joint] @ bind[k] for k, joint in enumerate(joints)])
        whole = np.concatenate([points, np.ones((len(points), 1))], axis=1)
        posed, total = np.zeros((len(points), 3)), np.zeros((len(points), 1))
        for k in range(8):
            if f"JOINTS_{k}" not in primitive["attributes"]:
                break
            chosen = self._buffers.values(primitive["attributes"][f"JOINTS_{k}"]).astype(np.int64)
            weights = self._buffers.values(primitive["attributes"][f"WEIGHTS_{k}"])
            for j in range(chosen.shape[1]):
                moved = np.einsum("nij,nj->ni", matrices[chosen[:, j]][:, :3], whole)
                posed += weights[:, j : j + 1] * moved
                total += weights[:, j : j + 1]
        if (total <= 0).any():
            raise ValueError("vertices of a skin that no joint moves")
        return posed / total


def srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours as they are written elsewhere, from linear ones, as glTF has them (IEC 61966-2-1)."""
    linear = linear.clip(0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _local(node: dict[str, Any]) -> NDArray[np.float64]:
    """(4, 4) matrix of a node, for column vectors."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = (float(v) for v in node.get("rotation", (0, 0, 0, 1)))
    length = x * x + y * y + z * z + w * w
    s = 2 / length if length else 0.0
    turn = np.array([
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ])  # fmt: skip
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), np.float64)
    return matrix


def _list(of: dict[str, Any], name: str) -> list[Any]:
    value = of.get(name)
    if value is None:
        return []
    if not isinstance(value, list):
        raise ValueError(f"'{name}' is no list")
    return value


def _dict(of: dict[str, Any], name: str) -> dict[str, Any]:
    value = of.get(name)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ValueError(f"'{name}' is no object")
    return value
