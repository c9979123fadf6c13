"""Meshes from files: the same box in mm whatever the format and its unit, and clear words when it is not."""

from __future__ import annotations

import csv
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from layerfix import Mesh, load_mesh
from layerfix.errors import InputError, OutputError
from layerfix.mesh.slicing import slice_mesh
from layerfix.mesh.triangles import save_stl
from tests.making import SHARED, box, joined, sphere, write_stl

LOW, HIGH = (1.0, 2.0, 3.0), (13.0, 9.0, 6.5)
THE_BOX = np.array([LOW, HIGH])
VOLUME = 12 * 7 * 3.5
CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"


def as_trimesh(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def is_the_box(mesh: Mesh) -> None:
    """The box of this module, closed and facing outwards."""
    assert mesh.bounds_mm == pytest.approx(THE_BOX, rel=1e-6)
    assert mesh.volume_mm3 == pytest.approx(VOLUME, rel=1e-5)


# STL, OBJ, PLY, OFF, GLB -----------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0, -1, np.nan, np.inf])
def test_a_scale_is_above_0(factor):
    """A mirrored part would be inside out."""
    with pytest.raises(InputError, match=f"scale {factor}: it must be above 0"):
        box(LOW, HIGH).scaled(factor)


@pytest.mark.parametrize("name", ["box.stl", "BOX.STL", "box.obj", "box.ply", "box.off", "box.3mf", "prüf stück.stl"])
def test_the_same_box_from_every_format(tmp_path, name):
    """Formats without a unit are read as mm; the suffix may be in capitals, the name in any language."""
    path = tmp_path / name
    path.write_bytes(_exported(path.suffix.lower()[1:]))
    mesh = load_mesh(path)
    is_the_box(mesh)
    assert mesh.name == name
    is_the_box(load_mesh(str(path)))


def _exported(kind: str) -> bytes:
    data = as_trimesh(box(LOW, HIGH)).export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


@pytest.mark.parametrize("kind", ["stl_ascii", "ply_ascii"])
def test_text_formats(tmp_path, kind):
    """ASCII STL and PLY."""
    path = tmp_path / f"box.{kind[:3]}"
    encoding = {"encoding": "ascii"} if kind == "ply_ascii" else {}
    data = as_trimesh(box(LOW, HIGH)).export(file_type=kind[:3] if encoding else kind, **encoding)
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    is_the_box(load_mesh(path))


# What an exporter does to a part whose z is up: (x, y, z) → (x, z, -y).
Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def test_glb_is_in_metres(tmp_path):
    """glTF has one unit, the metre, and its y points up."""
    scaled = as_trimesh(box(LOW, HIGH))
    scaled.apply_scale(0.001)
    scaled.apply_transform(Y_UP)
    (tmp_path / "box.glb").write_bytes(scaled.export(file_type="glb"))
    is_the_box(load_mesh(tmp_path / "box.glb"))


def test_a_glb_drawn_in_millimetres_proposes_them(tmp_path):
    """Many programs write millimetres into a GLB: 13 metres are not a part, and --unit mm is the way out."""
    turned = as_trimesh(box(LOW, HIGH))
    turned.apply_transform(Y_UP)
    (tmp_path / "box.glb").write_bytes(turned.export(file_type="glb"))
    with pytest.raises(InputError, match=r"box\.glb.*1\.2e\+04 × 7000 × 3500 mm.*--unit mm \(12 mm\)"):
        load_mesh(tmp_path / "box.glb")
    is_the_box(load_mesh(tmp_path / "box.glb", unit="mm"))


def test_a_binary_stl_that_begins_with_solid(tmp_path):
    """Several programs write that word into the header of binary files."""
    data = write_stl(tmp_path / "box.stl", box(LOW, HIGH)).read_bytes()
    (tmp_path / "box.stl").write_bytes(b"solid exported by a program".ljust(80) + data[80:])
    is_the_box(load_mesh(tmp_path / "box.stl"))


def test_an_ascii_stl_of_several_solids_in_odd_spelling(tmp_path):
    """Capitals, tabs, Windows line ends, two solids in one file: all triangles count."""
    halves = [box(LOW, (7, 9, 6.5)), box((7, 2, 3), HIGH)]
    text = "\n".join(as_trimesh(half).export(file_type="stl_ascii") for half in halves)
    (tmp_path / "box.stl").write_bytes(text.replace("  ", "\t").replace("\n", "\r\n").encode())
    is_the_box(load_mesh(tmp_path / "box.stl"))
    (tmp_path / "box.stl").write_bytes(text.upper().encode())
    is_the_box(load_mesh(tmp_path / "box.stl"))


def test_an_obj_with_quads_groups_normals_and_a_missing_material(tmp_path):
    """Faces of four corners, two objects, indices counted from the end, a material library that is not there."""
    corners = [(x, y, z) for z in (3.0, 6.5) for x, y in ((1.0, 2.0), (13.0, 2.0), (13.0, 9.0), (1.0, 9.0))]
    quads = ["4 3 2 1", "5 6 7 8", "1 2 6 5"]
    others = ["-7 -6 -2 -3", "3//1 4//1 8//1 7//1", "4/1/1 1/1/1 5/1/1 8/1/1"]
    lines = ["mtllib nowhere.mtl", *(f"v {x} {y} {z}" for x, y, z in corners), "vn 0 0 1", "vt 0 0",
             "o first", "usemtl paint", *(f"f {q}" for q in quads), "o second", "g group", "s 1",
             *(f"f {q}" for q in others)]  # fmt: skip
    (tmp_path / "box.obj").write_text("\n".join(lines))
    is_the_box(load_mesh(tmp_path / "box.obj"))


def test_an_off_with_quads_and_comments(tmp_path):
    """OFF counts corners before each face."""
    corners = [f"{x} {y} {z}" for z in (3.0, 6.5) for x, y in ((1.0, 2.0), (13.0, 2.0), (13.0, 9.0), (1.0, 9.0))]
    quads = ["4 3 2 1 0", "4 4 5 6 7", "4 0 1 5 4", "4 1 2 6 5", "4 2 3 7 6", "4 3 0 4 7"]
    (tmp_path / "box.off").write_text("\n".join(["OFF", "# a box", "8 6 0", *corners, *quads]) + "\n")
    is_the_box(load_mesh(tmp_path / "box.off"))


@pytest.mark.parametrize("name", ["box.stl", "box.obj", "box.off", "box.ply"])
@pytest.mark.parametrize(("unit", "mm"), [("in", 25.4), ("m", 1000), ("um", 0.001), ("Inches", 25.4), ("mm", 1)])
def test_a_given_unit_scales(tmp_path, name, unit, mm):
    """What one unit of the file is can be said; then no size is implausible."""
    small = as_trimesh(box(np.divide(LOW, mm), np.divide(HIGH, mm)))
    data = small.export(file_type=name[-3:])
    (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
    mesh = load_mesh(tmp_path / name, unit=unit)
    assert mesh.bounds_mm == pytest.approx(THE_BOX, rel=1e-5)


# 3MF -----------------------------------------------------------------------------------------------------


def mesh_xml(mesh: Mesh) -> str:
    """The <mesh> element of a 3MF object."""
    vertices = "".join(f'<vertex x="{x:g}" y="{y:g}" z="{z:g}"/>' for x, y, z in mesh.vertices)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    return f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>"


def model_xml(resources: str, build: str = "", unit: str = 'unit="millimeter"') -> str:
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><model {unit} xml:lang="en-US" xmlns="{CORE}" xmlns:p="{PRODUCTION}">'
        f"<resources>{resources}</resources><build>{build}</build></model>"
    )


def write_3mf(path: Path, model: str, **parts: str) -> Path:
    """A 3MF package: the content types, the relation to the model, the model, and further models by name."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "[Content_Types].xml",
            '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels"'
            ' ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model"'
            ' ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>',
        )
        relation = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
        relations = (
            '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">{}</Relationships>'
        )
        one = '<Relationship Target="{}" Id="rel{}" Type="' + relation + '"/>'
        archive.writestr("_rels/.rels", relations.format(one.format("/3D/3dmodel.model", 0)))
        archive.writestr("3D/3dmodel.model", model)
        if parts:
            targets = "".join(one.format(f"/3D/Objects/{name}.model", k) for k, name in enumerate(parts))
            archive.writestr("3D/_rels/3dmodel.model.rels", relations.format(targets))
        for name, text in parts.items():
            archive.writestr(f"3D/Objects/{name}.model", text)
    return path


UNIT_CUBE = f'<object id="1" type="model">{mesh_xml(box([0, 0, 0], [1, 1, 1]))}</object>'
TO_THE_BOX = "12 0 0 0 7 0 0 0 3.5 1 2 3"  # the unit cube's twelve numbers: three columns, then the shift


def component(number: int, transform: str = "", path: str = "") -> str:
    where = f' p:path="/3D/Objects/{path}.model"' if path else ""
    return f'<component objectid="{number}"{where}' + (f' transform="{transform}"' if transform else "") + "/>"


@pytest.mark.parametrize(
    ("unit", "mm"),
    [('unit="millimeter"', 1), ("", 1), ('unit="inch"', 25.4), ('unit="meter"', 1000), ('unit="centimeter"', 10),
     ('unit="micron"', 0.001), ('unit="foot"', 304.8)],
)  # fmt: skip
def test_a_3mf_says_its_unit(tmp_path, unit, mm):
    """Every unit of the 3MF specification, and none, which is the millimetre."""
    drawn = f'<object id="1">{mesh_xml(box(np.divide(LOW, mm), np.divide(HIGH, mm)))}</object>'
    path = write_3mf(tmp_path / "box.3mf", model_xml(drawn, '<item objectid="1"/>', unit))
    assert load_mesh(path).bounds_mm == pytest.approx(THE_BOX, rel=1e-4)


def test_a_3mf_item_is_placed_by_its_transform(tmp_path):
    """Scaled and shifted by the build item; the numbers are in the file's unit too."""
    path = write_3mf(tmp_path / "a.3mf", model_xml(UNIT_CUBE, f'<item objectid="1" transform="{TO_THE_BOX}"/>'))
    is_the_box(load_mesh(path))


def test_all_build_items_of_a_3mf_count_and_nothing_else(tmp_path):
    """Two items of one object, one of another; an object that is not built is not there."""
    objects = UNIT_CUBE + f'<object id="2">{mesh_xml(box([0, 0, 0], [2, 2, 2]))}</object>'
    objects += f'<object id="3">{mesh_xml(box([-50, 0, 0], [90, 90, 90]))}</object>'
    items = '<item objectid="1"/><item objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
    items += '<item objectid="2" transform="1 0 0 0 1 0 0 0 1 20 0 0"/>'
    mesh = load_mesh(write_3mf(tmp_path / "a.3mf", model_xml(objects, items)))
    assert mesh.bounds_mm == pytest.approx(np.array([[0, 0, 0], [22, 2, 2]]))
    assert mesh.volume_mm3 == pytest.approx(1 + 1 + 8)


def test_build_items_of_one_part_number_all_count(tmp_path):
    """Several copies of a part carry the same part number: that is what it is for."""
    items = "".join(
        f'<item objectid="1" partnumber="A-17" transform="1 0 0 0 1 0 0 0 1 {10 * k} 0 0"/>' for k in range(3)
    )
    mesh = load_mesh(write_3mf(tmp_path / "a.3mf", model_xml(UNIT_CUBE, items)), unit="mm")
    assert mesh.volume_mm3 == pytest.approx(3)


def test_components_of_a_3mf_are_placed_by_all_transforms(tmp_path):
    """An object made of components made of components: the transforms multiply from the inside out."""
    objects = UNIT_CUBE
    inner = component(1) + component(1, "1 0 0 0 1 0 0 0 1 1 0 0")  # 2 × 1 × 1
    objects += f'<object id="2"><components>{inner}</components></object>'
    objects += f'<object id="3"><components>{component(2, "6 0 0 0 7 0 0 0 3.5 0 0 0")}</components></object>'
    item = '<item objectid="3" transform="1 0 0 0 1 0 0 0 1 1 2 3"/>'
    is_the_box(load_mesh(write_3mf(tmp_path / "a.3mf", model_xml(objects, item))))


def test_a_rotation_in_a_3mf_is_by_rows(tmp_path):
    """3MF writes matrices for row vectors: this one turns x to y."""
    drawn = f'<object id="1">{mesh_xml(box([0, 0, 0], [4, 2, 1]))}</object>'
    item = '<item objectid="1" transform="0 1 0 -1 0 0 0 0 1 0 0 0"/>'
    mesh = load_mesh(write_3mf(tmp_path / "a.3mf", model_xml(drawn, item)))
    assert mesh.bounds_mm == pytest.approx(np.array([[-2, 0, 0], [0, 4, 1]]))
    assert mesh.volume_mm3 == pytest.approx(8)


@pytest.mark.parametrize("where", ["item", "component"])
def test_a_mirrored_3mf_still_faces_outwards(tmp_path, where):
    """A mirroring transform, of an item or a component, must turn the triangles too."""
    mirror = "-12 0 0 0 7 0 0 0 3.5 13 2 3"
    if where == "item":
        model = model_xml(UNIT_CUBE, f'<item objectid="1" transform="{mirror}"/>')
    else:
        group = f'<object id="2"><components>{component(1, mirror)}</components></object>'
        model = model_xml(UNIT_CUBE + group, '<item objectid="2"/>')
    is_the_box(load_mesh(write_3mf(tmp_path / "a.3mf", model)))


def test_a_3mf_whose_objects_are_in_files_of_their_own(tmp_path):
    """The production extension, as Bambu Studio and OrcaSlicer write it: one object, one part."""
    group = f'<object id="2" type="model"><components>{component(1, TO_THE_BOX, "object_1")}</components></object>'
    path = write_3mf(tmp_path / "a.3mf", model_xml(group, '<item objectid="2"/>'), object_1=model_xml(UNIT_CUBE))
    is_the_box(load_mesh(path))


def test_each_part_of_a_3mf_object_has_its_own_place(tmp_path):
    """An object of two parts: both meshes lie in one file, and each is placed by its own component."""
    parts = UNIT_CUBE + f'<object id="2">{mesh_xml(box([0, 0, 0], [2, 2, 2]))}</object>'
    places = component(1, path="object_1") + component(2, "1 0 0 0 1 0 0 0 1 10 0 0", "object_1")
    group = f'<object id="3"><components>{places}</components></object>'
    path = write_3mf(tmp_path / "a.3mf", model_xml(group, '<item objectid="3"/>'), object_1=model_xml(parts))
    mesh = load_mesh(path)
    assert mesh.bounds_mm == pytest.approx(np.array([[0, 0, 0], [12, 2, 2]]))
    assert mesh.volume_mm3 == pytest.approx(1 + 8)


def test_ids_of_a_3mf_count_in_their_own_file(tmp_path):
    """Two files may each have an object 1, and the main model one too."""
    other = f'<object id="1">{mesh_xml(box([0, 0, 0], [2, 2, 2]))}</object>'
    groups = f'<object id="2"><components>{component(1, path="object_1")}</components></object>'
    groups += f'<object id="3"><components>{component(1, path="object_2")}</components></object>'
    items = '<item objectid="2"/><item objectid="3" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
    path = write_3mf(
        tmp_path / "a.3mf", model_xml(groups, items), object_1=model_xml(UNIT_CUBE), object_2=model_xml(other)
    )
    mesh = load_mesh(path)
    assert mesh.bounds_mm == pytest.approx(np.array([[0, 0, 0], [12, 2, 2]]))
    assert mesh.volume_mm3 == pytest.approx(1 + 8)


def test_a_3mf_object_that_is_used_twice_is_there_twice(tmp_path):
    """Two objects of the plate that share one mesh in a file of its own."""
    groups = "".join(
        f'<object id="{k}"><components>{component(1, path="object_1")}</components></object>' for k in (2, 3)
    )
    items = '<item objectid="2"/><item objectid="3" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
    path = write_3mf(tmp_path / "a.3mf", model_xml(groups, items), object_1=model_xml(UNIT_CUBE))
    assert load_mesh(path).volume_mm3 == pytest.approx(2)


def test_a_build_item_may_name_an_object_in_another_file(tmp_path):
    """The production extension allows a path on the build item itself."""
    item = f'<item objectid="1" p:path="/3D/Objects/object_1.model" transform="{TO_THE_BOX}"/>'
    path = write_3mf(tmp_path / "a.3mf", model_xml("", item), object_1=model_xml(UNIT_CUBE))
    is_the_box(load_mesh(path))


def test_the_model_of_a_3mf_may_have_another_name(tmp_path):
    """The package's relations say which part is the model; without any it is 3D/3dmodel.model."""
    model = model_xml(UNIT_CUBE, f'<item objectid="1" transform="{TO_THE_BOX}"/>')
    path = write_3mf(tmp_path / "a.3mf", model)
    with zipfile.ZipFile(path) as whole, zipfile.ZipFile(tmp_path / "b.3mf", "w") as renamed:
        for name in whole.namelist():
            text = whole.read(name).decode().replace("/3D/3dmodel.model", "/3D/Part.model")
            renamed.writestr(name.replace("3D/3dmodel.model", "3D/Part.model"), text)
    is_the_box(load_mesh(tmp_path / "b.3mf"))
    with zipfile.ZipFile(tmp_path / "c.3mf", "w") as bare:
        bare.writestr("3D/3DModel.model", model)
    is_the_box(load_mesh(tmp_path / "c.3mf"))


@pytest.mark.parametrize(
    ("resources", "item"),
    [
        ("", '<item objectid="1"/>'),
        (f'<object id="2"><components>{component(9)}</components></object>', '<item objectid="2"/>'),
        (f'<object id="2"><components>{component(1, path="none")}</components></object>', '<item objectid="2"/>'),
        (f'<object id="2"><components>{component(2)}</components></object>', '<item objectid="2"/>'),
        (UNIT_CUBE, '<item objectid="1" transform="1 0 0 0 1"/>'),
        (UNIT_CUBE, '<item objectid="1" transform="a b c d e f g h i j k l"/>'),
        (UNIT_CUBE.replace('x="0"', ""), '<item objectid="1"/>'),
        (UNIT_CUBE.replace('v1="0"', 'v1="8"'), '<item objectid="1"/>'),
        (UNIT_CUBE.replace('v1="0"', 'v1="-1"'), '<item objectid="1"/>'),
        (UNIT_CUBE.replace('v1="0"', 'v1="8"') + UNIT_CUBE.replace('id="1"', 'id="2"', 1),
         '<item objectid="1"/><item objectid="2"/>'),
        (UNIT_CUBE.replace('z="1"', 'z="nan"'), '<item objectid="1"/>'),
    ],
    ids=["item", "component", "file", "itself", "five-numbers", "no-numbers", "no-x", "vertex-8", "vertex-minus-1",
         "vertex-8-of-the-next", "nan"],
)  # fmt: skip
def test_a_3mf_that_refers_to_nothing(tmp_path, resources, item):
    """An object, a file, a vertex that is not there, an object inside itself: each names the file."""
    path = write_3mf(tmp_path / "a.3mf", model_xml(resources, item))
    with pytest.raises(InputError, match=r"a\.3mf"):
        load_mesh(path, unit="mm")


def test_a_3mf_with_an_unknown_unit_and_a_bad_model(tmp_path):
    """The unit is named; XML that does not end is an error, unless another unit is given for the first."""
    path = write_3mf(tmp_path / "a.3mf", model_xml(UNIT_CUBE, '<item objectid="1"/>', 'unit="league"'))
    with pytest.raises(InputError, match=r"a\.3mf.*league"):
        load_mesh(path)
    path = write_3mf(tmp_path / "b.3mf", model_xml(UNIT_CUBE, '<item objectid="1"/>')[:-40])
    with pytest.raises(InputError, match=r"b\.3mf: not a readable 3MF mesh: /3D/3dmodel\.model is broken"):
        load_mesh(path)


def test_a_given_unit_replaces_that_of_a_3mf(tmp_path):
    """--unit wins over the file."""
    drawn = f'<object id="1">{mesh_xml(box(LOW, HIGH))}</object>'
    path = write_3mf(tmp_path / "a.3mf", model_xml(drawn, '<item objectid="1"/>', 'unit="meter"'))
    is_the_box(load_mesh(path, unit="mm"))


def test_a_3mf_without_anything_to_build(tmp_path):
    """An empty build plate, and a package without a model."""
    with pytest.raises(InputError, match=r"a\.3mf.*no triangles"):
        load_mesh(write_3mf(tmp_path / "a.3mf", model_xml(UNIT_CUBE)))
    with zipfile.ZipFile(tmp_path / "b.3mf", "w") as archive:
        archive.writestr("readme.txt", "nothing")
    with pytest.raises(InputError, match=r"b\.3mf"):
        load_mesh(tmp_path / "b.3mf")


# Sizes that cannot be ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scale", "proposals"),
    [(0.001, ["--unit m (12 mm)"]), (1 / 25.4, ["--unit in (12 mm)", "--unit cm (4.724 mm)"]),
     (0.1, ["--unit in (30.48 mm)", "--unit cm (12 mm)"]), (1000, ["--unit um (12 mm)"])],
)  # fmt: skip
def test_an_implausible_size_proposes_the_units_that_fit(tmp_path, scale, proposals):
    """A part of 0.012 mm was drawn in metres: the message says so, and how to keep the size after all."""
    path = write_stl(tmp_path / "box.stl", box(np.multiply(LOW, scale), np.multiply(HIGH, scale)))
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    for words in (str(path), *proposals, "--unit mm to keep this size"):
        assert words in str(caught.value)
    assert load_mesh(path, unit="mm").size_mm[0] == pytest.approx(12 * scale)


