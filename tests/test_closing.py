"""Closed or not, which side is out, and how loose ends are joined: fast kernels against slow twins."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix.mesh.closing import close_gaps, edges_balance, match_nearest, orient
from tests.making import box, chosen_faces, inside_out, joined, soup, sphere, torus

seeds = st.integers(0, 2**32 - 1)


def balance_by_counting(points: np.ndarray, faces: np.ndarray) -> bool:
    """The slow twin of `edges_balance`: every directed edge is counted in a dictionary."""
    places = [tuple(p) for p in np.round(points * 1024).astype(int).tolist()]
    count: Counter[tuple[tuple[int, ...], tuple[int, ...]]] = Counter()
    for face in faces.tolist():
        for k in range(3):
            a, b = places[face[k]], places[face[(k + 1) % 3]]
            count[a, b] += 1
            count[b, a] -= 1
    return not any(count.values())


def greedy_matching(ends: np.ndarray, starts: np.ndarray) -> list[int]:
    """The slow twin of `match_nearest`: of all pairs that are left, the nearest is joined."""
    distance = ((ends[:, None] - starts[None]) ** 2).sum(axis=2)
    partner = [-1] * len(ends)
    for _ in range(len(ends)):
        e, s = np.unravel_index(np.argmin(distance), distance.shape)
        partner[e] = int(s)
        distance[e], distance[:, s] = np.inf, np.inf
    return partner


def as_sets(faces: np.ndarray) -> set[tuple[int, ...]]:
    """The triangles with their direction, whichever corner they start at."""
    return {tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in faces}


def random_mesh(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A few random triangles on a coarse grid: many shared, doubled and degenerate edges; half of them balance."""
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 3, (rng.integers(3, 12), 3)).astype(float)
    faces = rng.integers(0, len(points), (rng.integers(1, 20), 3)).astype(np.int32)
    if rng.random() < 0.5:
        faces = np.concatenate([faces, np.roll(faces, 1, axis=1)[:, ::-1]])
        rng.shuffle(faces)
        if rng.random() < 0.3:
            faces = faces[1:]
    return points, np.ascontiguousarray(faces)


@given(seeds)
def test_the_hashed_balance_is_the_counted_one(seed):
    """`edges_balance` says of any triangles what counting their directed edges one by one says."""
    points, faces = random_mesh(seed)
    assert edges_balance(points, faces) == balance_by_counting(points, faces)


@pytest.mark.parametrize("mesh", [box([0, 0, 0], [1, 2, 3]), sphere(9, 20, 10), torus(9, 3, 20, 10)])
def test_a_closed_mesh_balances_and_one_without_any_of_its_triangles_does_not(mesh):
    """Shared or separate vertices, outwards or inside out: closed is closed, and one missing triangle is open."""
    for form in (mesh, soup(mesh), inside_out(mesh), joined(mesh, mesh)):
        assert edges_balance(form.vertices, form.faces)
    for missing in range(0, len(mesh.faces), 7):
        rest = chosen_faces(mesh, np.arange(len(mesh.faces)) != missing)
        if len(set(map(tuple, mesh.vertices[mesh.faces[missing]].tolist()))) == 3:
            assert not edges_balance(rest.vertices, rest.faces)


def test_a_flipped_triangle_does_not_balance():
    """One triangle turned over leaves its three edges unmatched."""
    mesh = box([0, 0, 0], [1, 1, 1])
    faces = mesh.faces.copy()
    faces[5] = faces[5, ::-1]
    assert not edges_balance(mesh.vertices, faces)


def test_vertices_that_differ_by_less_than_a_grid_step_are_one():
    """Corners that are apart by a tenth of 1/1024 close the mesh; by ten times as much they do not."""
    mesh = soup(box([0, 0, 0], [8, 8, 8]))
    shift = np.random.default_rng(1).uniform(-1, 1, mesh.vertices.shape)
    assert edges_balance(mesh.vertices + shift * 1e-4, mesh.faces)
    assert not edges_balance(mesh.vertices + shift * 1e-2, mesh.faces)


