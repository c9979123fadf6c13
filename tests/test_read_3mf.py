"""3MF beyond plain meshes: what slicers cut out or do not print, beams, extensions, and files made to hurt."""

from __future__ import annotations

import math
import time
import zipfile
from pathlib import Path

import pytest

from layerfix import load_mesh, slice_mesh
from layerfix.errors import InputError, OutputError
from layerfix.mesh.read_3mf import recognises
from layerfix.mesh.triangles import Mesh, save_stl
from tests.making import box, run_layerfix
from tests.test_mesh import CORE, component, mesh_xml, model_xml, write_3mf

MS, CONSORTIUM = "http://schemas.microsoft.com/3dmanufacturing/", "http://schemas.3mf.io/3dmanufacturing/"
BEAMS = f'xmlns:b="{MS}beamlattice/2017/02" xmlns:b2="{MS}beamlattice/balls/2020/07" requiredextensions="b b2"'
BODY, HOLE = box([0, 0, 0], [10, 10, 10]), box([2, 2, -1], [4, 4, 11])  # 1000 mm³; 40 of them inside the body
PRUSA, ORCA = "Metadata/Slic3r_PE_model.config", "Metadata/model_settings.config"


def obj(number: int, mesh: Mesh, kind: str = "model", more: str = "") -> str:
    return f'<object id="{number}" type="{kind}" {more}>{mesh_xml(mesh)}</object>'


def group(number: int, *components: str) -> str:
    return f'<object id="{number}"><components>{"".join(components)}</components></object>'


def shifted(x: float) -> str:
    return f"1 0 0 0 1 0 0 0 1 {x} 0 0"


def package(
    path: Path,
    resources: str,
    build: str,
    *,
    attributes: str = "",
    settings: tuple[str, str] | None = None,
    unit: str = 'unit="millimeter"',
    **parts: str,
) -> Path:
    """A 3MF with namespaces on its model and one settings file of a slicer."""
    write_3mf(path, model_xml(resources, build, f"{unit} {attributes}"), **parts)
    if settings:
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(*settings)
    return path


def volume(path: Path) -> float:
    return slice_mesh(load_mesh(path), pixel_mm=0.1, layer_mm=0.1).volume_mm3()


# Negative volumes, modifiers, supports ------------------------------------------------------------------------


def prusa(tmp_path: Path, kinds: list[tuple[Mesh, str]], key: str = "volume_type") -> Path:
    """An object of several volumes in one mesh, as PrusaSlicer writes it."""
    vertices = [v for mesh, _ in kinds for v in mesh.vertices.tolist()]
    faces, at = [], 0
    for mesh, _ in kinds:
        faces += (mesh.faces + at).tolist()
        at += len(mesh.vertices)
    volumes = "".join(
        f'<volume firstid="{12 * k}" lastid="{12 * k + 11}"><metadata type="volume" key="name" value="v"/>'
        f'<metadata type="volume" key="{key}" value="{kind}"/></volume>'
        for k, (_, kind) in enumerate(kinds)
    )
    config = f'<?xml version="1.0"?><config><object id="1" instances_count="1">{volumes}</object></config>'
    whole = obj(1, Mesh(vertices, faces))
    return package(tmp_path / "a.3mf", whole, '<item objectid="1"/>', settings=(PRUSA, config))


def test_a_negative_volume_of_prusaslicer_is_cut_out(tmp_path):
    """Pixel by pixel; the note says nothing, for nothing is left out. An STL cannot hold it."""
    path = prusa(tmp_path, [(BODY, "ModelPart"), (HOLE, "NegativeVolume")])
    mesh = load_mesh(path)
    assert mesh.size_mm == pytest.approx((10, 10, 10))
    assert mesh.notes == ()
    assert volume(path) == pytest.approx(1000 - 40)
    with pytest.raises(OutputError, match="volumes that are cut out"):
        save_stl(tmp_path / "out.stl", mesh)
    how = ("--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.4mm", "--axes", "xyz", "--surface", "voxels")
    run = run_layerfix("fix", path, tmp_path / "out.ply", *how)
    said = "--axes xyz: does not go with volumes that are cut out of others, as in a.3mf"
    assert (run.code, said in run.err) == (2, True), run.err