@pytest.mark.parametrize(("size", "fine"), [(1.99, False), (2.01, True), (2499, True), (2501, False)])
def test_plausible_is_two_millimetres_to_two_and_a_half_metres(tmp_path, size, fine):
    """By the longest side."""
    path = write_stl(tmp_path / "box.stl", box([0, 0, 0], [1, size, 0.5]))
    if fine:
        assert load_mesh(path).size_mm[1] == pytest.approx(size)
    else:
        with pytest.raises(InputError, match="--unit"):
            load_mesh(path)


def test_an_unknown_unit_names_the_known_ones(tmp_path):
    """The message lists what may be written."""
    path = write_stl(tmp_path / "box.stl", box(LOW, HIGH))
    with pytest.raises(InputError, match="unknown unit 'furlong': use one of um, mm, cm, in, ft, m"):
        load_mesh(path, unit="furlong")


# Files that are not what they say -----------------------------------------------------------------------------

SUFFIXES = [".stl", ".obj", ".ply", ".off", ".3mf", ".glb"]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("data", [b"", b"hello, this is not a mesh\n" * 20, bytes(range(256)) * 8, b"\0" * 500])
def test_garbage_is_refused_by_name(tmp_path, suffix, data):
    """Nothing, text, bytes, zeros: one sentence that names the file, in every format."""
    path = tmp_path / f"part{suffix}"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_file_that_is_cut_short_is_refused(tmp_path, suffix, share):
    """Half a download must not pass for a part with half its triangles."""
    data = as_trimesh(sphere(20, 40, 20)).export(file_type=suffix[1:])
    data = data.encode() if isinstance(data, str) else data
    (tmp_path / f"part{suffix}").write_bytes(data[: int(share * len(data))])
    if suffix == ".obj" and share == 0.9:
        return  # OBJ has no count of faces and no end: what is there is a valid file
    with pytest.raises(InputError, match=f"part{suffix}"):
        load_mesh(tmp_path / f"part{suffix}")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_vertex_that_is_not_a_number(tmp_path, value):
    """NaN and infinity, in a binary STL and as text, are counted."""
    data = bytearray(write_stl(tmp_path / "part.stl", box(LOW, HIGH)).read_bytes())
    data[84 + 12 : 84 + 16] = struct.pack("<f", value)
    (tmp_path / "part.stl").write_bytes(data)
    with pytest.raises(InputError, match=r"part\.stl.*1 of \d+ vertices are NaN or infinite"):
        load_mesh(tmp_path / "part.stl")
    (tmp_path / "part.obj").write_text(f"v 0 0 0\nv 1 0 {value}\nv 0 9 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"part\.obj.*NaN or infinite"):
        load_mesh(tmp_path / "part.obj")


@pytest.mark.parametrize(
    ("name", "text"),
    [("points.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
                    "end_header\n1 2 3\n"),
     ("points.obj", "v 0 0 0\nv 1 1 1\n"), ("lines.obj", "v 0 0 0\nv 1 1 1\nl 1 2\n"), ("none.off", "OFF\n0 0 0\n"),
     ("empty.stl", "solid nothing\nendsolid nothing\n")],
)  # fmt: skip
def test_points_and_lines_are_no_mesh(tmp_path, name, text):
    """A file of its format without one triangle."""
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=name):
        load_mesh(tmp_path / name)


