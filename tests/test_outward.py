"""Bodies that are inside out: turned and told; hollows stay; layers and smooth surfaces are right either way."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix import correct, load_mesh, slice_mesh, surface_mesh
from layerfix.mesh.outward import turned_outwards
from layerfix.mesh.triangles import Mesh
from layerfix.surface.kinds import is_closed, usual_kind
from tests.making import box, inside_out, joined, run_layerfix, soup, sphere, write_stl

BLOCK = box((0, 0, 0), (20, 20, 5))
FIN = box((9.9, 0, 5), (10.1, 20, 12))  # stands on the block
ROOM = box((5, 5, 1), (8, 8, 4))  # within the block
POST = box((15, 15, -2), (18, 18, 9))  # through it
LID = box((0, 0, 5), (20, 20, 8))  # has four corners of the block
BLOCK_MM3, FIN_MM3, ROOM_MM3 = 2000.0, 28.0, 27.0


@pytest.mark.parametrize("how", [lambda mesh: mesh, soup], ids=["shared corners", "soup"])
@pytest.mark.parametrize(
    ("bodies", "turned", "volume_mm3"),
    [
        ([BLOCK], 0, BLOCK_MM3),
        ([inside_out(BLOCK)], 1, BLOCK_MM3),
        ([BLOCK, FIN], 0, BLOCK_MM3 + FIN_MM3),
        ([BLOCK, inside_out(FIN)], 1, BLOCK_MM3 + FIN_MM3),
        ([inside_out(BLOCK), inside_out(FIN)], 2, BLOCK_MM3 + FIN_MM3),
        ([BLOCK, inside_out(LID)], 1, BLOCK_MM3 + 1200.0),
        ([BLOCK, inside_out(ROOM)], 0, BLOCK_MM3 - ROOM_MM3),  # a hollow
        ([inside_out(BLOCK), ROOM], 1, BLOCK_MM3 - ROOM_MM3),  # and turned with what it is in
        ([inside_out(ROOM), inside_out(box((30, 0, 0), (31, 1, 1)))], 2, ROOM_MM3 + 1),
        ([inside_out(sphere(3, 24, 12))], 1, sphere(3, 24, 12).volume_mm3),
    ],
)
def test_what_is_turned(bodies, turned, volume_mm3, how):
    """By hand: which bodies are, how many the note names, and the volume of the result."""
    mesh = how(joined(*bodies))
    result = turned_outwards(mesh)
    assert result.volume_mm3 == pytest.approx(volume_mm3)
    words = {0: (), 1: ("1 body is inside out: turned",), 2: ("2 bodies are inside out: turned",)}
    assert result.notes == words[turned]
    assert (result is mesh) == (turned == 0)
    assert turned_outwards(result).notes == result.notes  # once


def test_one_that_crosses_another_is_told():
    """It may be meant as a hole; where both are, layers are empty, and a surface would mix two orientations."""
    mesh = joined(BLOCK, inside_out(POST))
    assert turned_outwards(mesh).notes == (
        "1 body is inside out, and crosses another: where both are, nothing is solid",
    )
    assert np.array_equal(turned_outwards(mesh).faces, mesh.faces)
    assert not is_closed(mesh)
    assert is_closed(joined(BLOCK, POST))


def nested(rng: np.random.Generator, low: np.ndarray, high: np.ndarray, depth: int) -> list[np.ndarray]:
    """Boxes beside and within each other, (2, 3) corners each."""
    if depth == 0 or (high - low).min() < 4:
        return []
    middle = (low[0] + high[0]) // 2
    found = []
    for start, stop in ((low[0], middle), (middle, high[0])):
        own = np.array([[start + 1, low[1] + 1, low[2] + 1], [stop - 1, high[1] - 1, high[2] - 1]])
        if (own[1] - own[0]).min() > 0 and rng.random() < 0.8:
            found += [own, *nested(rng, own[0], own[1], depth - 1)]
    return found


@given(st.integers(0, 2**32 - 1))
def test_what_is_solid_stays_solid(seed):
    """Random boxes in boxes, each facing either way: where windings are not 0, they are above 0 afterwards."""
    rng = np.random.default_rng(seed)
    corners = nested(rng, np.zeros(3), np.array([40.0, 20.0, 20.0]), 4)
    if not corners:
        return
    order = rng.permutation(len(corners))
    boxes = [(corners[k], bool(rng.random() < 0.5)) for k in order]
    mesh = joined(*(inside_out(box(*c)) if inverted else box(*c) for c, inverted in boxes))
    result = turned_outwards(mesh)
    places = np.argwhere(np.ones((40, 20, 20), np.bool_)) + 0.5

    def windings(faces: np.ndarray) -> np.ndarray:
        total = np.zeros(len(places), np.int64)
        for k, (c, _) in enumerate(boxes):
            way = np.sign(Mesh(mesh.vertices, faces[12 * k : 12 * k + 12]).volume_mm3)
            total += int(way) * ((places > c[0]) & (places < c[1])).all(axis=1)
        return total

    before, after = windings(mesh.faces), windings(result.faces)
    assert np.array_equal(before != 0, after > 0)
    assert (after >= 0).all()


@pytest.mark.parametrize("bodies", [[inside_out(BLOCK), inside_out(FIN)], [BLOCK, inside_out(FIN)]])
def test_smooth_surfaces_of_what_was_inside_out(bodies):
    """A trimesh, a STL file: one closed surface, outwards, as of the same part that was never inside out."""
    meshes = [joined(BLOCK, FIN), joined(*bodies)]
    made = []
    for mesh in meshes:
        stack = correct(slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2), min_feature_mm=0.8, mode="add_only")
        assert usual_kind(stack) == "smooth"
        made.append(surface_mesh(stack, kind="smooth", like=mesh))
    assert made[1].is_watertight
    assert made[1].volume == pytest.approx(made[0].volume)
    assert made[1].volume > BLOCK_MM3 + 3 * FIN_MM3


def test_from_the_command_line(tmp_path):
    """The note is there, in the summary, and the file that is written is whole."""
    source = write_stl(tmp_path / "part.stl", joined(BLOCK, inside_out(FIN)))
    done = run_layerfix("fix", source, tmp_path / "fixed.stl", "--pixel", "0.1mm", "--layer", "0.2mm",
                        "--min-feature", "0.8mm", "--mode", "add_only")  # fmt: skip
    assert done.code == 0, done.err
    assert "1 body is inside out: turned" in done.out + done.err
    again = load_mesh(tmp_path / "fixed.stl")
    assert again.notes == ()
    assert again.volume_mm3 > BLOCK_MM3 + 3 * FIN_MM3


def test_overlapping_bodies_unite_whichever_way_they_face(tmp_path):
    """As --fill nonzero does anyway; with "positive", what faces inwards is nothing, as asked."""
    sunk = box((9.9, 0, 1), (10.1, 20, 12))
    mixed = turned_outwards(joined(inside_out(BLOCK), inside_out(sunk)))
    assert mixed.notes == ("2 bodies are inside out: turned",)
    assert np.array_equal(mixed.faces, joined(BLOCK, sunk).faces)
    source = write_stl(tmp_path / "part.stl", joined(BLOCK, inside_out(LID)))
    how = ("--pixel", "0.1mm", "--layer", "0.5mm", "--min-feature", "0.4mm", "--json")
    for fill, volume_mm3, notes in (
        ("nonzero", 3200.0, ["1 body is inside out: turned"]),
        ("positive", BLOCK_MM3, []),
    ):
        done = run_layerfix("fix", source, tmp_path / f"{fill}.zip", *how, "--fill", fill)
        said = json.loads(done.out)
        assert said["volume_mm3"] == pytest.approx(volume_mm3, rel=0.02)
        assert [note for note in said["notes"] if "inside out" in note] == notes


def test_smooth_surfaces_are_of_shells_that_unite(tmp_path):
    """By other rules of filling, overlapping shells are no union: refused if asked for, else written as layers."""
    source = write_stl(tmp_path / "part.stl", joined(BLOCK, box((15, 15, 2), (25, 25, 9)), FIN))
    how = ("--pixel", "0.1mm", "--layer", "0.2mm", "--min-feature", "0.8mm", "--mode", "add_only")
    volumes = {}
    for fill in ("nonzero", "even_odd"):
        done = run_layerfix("fix", source, tmp_path / f"{fill}.stl", *how, "--fill", fill)
        assert done.code == 0, done.err
        volumes[fill] = load_mesh(tmp_path / f"{fill}.stl").volume_mm3
    assert volumes["nonzero"] - volumes["even_odd"] == pytest.approx(5 * 5 * 3, rel=0.1)
    done = run_layerfix("fix", source, tmp_path / "x.stl", *how, "--fill", "even_odd", "--surface", "smooth")
    assert done.code == 2
    assert (
        "a smooth surface unites shells, as --fill nonzero does, and these layers were filled by even_odd" in done.err
    )