@pytest.mark.parametrize("kind", ["ParameterModifier", "SupportBlocker", "SupportEnforcer"])
def test_what_prusaslicer_does_not_print_is_left_out(tmp_path, kind):
    """A note says so."""
    far = HOLE.moved([30, 0, 0])
    mesh = load_mesh(prusa(tmp_path, [(BODY, "ModelPart"), (far, kind), (far, kind)]))
    assert mesh.size_mm == pytest.approx((10, 10, 10))
    name = {
        "ParameterModifier": "modifiers",
        "SupportBlocker": "support blockers",
        "SupportEnforcer": "support enforcers",
    }
    assert mesh.notes == (f"2 {name[kind]} left out",)


def test_old_modifiers_and_unknown_kinds(tmp_path):
    """Slic3r wrote modifier="1"; a kind that nobody knows is named and left out."""
    assert load_mesh(prusa(tmp_path, [(BODY, "0"), (HOLE, "1")], "modifier")).notes == ("1 modifier left out",)
    mesh = load_mesh(prusa(tmp_path, [(BODY, "ModelPart"), (HOLE, "TextVolume")]))
    assert mesh.notes == ("1 part of the unknown kind 'TextVolume' left out",)


def test_a_negative_volume_cuts_what_comes_before_it(tmp_path):
    """As PrusaSlicer does; what comes later in the list stays, and one that cuts nothing is told."""
    second = box([0, 20, 0], [10, 30, 10])
    hole = box([2, -1, 2], [4, 31, 4])  # through both: 2 × 2 × 10 of each
    cut_both = prusa(tmp_path, [(BODY, "ModelPart"), (second, "ModelPart"), (hole, "NegativeVolume")])
    assert volume(cut_both) == pytest.approx(2000 - 80)
    cut_one = prusa(tmp_path, [(BODY, "ModelPart"), (hole, "NegativeVolume"), (second, "ModelPart")])
    assert volume(cut_one) == pytest.approx(2000 - 40)
    idle = prusa(tmp_path, [(hole, "NegativeVolume"), (BODY, "ModelPart")])
    assert volume(idle) == pytest.approx(1000)
    assert load_mesh(idle).notes == ("1 negative volume with nothing before it to cut left out",)


SUBTYPES = '<config><object id="3"><part id="1" subtype="normal_part"/><part id="2" subtype="{}"/></object></config>'


@pytest.mark.parametrize("several_files", [False, True])
@pytest.mark.parametrize(
    ("subtype", "expected", "notes"),
    [
        ("negative_part", 960, ()),
        ("modifier_part", 1000, ("1 modifier left out",)),
        ("normal_part", 1008, ()),
        ("support_blocker", 1000, ("1 support blocker left out",)),
        ("support_enforcer", 1000, ("1 support enforcer left out",)),
    ],
)
def test_parts_of_orca_and_bambu(tmp_path, several_files, subtype, expected, notes):
    """By the id of their component, with the meshes in the model or in files of their own."""
    where = "object_1" if several_files else ""
    meshes = obj(1, BODY) + obj(2, HOLE)
    whole = group(3, component(1, path=where), component(2, path=where))
    parts = {"object_1": model_xml(meshes)} if several_files else {}
    path = package(
        tmp_path / "a.3mf",
        whole if several_files else meshes + whole,
        '<item objectid="3"/>',
        settings=(ORCA, SUBTYPES.format(subtype)),
        **parts,
    )
    assert volume(path) == pytest.approx(expected)
    assert load_mesh(path).notes == notes