def test_a_face_that_names_a_vertex_that_is_not_there(tmp_path):
    """Index 9 of 3."""
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 9\n")
    with pytest.raises(InputError, match=r"part\.obj"):
        load_mesh(tmp_path / "part.obj")
    (tmp_path / "part.off").write_text("OFF\n3 1 0\n0 0 0\n9 0 0\n0 9 0\n3 0 1 8\n")
    with pytest.raises(InputError, match=r"part\.off"):
        load_mesh(tmp_path / "part.off")


def test_an_unknown_suffix_and_a_missing_file(tmp_path):
    """The message names the suffixes it knows, and the path that is not there."""
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    with pytest.raises(InputError, match=r"part\.step: '\.step' is not a mesh; known are \.stl \.obj"):
        load_mesh(tmp_path / "part.step")
    with pytest.raises(InputError, match=r"none\.stl: no such file"):
        load_mesh(tmp_path / "none.stl")


def test_all_vertices_in_one_point(tmp_path):
    """No size at all."""
    with pytest.raises(InputError, match="all vertices are one point"):
        load_mesh(write_stl(tmp_path / "part.stl", box([1, 1, 1], [1, 1, 1])))


# The value ----------------------------------------------------------------------------------------------------


def test_a_mesh_checks_its_arrays():
    """Shapes, indices and numbers are checked where a mesh is made."""
    good = box(LOW, HIGH)
    with pytest.raises(InputError, match="a mesh has"):
        Mesh(good.vertices[:, :2], good.faces)
    with pytest.raises(InputError, match="a mesh has"):
        Mesh(good.vertices, good.faces.ravel())
    with pytest.raises(InputError, match="no triangles"):
        Mesh(good.vertices, good.faces[:0])
    with pytest.raises(InputError, match="a face names vertex 8 of 8"):
        Mesh(good.vertices, good.faces + 1)
    with pytest.raises(InputError, match="a face names vertex -1"):
        Mesh(good.vertices, good.faces - 1)
    with pytest.raises(InputError, match="1 of 8 vertices are NaN"):
        Mesh(np.where(np.arange(8)[:, None] == 3, np.nan, good.vertices), good.faces)


