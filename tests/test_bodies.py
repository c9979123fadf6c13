"""Bodies and colours of meshes: read, kept through correction, written and read again."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

import layerfix as lf
from layerfix.mesh.bodies import NO_COLOUR, Bodies, apart_by_colour
from layerfix.mesh.triangles import Mesh
from layerfix.surface.solids import solid_of, welded
from tests.making import box, joined, run_layerfix

RED, BLUE, GREEN = 0xD62728, 0x1F77B4, 0x2CA02C
FRAME = ("--pixel", "0.1mm", "--layer", "0.1mm", "--min-feature", "0.8mm")
KEPT = (".3mf", ".glb", ".obj")


def bodied(*parts: tuple[str, int | list[int], Mesh]) -> Mesh:
    """Meshes as bodies of one: name, colour (or one for each triangle), mesh."""
    whole = joined(*(mesh for _, _, mesh in parts))
    sizes = [len(mesh.faces) for _, _, mesh in parts]
    of = np.repeat(np.arange(len(parts), dtype=np.int32), sizes)
    each = [
        np.broadcast_to(np.array(colour, np.int32), size) for (_, colour, _), size in zip(parts, sizes, strict=True)
    ]
    names = tuple(name for name, _, _ in parts)
    return Mesh(
        whole.vertices, whole.faces, "part", bodies=Bodies(of, names, (0,) * len(parts), np.concatenate(each))
    )


def two_bodies() -> Mesh:
    """A red block with a green top, and a blue fin of 0.3 mm that stands in it."""
    block = box((0, 0, 0), (6, 5, 2))
    top = (block.vertices[block.faces][:, :, 2] == 2).all(axis=1)
    return bodied(("block", np.where(top, GREEN, RED).tolist(), block), ("a fin", BLUE, box((2, 1, 1), (2.3, 4, 5))))


def by_name(mesh: Mesh) -> dict[str, Mesh]:
    return {one.name: one for one in mesh.body_meshes()}


def area_mm2(mesh: Mesh, colour: int) -> float:
    a, b, c = (mesh.vertices[mesh.faces[mesh.bodies.colours == colour]][:, k] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("suffix", KEPT)
def test_what_is_written_is_read_again(tmp_path, suffix):
    """Names, colours and triangles, body by body."""
    part = two_bodies()
    lf.write(tmp_path / f"part{suffix}", part)
    again = by_name(lf.load_mesh(tmp_path / f"part{suffix}"))
    assert list(again) == ["block", "a fin"]
    for name, one in by_name(part).items():
        found = again[name]
        assert found.volume_mm3 == pytest.approx(one.volume_mm3, rel=1e-6)
        for colour in (RED, GREEN, BLUE, NO_COLOUR):
            assert area_mm2(found, colour) == pytest.approx(area_mm2(one, colour), rel=1e-6)


@pytest.mark.parametrize("suffix", KEPT)
def test_correction_keeps_bodies_and_colours(tmp_path, suffix):
    """The fin becomes as wide as F, in its own body and colour; the block is as it was."""
    lf.write(tmp_path / f"part{suffix}", two_bodies())
    run = run_layerfix("fix", tmp_path / f"part{suffix}", tmp_path / f"fixed{suffix}", *FRAME, "--json")
    assert run.code == 0, run.err
    fixed = by_name(lf.load_mesh(tmp_path / f"fixed{suffix}"))
    assert list(fixed) == ["block", "a fin"]
    assert fixed["block"].volume_mm3 == pytest.approx(60)
    assert area_mm2(fixed["block"], GREEN) == pytest.approx(30)
    fin = fixed["a fin"]
    assert np.ptp(fin.vertices[:, 0]) == pytest.approx(0.8, abs=0.06)
    assert set(fin.bodies.colours.tolist()) == {BLUE}
    assert all(solid_of(*welded(one)) is not None for one in fixed.values())


def test_a_new_triangle_has_the_colour_of_what_it_covers(tmp_path):
    """A closed part of two colours, a fin that is blue with a red block: what thickens the fin is blue."""
    block, fin = box((0, 0, 0), (6, 5, 2)), box((2, 1, 2), (2.3, 4, 5))
    whole = trimesh.boolean.union([trimesh.Trimesh(m.vertices, m.faces) for m in (block, fin)], engine="manifold")
    high = whole.triangles[:, :, 2].max(axis=1) > 2
    one = Mesh(whole.vertices, whole.faces.astype(np.int32), "part")
    part = bodied(("part", np.where(high, BLUE, RED).tolist(), one))
    lf.write(tmp_path / "part.3mf", part)
    run = run_layerfix("fix", tmp_path / "part.3mf", tmp_path / "fixed.3mf", *FRAME)
    assert run.code == 0, run.err
    fixed = lf.load_mesh(tmp_path / "fixed.3mf")
    at = fixed.vertices[fixed.faces]
    above = at[:, :, 2].min(axis=1) > 2.05
    assert above.sum() > 10
    assert set(fixed.bodies.colours[above].tolist()) == {BLUE}
    assert set(fixed.bodies.colours[at[:, :, 2].max(axis=1) < 1.9].tolist()) == {RED}
    assert solid_of(*welded(fixed)) is not None


def test_bodies_that_are_open_get_shells_in_their_colour(tmp_path):
    """A fin without its bottom is no solid: what thickens it stands beside its facets, and is blue, too."""
    fin = box((2, 1, 1), (2.3, 4, 5))
    bottom = (fin.vertices[fin.faces][:, :, 2] == 1).all(axis=1)
    opened = Mesh(fin.vertices, fin.faces[~bottom])
    lf.write(tmp_path / "part.3mf", bodied(("block", RED, box((0, 0, 0), (6, 5, 2))), ("fin", BLUE, opened)))
    run = run_layerfix("fix", tmp_path / "part.3mf", tmp_path / "fixed.3mf", *FRAME, "--surface", "smooth")
    assert run.code == 0, run.err
    assert "is no closed surface" in run.out
    found = by_name(lf.load_mesh(tmp_path / "fixed.3mf"))["fin"]
    assert set(found.bodies.colours.tolist()) == {BLUE}
    assert np.ptp(found.vertices[:, 0]) == pytest.approx(0.8, abs=0.06)


def test_what_a_format_does_not_hold_is_told(tmp_path):
    """STL holds neither bodies nor colours, PLY no bodies, voxels neither."""
    lf.write(tmp_path / "part.3mf", two_bodies())
    for target, more, said in (
        ("a.stl", (), "its 2 bodies and colours are not kept apart in STL"),
        ("a.ply", (), "its 2 bodies are not kept apart in PLY"),
        ("a.3mf", ("--surface", "voxels"), "its 2 bodies become one surface"),
    ):
        run = run_layerfix("fix", tmp_path / "part.3mf", tmp_path / target, *FRAME, *more, "--json")
        assert run.code == 0, run.err
        assert any(said in note for note in json.loads(run.out)["notes"]), run.out
    colours = lf.load_mesh(tmp_path / "a.ply").bodies.colours
    assert {RED, GREEN, BLUE} <= set(colours.tolist())


def test_objects_of_a_3mf_stay_objects(tmp_path):
    """Two items on the plate, one of two components: so they are written again; a name in quotes survives."""
    lf.write(tmp_path / "a.3mf", two_bodies())
    part = lf.load_mesh(tmp_path / "a.3mf")
    assert part.bodies.items == (0, 0)
    again = Bodies(part.bodies.of, ('"<a> & b', "b"), (0, 1), part.bodies.colours)
    lf.write(tmp_path / "b.3mf", Mesh(part.vertices, part.faces, "part", bodies=again))
    found = lf.load_mesh(tmp_path / "b.3mf").bodies
    assert (found.names, found.items) == (('"<a> & b', "b"), (0, 1))
    with zipfile.ZipFile(tmp_path / "b.3mf") as package:
        text = package.read("3D/3dmodel.model").decode()
    assert text.count("<item ") == 2
    assert trimesh.load_scene(tmp_path / "b.3mf").volume == pytest.approx(part.volume_mm3, rel=1e-6)


def test_obj_with_materials_and_groups(tmp_path):
    """Colours of materials in a file beside it; groups where there are no objects; what comes twice is one body."""
    (tmp_path / "looks.mtl").write_text("newmtl shiny red\nKd 1 0 0\nnewmtl other\nKd 0 0 1\n")
    block = box((0, 0, 0), (4, 4, 4))
    lines = ["mtllib looks.mtl", *(f"v {x} {y} {z}" for x, y, z in block.vertices.tolist())]
    for k, (a, b, c) in enumerate((block.faces + 1).tolist()):
        lines += [
            f"g {'even' if k % 2 == 0 else 'odd'}",
            f"usemtl {'shiny red' if k < 4 else 'other'}",
            f"f {a} {b} {c}",
        ]
    (tmp_path / "part.obj").write_text("\n".join(lines))
    part = lf.load_mesh(tmp_path / "part.obj")
    assert part.bodies.names == ("even", "odd")
    assert np.bincount(part.bodies.of).tolist() == [6, 6]
    assert sorted(part.bodies.colours.tolist()) == [0x0000FF] * 8 + [0xFF0000] * 4
    assert part.volume_mm3 == pytest.approx(64)


def test_vertices_are_doubled_only_where_colours_meet():
    """A square of two triangles: of one colour four vertices stay, of two six."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    for colours, count in (([RED, RED], 4), ([RED, BLUE], 6)):
        vertices, again, rgb = apart_by_colour(square, faces, np.array(colours, np.int32))
        assert len(vertices) == count
        assert (vertices[again] == square[faces]).all()
        assert [int.from_bytes(bytes(c)) for c in rgb[again[:, 0]].tolist()] == colours


@pytest.mark.parametrize("name", ["benchy.3mf"])
def test_real_files(name, tmp_path):
    """One object without colours has no bodies."""
    path = Path(__file__).parents[2] / "shared" / "meshes" / name
    if not path.exists():
        pytest.skip("needs the shared meshes")
    assert lf.load_mesh(path).bodies is None