@pytest.mark.parametrize(
    "transform", [shifted(50), "-1 0 0 0 1 0 0 0 1 50 0 0", "0 1 0 -1 0 0 0 0 1 0 0 0", "1 0 0 0 0 1 0 -1 0 0 0 0"]
)
def test_what_is_cut_out_moves_with_the_object(tmp_path, transform):
    """Shifted, mirrored, turned about z and x: the hole is where it was in the body; twice is twice."""
    resources = obj(1, BODY) + obj(2, HOLE) + group(3, component(1), component(2))
    items = f'<item objectid="3" transform="{transform}"/><item objectid="3" transform="{shifted(100)}"/>'
    path = package(tmp_path / "a.3mf", resources, items, settings=(ORCA, SUBTYPES.format("negative_part")))
    assert volume(path) == pytest.approx(2 * 960)
    turned = load_mesh(path).transformed([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).moved([5, 6, 7])
    assert slice_mesh(turned, pixel_mm=0.1, layer_mm=0.1).volume_mm3() == pytest.approx(2 * 960)


def test_a_mesh_is_negative_only_where_it_is_said_to_be(tmp_path):
    """The same mesh is a hole in one object and a pillar beside it."""
    resources = (
        obj(1, BODY) + obj(2, HOLE) + group(3, component(1), component(2)) + group(4, component(2, shifted(20)))
    )
    path = package(
        tmp_path / "a.3mf",
        resources,
        '<item objectid="3"/><item objectid="4"/>',
        settings=(ORCA, SUBTYPES.format("negative_part")),
    )
    assert volume(path) == pytest.approx(960 + 48)


def test_a_negative_part_cuts_only_its_own_object(tmp_path):
    """Another object through which it passes stays whole."""
    resources = (
        obj(1, BODY) + obj(2, HOLE) + group(3, component(1), component(2)) + obj(5, box([0, 0, 0], [10, 10, 3]))
    )
    path = package(
        tmp_path / "a.3mf",
        resources,
        '<item objectid="3"/><item objectid="5"/>',
        settings=(ORCA, SUBTYPES.format("negative_part")),
    )
    assert volume(path) == pytest.approx(960 + 12)


def test_an_open_or_inverted_negative_part_still_cuts(tmp_path):
    """Layers are combined, not surfaces: a hole that is inside out and lacks its lid is cut out all the same."""
    hole = Mesh(HOLE.vertices, [f for f in HOLE.faces[:, ::-1].tolist() if not (HOLE.vertices[f][:, 2] == 11).all()])
    resources = obj(1, BODY) + obj(2, hole) + group(3, component(1), component(2))
    path = package(
        tmp_path / "a.3mf", resources, '<item objectid="3"/>', settings=(ORCA, SUBTYPES.format("negative_part"))
    )
    assert volume(path) == pytest.approx(960)


def test_objects_that_are_not_to_be_filled_are_left_out(tmp_path):
    """Types of the core specification; "solidsupport" is printed solid. So are items marked as not printable told."""
    kinds = ["support", "other", "surface", "solidsupport"]
    resources = obj(9, BODY) + "".join(
        obj(k, box([20, 2 * k, 0], [30, 2 * k + 1, 1]), kind) for k, kind in enumerate(kinds)
    )
    resources += group(8, component(9), component(0))
    items = '<item objectid="8"/><item objectid="1"/><item objectid="2"/><item objectid="3"/>'
    items += f'<item objectid="9" printable="0" transform="{shifted(90)}"/>'
    path = package(tmp_path / "a.3mf", resources, items)
    assert volume(path) == pytest.approx(1000 + 10)
    expected = [f"1 object of type '{kind}' left out" for kind in kinds[:3]]
    assert sorted(load_mesh(path).notes) == sorted([*expected, "1 item marked as not printable left out"])


def test_a_build_of_nothing_solid_says_why(tmp_path):
    """All that there was is in the message."""
    path = package(tmp_path / "a.3mf", obj(1, BODY, "support"), '<item objectid="1"/>')
    with pytest.raises(InputError, match=r"a\.3mf: no triangles.*1 object of type 'support' left out"):
        load_mesh(path)


# Beams --------------------------------------------------------------------------------------------------------


def beams(number: int, beams_xml: str, attributes: str = "", mesh: Mesh | None = None) -> str:
    """An object with beams on (0, 0, 0), (0, 0, 10), (10, 0, 0), after a mesh if there is one."""
    own = [*mesh.vertices.tolist()] if mesh else []
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in [(0, 0, 0), (0, 0, 10), (10, 0, 0), *own])
    faces = "".join(f'<triangle v1="{a + 3}" v2="{b + 3}" v3="{c + 3}"/>' for a, b, c in mesh.faces) if mesh else ""
    given = f'radius="1" minlength="0.001" {attributes}' + ("" if "cap=" in attributes else ' cap="butt"')
    return (
        f'<object id="{number}" type="model"><mesh><vertices>{points}</vertices><triangles>{faces}</triangles>'
        f"<b:beamlattice {given}>{beams_xml}</b:beamlattice></mesh></object>"
    )


