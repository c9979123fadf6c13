"""Small pieces of a section that pixels join with their neighbour: found by their contours, kept by correction."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from layerfix import correct, slice_mesh
from layerfix.layers.verdict import judge
from layerfix.mesh.pieces import LARGEST_PX, small_pieces
from tests.making import box, cylinder, inside_out, joined, turned
from tests.test_coverage import segments_of


def blank() -> np.ndarray:
    return np.full((700, 11), ~np.uint64(0))


@settings(max_examples=150)
@given(st.integers(0, 10**6))
def test_each_small_compact_contour_once(seed):
    """Squares and triangles apart from each other, some large, their edges in any order, at their centroid."""
    rng = np.random.default_rng(seed)
    parts, wanted = [], []
    for k in range(rng.integers(1, 9)):
        middle = np.array([100 + 200.0 * (k % 3), 100 + 200.0 * (k // 3)]) + rng.uniform(-1, 1, 2)
        size = rng.choice([0.4, 3, 30, 31.9, 33, 80])
        corners = middle + size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])[: rng.integers(3, 5)]
        part = shapely.Polygon(corners)
        parts.append(part)
        if 2 * size <= LARGEST_PX:
            wanted.append((int(np.floor(part.centroid.y + 0.5)), int(np.floor(part.centroid.x + 0.5))))
    segments = segments_of(shapely.MultiPolygon(parts))
    found = small_pieces(np.ascontiguousarray(rng.permutation(segments)), blank())
    assert sorted(map(tuple, found.tolist())) == sorted(wanted)


def test_open_contours_and_holes_are_none():
    """A contour with a gap, and one the other way round; one whose middle is not solid."""
    ring = segments_of(shapely.box(10, 10, 15, 15))
    assert len(small_pieces(ring, blank())) == 1
    assert len(small_pieces(ring[:-1], blank())) == 0
    assert len(small_pieces(np.ascontiguousarray(ring[:, [2, 3, 0, 1]]), blank())) == 0
    assert len(small_pieces(np.empty((0, 4)), blank())) == 0
    assert len(small_pieces(ring, np.zeros_like(blank()))) == 0


@pytest.mark.parametrize("grow", ["both", "outward"])
def test_letters_keep_their_holes(grow):
    """An O, a C and an L, small and thin: they are thickened, and no dot is drawn in the middle of them."""
    ring = joined(cylinder(1.2, 1, 64), inside_out(cylinder(1.0, 1, 64)))
    bow = joined(box([4, 0, 0], [6, 0.2, 1]), box([4, 0, 0], [4.2, 2, 1]), box([4, 1.8, 0], [6, 2, 1]))
    stack = slice_mesh(joined(ring, bow), pixel_mm=0.05, layer_mm=0.2)
    plain = slice_mesh(joined(ring, bow), pixel_mm=0.05, layer_mm=0.2, hairlines=False)
    fixed = [correct(layers, min_feature_mm=0.5, grow=grow) for layers in (stack, plain)]
    for one, other in zip(*fixed, strict=True):
        assert np.array_equal(one.image(), other.image())


def near_wall(gap: float, degrees: float):
    """A wall, and beside it a post of 0.3 mm, a third of a pixel away: at most angles pixels join them."""
    return turned(joined(box([0, 0, 0], [2, 8, 1]), box([2 + gap, 4, 0], [2.3 + gap, 4.3, 1])), "z", degrees)


@pytest.mark.parametrize("degrees", [0, 9, 17, 30, 45, 62])
def test_a_post_that_nearly_touches_a_wall_is_kept(degrees):
    """The middle of it is printed, with a whole F around it; `check` counts it."""
    mesh = near_wall(0.03, degrees)
    stack = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2)
    plain = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2, hairlines=False)
    middle = turned(box([2.03, 4, 0], [2.33, 4.3, 1]), "z", degrees).bounds_mm.mean(axis=0)
    j, i = (int((stack.origin_mm[1] - middle[1]) / 0.1), int((middle[0] - stack.origin_mm[0]) / 0.1))
    for mode in ("as_printed", "add_only"):
        for layer in correct(stack, min_feature_mm=1.2, mode=mode):
            assert layer.image()[j - 1 : j + 2, i - 1 : i + 2].all()
    assert all(layer.small is None for layer in plain)
    verdicts = list(judge(stack, min_feature_mm=1.2))
    assert all(one.features_lost >= 1 and one.features_left == 0 for one in verdicts)


def test_what_is_printed_anyway_gets_nothing():
    """A cube of F's size, and a small one inside a large one."""
    mesh = joined(box([0, 0, 0], [1.2, 1.2, 0.4]), box([5, 0, 0], [12, 7, 0.4]), box([8, 3, 0], [8.3, 3.3, 0.4]))
    stack = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2)
    assert all(layer.small is not None and len(layer.small) >= 1 for layer in stack)
    for layer in correct(stack, min_feature_mm=1.2, mode="add_only"):
        assert layer.change.added_px == 0


def test_specks_that_are_to_stay_do_stay():
    """With `ignore_below_mm2` nothing is drawn around them."""
    mesh = joined(box([0, 0, 0], [4, 4, 0.4]), box([6, 2, 0], [6.2, 2.2, 0.4]))
    stack = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2)
    for layer, one in zip(
        correct(stack, min_feature_mm=1, mode="add_only", ignore_below_mm2=0.1), stack, strict=True
    ):
        assert np.array_equal(layer.image(), one.image())
        assert layer.change.ignored_px == 4


@pytest.mark.parametrize("place", np.linspace(0, 0.1, 6))
def test_pieces_that_hold_no_pixel_of_their_own(place):
    """A crumb beside a wall, that marks no pixel: a dot is drawn where it is; nothing breaks on the way."""
    mesh = joined(box([0, 0, 0], [2, 8, 0.4]), box([2.02 + place, 4, 0], [2.03 + place, 4.01, 0.4]))
    stack = slice_mesh(mesh, pixel_mm=0.1, layer_mm=0.2)
    for layer in correct(stack, min_feature_mm=1, mode="add_only"):
        assert 30 < layer.change.added_px < 90
    assert [one.features_left for one in judge(stack, min_feature_mm=1)] == [0, 0]