@given(seeds, st.floats(0, 0.45))
def test_flipped_triangles_are_turned_back(seed, share):
    """Of a connected closed surface any minority of flipped triangles is turned back; the rest is not touched."""
    rng = np.random.default_rng(seed)
    mesh = soup(torus(50, 20, 16, 10)) if rng.random() < 0.5 else torus(50, 20, 16, 10)
    flip = rng.permutation(len(mesh.faces)) < share * len(mesh.faces)
    faces = np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces)
    assert as_sets(orient(mesh.vertices, faces)) == as_sets(mesh.faces)


def test_orienting_keeps_a_patch_that_is_inside_out_as_a_whole():
    """A cavity is a shell that faces inwards: it stays, while a flipped triangle in it or around it is turned."""
    outer, hollow = box([0, 0, 0], [9, 9, 9]), inside_out(box([3, 3, 3], [6, 6, 6]))
    mesh = joined(outer, hollow)
    faces = mesh.faces.copy()
    faces[[2, 17]] = faces[[2, 17], ::-1]
    assert as_sets(orient(mesh.vertices, faces)) == as_sets(mesh.faces)


def test_orienting_an_open_surface_makes_neighbours_agree():
    """Missing triangles do not stop the others from agreeing with their neighbours."""
    rng = np.random.default_rng(3)
    mesh = torus(50, 20, 40, 24)
    mesh = chosen_faces(mesh, np.arange(len(mesh.faces)) % 11 != 0)
    flip = rng.random(len(mesh.faces)) < 0.2
    faces = np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces)
    assert as_sets(orient(mesh.vertices, faces)) == as_sets(mesh.faces)


@given(seeds)
def test_oriented_triangles_are_the_same_triangles(seed):
    """Whatever the mesh, orienting only ever turns triangles over; it adds, drops and reorders none."""
    points, faces = random_mesh(seed)
    result = orient(points, faces)
    assert result.shape == faces.shape
    same, reversed_ = (result == faces).all(axis=1), (result == faces[:, ::-1]).all(axis=1)
    assert (same | reversed_).all()


@given(seeds, st.integers(1, 25), st.booleans())
def test_matching_is_greedy_nearest_first(seed, count, on_a_grid):
    """`match_nearest` joins what trying all pairs joins, also where many distances are equal."""
    rng = np.random.default_rng(seed)
    ends, starts = rng.integers(0, 6, (2, count, 2)).astype(float) if on_a_grid else rng.random((2, count, 2))
    assert match_nearest(ends, starts).tolist() == greedy_matching(ends, starts)


def test_a_missing_segment_is_put_back():
    """A square without one side gets that side back, from the loose end to the loose start, its length in mm."""
    corners = np.array([[0, 0], [10, 0], [10, 10], [0, 10.0]])
    square = np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1)
    closed, lengths = close_gaps(square[[0, 2, 3]], (0.1, 0.3))
    assert closed[-1].tolist() == square[1].tolist()
    assert lengths == pytest.approx([3.0])
    assert close_gaps(square, (0.1, 0.3))[1].size == 0


def test_gaps_are_measured_in_mm_not_in_pixels():
    """With pixels three times as high as wide, the end 2 px to the side is nearer than the one 1 px above."""
    segments = np.array([[0, 50, 20, 50], [22, 50, 40, 50], [20, 51, 0, 51], [40, 51, 22.5, 51.0]])
    closed, lengths = close_gaps(segments, (0.1, 0.3))
    joins = {tuple(row) for row in closed[4:].tolist()}
    assert (20, 50, 22, 50) in joins
    assert lengths.min() == pytest.approx(0.2)


@given(seeds)
def test_closed_gaps_leave_no_loose_end(seed):
    """Whatever segments are given, afterwards as many arrive at each point as leave it."""
    rng = np.random.default_rng(seed)
    segments = rng.integers(-40, 40, (rng.integers(1, 30), 4)) / 4
    closed, lengths = close_gaps(segments, (0.05, 0.05))
    assert Counter(map(tuple, closed[:, :2].tolist())) == Counter(map(tuple, closed[:, 2:].tolist()))
    assert len(closed) == len(segments) + len(lengths)
    assert (lengths > 0).all()