ROD = '<b:beams><b:beam v1="0" v2="1"/></b:beams>'


@pytest.mark.parametrize(
    ("attributes", "inner", "expected"),
    [
        ("", ROD, 10 * math.pi),
        ('cap="sphere"', ROD, 10 * math.pi + 4 / 3 * math.pi),
        ('cap="hemisphere"', ROD, 11.333 * math.pi),
        ("", '<b:beams><b:beam v1="0" v2="1" r1="2" r2="1"/></b:beams>', 70 / 3 * math.pi),
        ("", '<b:beams><b:beam v1="0" v2="1" r1="2"/></b:beams>', 40 * math.pi),
        ('cap="sphere"', '<b:beams><b:beam v1="0" v2="1" cap1="butt"/></b:beams>', 10 * math.pi + 2 / 3 * math.pi),
        (
            'b2:ballmode="mixed" b2:ballradius="2"',
            ROD + '<b2:balls><b2:ball vindex="2"/></b2:balls>',
            62 / 3 * math.pi,
        ),
        ('ballmode="mixed" ballradius="9"', ROD + '<b:balls><b:ball vindex="2" r="2"/></b:balls>', 62 / 3 * math.pi),
    ],
    ids=["butt", "sphere", "hemisphere", "cone", "r1-alone", "cap1", "ball", "ball-of-1.1"],
)
def test_beams_are_solid(tmp_path, attributes, inner, expected):
    """An object without a triangle, its default radius and caps, its balls."""
    path = package(tmp_path / "a.3mf", beams(1, inner, attributes), '<item objectid="1"/>', attributes=BEAMS)
    assert volume(path) == pytest.approx(expected, rel=0.01)


def test_beams_join_the_mesh_they_are_on_and_move_with_it(tmp_path):
    """In a component that is used twice, once mirrored; in metres."""
    small = Mesh(BODY.vertices * [1, 1, 0.1] + [-5, -5, 9], BODY.faces)
    inner = beams(1, ROD, mesh=small) + group(2, component(1), component(1, "-1 0 0 0 1 0 0 0 1 30 0 0"))
    path = package(tmp_path / "a.3mf", inner, '<item objectid="2"/>', attributes=BEAMS)
    assert volume(path) == pytest.approx(2 * (100 + 9 * math.pi), rel=0.01)
    tiny = '<item objectid="2" transform="0.001 0 0 0 0.001 0 0 0 0.001 0 0 0"/>'
    path = package(tmp_path / "m.3mf", inner, tiny, attributes=BEAMS, unit='unit="meter"')
    assert volume(path) == pytest.approx(2 * (100 + 9 * math.pi), rel=0.01)