def test_turning_and_mirroring_keep_the_volume():
    """A mirrored mesh still faces outwards; moving moves the bounds."""
    mesh = box(LOW, HIGH)
    assert mesh.transformed(np.diag([-1, 1, 1])).volume_mm3 == pytest.approx(VOLUME)
    assert mesh.transformed(2 * np.eye(3)).volume_mm3 == pytest.approx(8 * VOLUME)
    assert mesh.moved([1, 1, 1]).bounds_mm == pytest.approx(THE_BOX + 1)
    assert mesh.bounds_mm == pytest.approx(THE_BOX)


@pytest.mark.parametrize("extra", [1, 100])
def test_vertices_of_no_triangle_do_not_count(extra):
    """A stray vertex far away does not make the part larger."""
    mesh = box(LOW, HIGH)
    stray = Mesh(np.concatenate([mesh.vertices, np.full((extra, 3), 900.0)]), mesh.faces)
    assert stray.size_mm == pytest.approx(mesh.size_mm)


def test_a_trimesh_can_be_sliced_as_it_is():
    """Anything with vertices and faces will do."""
    layers = slice_mesh(as_trimesh(box([0, 0, 0], [1, 1, 1])), pixel_mm=0.1, layer_mm=0.5)
    assert [layer.count_px() for layer in layers] == [100, 100]


