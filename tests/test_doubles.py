"""Triangles that are there twice: drawn on both sides, exported again the other way round, or walls that touch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix import slice_mesh
from layerfix.mesh.closing import vertex_keys
from layerfix.mesh.doubles import any_doubles, without_doubles
from layerfix.mesh.triangles import Mesh
from tests.making import box, chosen_faces, inside_out, joined, soup, sphere, torus

CUBE = box([0, 0, 0], [2, 2, 2])


def both_sides(mesh: Mesh, chosen=slice(None)) -> Mesh:
    """The mesh and its chosen triangles again, reversed."""
    return Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[chosen][:, ::-1]]))


def volume(mesh: Mesh, **options) -> float:
    return slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.1, **options).volume_mm3()


@pytest.mark.parametrize("form", [lambda m: m, soup], ids=["shared", "soup"])
@pytest.mark.parametrize("fill", ["nonzero", "even_odd", "positive"])
def test_a_body_drawn_on_both_sides_is_the_body(form, fill):
    """As SketchUp exports: every face once each way. By winding numbers alone it would be nothing."""
    assert volume(form(both_sides(CUBE)), fill=fill) == pytest.approx(8)
    assert volume(form(both_sides(inside_out(CUBE))), fill=fill) == pytest.approx(8)


@pytest.mark.parametrize("chosen", [[0], [0, 1], [3, 4, 11], [2, 7, 8, 9], list(range(11))])
@pytest.mark.parametrize("again", [-1, 1], ids=["reversed", "same-way"])
def test_some_faces_again(chosen, again):
    """Exported twice, the same way or the other: the cube stays, closed, without gaps."""
    mesh = Mesh(CUBE.vertices, np.concatenate([CUBE.faces, CUBE.faces[chosen][:, ::again]]))
    stack = slice_mesh(soup(mesh), pixel_mm=0.1, layer_mm=0.1)
    assert stack.volume_mm3() == pytest.approx(8)
    assert all(layer.gaps is None for layer in stack)


@pytest.mark.parametrize("fill", ["nonzero", "even_odd", "positive"])
def test_bodies_that_touch_stay_as_they_are(fill):
    """Boxes that share a wall, drawn by the same triangles from both sides: the wall is inside, no surface."""
    row = joined(CUBE, CUBE.moved([2, 0, 0]), CUBE.moved([4, 0, 0]), CUBE.moved([2, 2, 0]), CUBE.moved([2, 0, 2]))
    assert any_doubles(vertex_keys(row.vertices), row.faces) or fill
    assert without_doubles(row.vertices, row.faces) is row.faces
    assert volume(row, fill=fill) == pytest.approx(5 * 8)


def test_touching_bodies_of_which_one_is_open():
    """A missing triangle elsewhere does not turn the inner wall into a surface."""
    pair = joined(CUBE, CUBE.moved([2, 0, 0]))
    corners = pair.vertices[pair.faces]
    lid = int(np.flatnonzero((corners[:, :, 1].min(axis=1) == 2) & (corners[:, :, 0].max(axis=1) == 4))[0])
    assert volume(chosen_faces(pair, np.arange(24) != lid)) == pytest.approx(16)


def test_a_cavity_drawn_on_both_sides_and_a_body_beside():
    """A body of another kind does not decide for the doubled one."""
    assert volume(joined(both_sides(CUBE), CUBE.moved([3, 0, 0]))) == pytest.approx(16)
    assert volume(joined(both_sides(CUBE), both_sides(CUBE.moved([3, 0, 0])))) == pytest.approx(16)
    hollow = joined(box([-1, -1, -1], [3, 3, 3]), both_sides(CUBE))
    assert volume(hollow) == pytest.approx(64)


def test_a_doubled_body_with_a_hole_in_it():
    """A triangle that is missing on both sides leaves a gap, which is closed as in any open mesh."""
    mesh = chosen_faces(CUBE, np.arange(12) != 4)
    stack = slice_mesh(both_sides(mesh), pixel_mm=0.1, layer_mm=0.1)
    assert stack.volume_mm3() == pytest.approx(8)


def test_a_sheet_drawn_on_both_sides_adds_nothing_to_a_body():
    """A fin without thickness, standing on a box: what it was before, nothing."""
    fin = Mesh([[0, 0, 2], [2, 2, 2], [2, 2, 4], [0, 0, 4]], [[0, 1, 2], [0, 2, 3]])
    assert volume(joined(CUBE, both_sides(fin))) == pytest.approx(8)


@given(st.integers(0, 2**32 - 1))
def test_any_subset_of_a_torus_may_be_doubled(seed):
    """Whichever triangles come again, some reversed and some not, the surface is the torus, each of it once."""
    rng = np.random.default_rng(seed)
    mesh = soup(torus(50, 20, 12, 8))
    again = np.flatnonzero(rng.random(len(mesh.faces)) < rng.choice([0.02, 0.1]))
    flip = rng.random(len(again)) < 0.5
    more = np.where(flip[:, None], mesh.faces[again][:, ::-1], mesh.faces[again])
    faces = np.concatenate([mesh.faces, more])
    result = without_doubles(mesh.vertices, np.ascontiguousarray(faces, np.int32))
    assert len(result) == len(mesh.faces)
    turned = Mesh(mesh.vertices, result)
    assert abs(turned.volume_mm3) == pytest.approx(mesh.volume_mm3)


@given(st.integers(0, 2**32 - 1))
def test_doubles_are_found_as_by_counting(seed):
    """The table of hashes says what a set of sorted corners says."""
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 3, (rng.integers(3, 9), 3)).astype(float)
    faces = rng.integers(0, len(points), (rng.integers(1, 9), 3)).astype(np.int32)
    places = [tuple(p) for p in points.tolist()]
    real = [frozenset(places[k] for k in face) for face in faces.tolist()]
    real = [corners for corners in real if len(corners) == 3]
    assert any_doubles(vertex_keys(points), faces) == (len(set(real)) < len(real))


def test_a_mesh_without_doubles_is_not_touched():
    """The same array comes back."""
    mesh = soup(sphere(5, 30, 20))
    assert without_doubles(mesh.vertices, mesh.faces) is mesh.faces