@pytest.mark.parametrize(("mode", "share"), [("inside", 3), ("outside", 7), ("none", 10)])
def test_beams_are_clipped(tmp_path, mode, share):
    """By a mesh that is not built itself; the size is that of what is left inside."""
    clip = obj(5, box([-5, -5, 2], [5, 5, 5]))
    lattice = beams(1, ROD, f'clippingmode="{mode}" clippingmesh="5" representationmesh="5"')
    path = package(
        tmp_path / "a.3mf", clip + lattice, f'<item objectid="1" transform="{shifted(7)}"/>', attributes=BEAMS
    )
    assert volume(path) == pytest.approx(share * math.pi, rel=0.01)
    assert load_mesh(path).size_mm[2] == pytest.approx(3 if mode == "inside" else 10)


@pytest.mark.parametrize(
    ("inner", "attributes", "words"),
    [
        (ROD, 'clippingmode="inside" clippingmesh="77"', "clipped 'inside' of the object '77', which has no mesh"),
        (ROD, 'clippingmode="outside"', "object '', which has no mesh"),
        (ROD, 'cap="round"', "cap 'round'"),
        ('<b:beams><b:beam v1="0" v2="9"/></b:beams>', "", "vertex 9 of 3"),
        ('<b:beams><b:beam v1="0"/></b:beams>', "", "'v2'"),
        ('<b:beams><b:beam v1="0" v2="1" r1="0"/></b:beams>', "", "radius 0"),
    ],
)
def test_beams_that_cannot_be_are_refused(tmp_path, inner, attributes, words):
    """With the object, the vertex or the word."""
    path = package(tmp_path / "a.3mf", beams(1, inner, attributes), '<item objectid="1"/>', attributes=BEAMS)
    with pytest.raises(InputError, match=rf"a\.3mf.*{words}"):
        load_mesh(path)


def test_short_beams_are_counted(tmp_path):
    """Shorter than the file's own least length: ignored, as the specification says, with a note."""
    short = '<b:beams><b:beam v1="0" v2="1"/><b:beam v1="0" v2="2"/></b:beams>'
    path = package(
        tmp_path / "a.3mf",
        obj(9, BODY) + beams(1, short).replace('"0.001"', '"10.5"'),
        '<item objectid="1"/><item objectid="9"/>',
        attributes=BEAMS,
    )
    assert load_mesh(path).notes == ("2 beams shorter than minlength left out",)


# Extensions ---------------------------------------------------------------------------------------------------

EXTENSIONS = {
    "slices": f"{MS}slice/2015/07",
    "boolean operations": f"{CONSORTIUM}booleanoperations/2023/07",
    "displacement": f"{MS}displacement/2022/07",
    "volumetric data": f"{CONSORTIUM}volumetric/2022/01",
    "implicit functions": f"{CONSORTIUM}implicit/2023/12",
    "encryption (secure content)": f"{MS}securecontent/2019/04",
}


@pytest.mark.parametrize("name", EXTENSIONS)
def test_a_required_extension_is_refused_by_name(tmp_path, name):
    """In words, and as the file writes it."""
    attributes = f'xmlns:q="{EXTENSIONS[name]}" requiredextensions="q"'
    path = package(tmp_path / "a.3mf", obj(1, BODY), '<item objectid="1"/>', attributes=attributes)
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    assert f"requires the extension {name} (q: {EXTENSIONS[name]}), which is not read" in str(caught.value)


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ('xmlns:x="http://example.org/secret" requiredextensions="x"', "the extension x: http://example.org/secret"),
        ('requiredextensions="zz"', "the extension zz,"),
    ],
)
def test_an_unknown_required_extension_too(tmp_path, attributes, words):
    """By its prefix and address, and without one."""
    path = package(tmp_path / "a.3mf", obj(1, BODY), '<item objectid="1"/>', attributes=attributes)
    with pytest.raises(InputError, match=words):
        load_mesh(path)