def test_saving_and_loading_an_stl(tmp_path):
    """Normals face outwards, the file is as long as its count says, and an existing one is kept without force."""
    mesh = joined(box(LOW, HIGH), sphere(9, 24, 12))
    path = write_stl(tmp_path / "part.stl", mesh)
    data = path.read_bytes()
    assert len(data) == 84 + 50 * len(mesh.faces)
    assert struct.unpack("<I", data[80:84])[0] == len(mesh.faces)
    assert not data.startswith(b"solid")
    again = load_mesh(path)
    assert again.volume_mm3 == pytest.approx(mesh.volume_mm3, rel=1e-5)
    assert np.array_equal(again.vertices[again.faces], mesh.vertices[mesh.faces].astype(np.float32))
    with pytest.raises(OutputError, match="--force"):
        save_stl(path, mesh)
    save_stl(path, box(LOW, HIGH), force=True)
    is_the_box(load_mesh(path))


# Other people's files ---------------------------------------------------------------------------------------


def _index() -> list[dict[str, str]]:
    table = SHARED / "meshes" / "index.tsv"
    if not table.is_file():
        return []
    with table.open(encoding="utf-8") as lines:
        return list(csv.DictReader(lines, delimiter="\t"))


@pytest.mark.parametrize("row", _index(), ids=[row["file"] for row in _index()])
def test_other_peoples_meshes_load_and_slice(row):
    """Real files with their defects: the size is the one the index states, and some layers can be cut."""
    scale = float(row["scale_to_mm (our suggestion; file itself unscaled)"])
    unit = {1.0: None, 1000.0: "m", 25.4: "in"}.get(scale, "mm")
    mesh = load_mesh(SHARED / "meshes" / row["file"], unit=unit)
    size = [float(v) * (scale if unit else 1) for v in row["bbox in file units"].split(" x ")]
    if unit == "mm":
        size = [v / scale for v in size]
    assert mesh.size_mm == pytest.approx(size, rel=0.005)
    stack = slice_mesh(mesh, pixel_mm=max(size) / 500, layer_mm=min(size) / 20)
    solid = [layer.count_px() for layer in stack[1:-1:4]]
    assert max(solid) > 0


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_words_of_a_text_mesh_may_be_in_any_encoding(tmp_path, encoding):
    """CAD programs write names and comments in their system's own."""
    mesh = box([0, 0, 0], [10, 8, 5])
    lines = ["# Größe in Zöllen", *(f"v {x} {y} {z}" for x, y, z in mesh.vertices)]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    (tmp_path / "part.obj").write_bytes("\n".join(lines).encode(encoding))
    assert load_mesh(tmp_path / "part.obj").volume_mm3 == pytest.approx(400)