def test_extensions_that_only_colour_may_be_required(tmp_path):
    """Materials, production, groups of triangles."""
    attributes = f'xmlns:m="{MS}material/2015/02" xmlns:t="{MS}trianglesets/2021/07" requiredextensions="m p t"'
    assert volume(
        package(tmp_path / "a.3mf", obj(1, BODY), '<item objectid="1"/>', attributes=attributes)
    ) == pytest.approx(1000)


def test_an_optional_extension_is_left_out_with_a_note(tmp_path):
    """So many objects; their own vertices are not taken for the mesh's; what is recommended is told."""
    uri = EXTENSIONS["displacement"]
    strange = (
        '<object id="{}"><d:displacementmesh><d:vertices><d:vertex x="0" y="0" z="99"/></d:vertices>'
        "</d:displacementmesh></object>"
    )
    sliced = obj(6, BODY.moved([20, 0, 0]), more='s:slicestackid="2"')
    path = package(
        tmp_path / "a.3mf",
        obj(1, BODY) + strange.format(4) + strange.format(5) + sliced,
        '<item objectid="1"/><item objectid="4"/><item objectid="5"/><item objectid="6"/>',
        attributes=f'xmlns:d="{uri}" xmlns:s="{EXTENSIONS["slices"]}" recommendedextensions="d"',
    )
    mesh = load_mesh(path)
    assert mesh.size_mm == pytest.approx((30, 10, 10))
    assert sorted(mesh.notes) == sorted(
        [
            f"displacement ({uri}) of 2 objects left out",
            f"slices ({EXTENSIONS['slices']}) of 1 object left out",
            f"the file recommends the extension displacement ({uri}), which is not read",
        ]
    )


def test_an_encrypted_part_is_named(tmp_path):
    """The key store of the secure content extension lists it."""
    path = package(
        tmp_path / "a.3mf", group(2, component(1, path="object_1")), '<item objectid="2"/>', object_1="\x00 not xml"
    )
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(
            "Secure/keystore.xml",
            '<k:keystore xmlns:k="x"><k:resourcedata path="/3D/Objects/object_1.model"/></k:keystore>',
        )
    with pytest.raises(InputError, match=r"object_1\.model is encrypted \(secure content\)"):
        load_mesh(path)


# Files made to hurt -------------------------------------------------------------------------------------------


def refused(path: Path, words: str) -> None:
    started = time.perf_counter()
    with pytest.raises(InputError, match=words) as caught:
        load_mesh(path, unit="mm")
    assert "\n" not in str(caught.value)
    assert time.perf_counter() - started < 20  # not the speed, but that it ends at all


@pytest.mark.parametrize("mesh", [True, False])
@pytest.mark.parametrize("deep", [8, 30, 90])
def test_components_that_multiply(tmp_path, mesh, deep):
    """Ten of ten of ten …: counted before they are made; without a mesh there is nothing to make."""
    first = obj(1, box([0, 0, 0], [1, 1, 1])) if mesh else group(1)
    resources = first + "".join(group(k, component(k - 1) * 10) for k in range(2, deep + 2))
    path = package(tmp_path / "a.3mf", resources, f'<item objectid="{deep + 1}"/>')
    refused(path, f"copies come to {12 * 10**deep} triangles, from 12" if mesh else "no triangles")


def test_components_that_are_too_deep_or_go_round(tmp_path):
    """A chain of 60 is fine, one of 300 is not, nor is a ring."""
    chain = obj(1, BODY) + "".join(group(k, component(k - 1)) for k in range(2, 300))
    assert volume(package(tmp_path / "a.3mf", chain, '<item objectid="60"/>')) == pytest.approx(1000)
    refused(package(tmp_path / "a.3mf", chain, '<item objectid="299"/>'), "nested over 100 deep")
    ring = group(1, component(3)) + group(2, component(1)) + group(3, component(2))
    refused(package(tmp_path / "a.3mf", ring, '<item objectid="1"/>'), "is part of itself")


def test_many_copies_that_are_meant_are_made(tmp_path):
    """A thousand links of a chain mail, and the same place twice, which is once."""
    items = "".join(
        f'<item objectid="1" transform="1 0 0 0 1 0 0 0 1 {12 * (k % 40)} {12 * (k // 40)} 0"/>' for k in range(1000)
    )
    mesh = load_mesh(package(tmp_path / "a.3mf", obj(1, BODY), items + items))
    assert (len(mesh.faces), mesh.volume_mm3) == (12000, pytest.approx(1e6))


def zipped(path: Path, model: str, method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("3D/3dmodel.model", model)
    return path


def test_zips_that_blow_up(tmp_path):
    """A hundred megabytes of spaces; other ways to pack; a name twice; one that climbs."""
    start = f'<model xmlns="{CORE}"><resources>'
    refused(zipped(tmp_path / "a.3mf", start + " " * 100_000_000), "unpacks from .* to 1000000")
    refused(zipped(tmp_path / "b.3mf", start + " " * 30_000_000), "16 MB without an element")
    good = model_xml(obj(1, BODY), '<item objectid="1"/>')
    refused(zipped(tmp_path / "c.3mf", good, zipfile.ZIP_BZIP2), "not packed with deflate")
    refused(zipped(tmp_path / "d.3mf", good, zipfile.ZIP_LZMA), "not packed with deflate")
    with (
        pytest.warns(UserWarning, match="Duplicate"),
        zipfile.ZipFile(zipped(tmp_path / "e.3mf", good), "a") as archive,
    ):
        archive.writestr("3D/3dmodel.model", good)
    refused(tmp_path / "e.3mf", "two entries called")
    with zipfile.ZipFile(zipped(tmp_path / "f.3mf", good), "a") as archive:
        archive.writestr("../../evil", "")
    refused(tmp_path / "f.3mf", "points outside")


def test_xml_made_to_hurt(tmp_path):
    """Entities that multiply, numbers of thousands of digits, settings that do not end."""
    good = model_xml(obj(1, BODY), '<item objectid="1"/>')
    laughs = '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    refused(zipped(tmp_path / "a.3mf", laughs + "<model>&b;</model>"), "document type")
    refused(zipped(tmp_path / "b.3mf", good.replace('v1="0"', f'v1="{"9" * 5000}"')), "a number that is none")
    refused(zipped(tmp_path / "c.3mf", good.replace('v1="0"', f'v1="{"9" * 30}"')), "a number that is none")
    refused(zipped(tmp_path / "d.3mf", good.replace('x="0"', 'x="1.2.3"')), "a number that is none")
    refused(
        zipped(tmp_path / "e.3mf", good.replace("<item ", '<item transform="nan 0 0 0 1 0 0 0 1 0 0 0" ')),
        "12 numbers",
    )
    refused(
        package(tmp_path / "f.3mf", obj(1, BODY), '<item objectid="1"/>', settings=(ORCA, "<config><obj")),
        "is broken",
    )
    refused(zipped(tmp_path / "g.3mf", "<html/>"), "begins with <html>")
    refused(zipped(tmp_path / "h.3mf", good.replace("</resources>", obj(1, BODY) + "</resources>")), "two objects 1")


def test_a_zip_is_a_3mf_by_what_is_in_it(tmp_path):
    """Called .zip or .stl, it is read; a zip of pictures is not one."""
    good = zipped(tmp_path / "a.zip", model_xml(obj(1, BODY), '<item objectid="1"/>'))
    assert volume(good) == pytest.approx(1000)
    (tmp_path / "b.stl").write_bytes(good.read_bytes())
    assert volume(tmp_path / "b.stl") == pytest.approx(1000)
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as archive:
        archive.writestr("1.png", b"\x89PNG")
    assert not recognises((tmp_path / "c.zip").read_bytes(), 100)
