"""Ways of the nozzle that stay inside the part."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from shapely import LineString, Point, box

from layerfix.bits import pack
from layerfix.fdm import Path
from layerfix.fdm.travel import find_ways, ways_inside
from tests.beads import drawn, shape_of, stack_of


def ways(image: np.ndarray, ends: list[list[float]], longest: float = 1e9) -> list[np.ndarray | None]:
    """For each x0, y0, x1, y1 in px: the points between, or None."""
    counts, points = find_ways(
        pack(image), np.array(ends, float), np.ones(len(ends), bool), np.full(len(ends), longest)
    )
    stops = np.cumsum(np.maximum(counts, 0))
    return [None if n < 0 else points[s - n : s] for n, s in zip(counts.tolist(), stops.tolist(), strict=True)]


def a_plate() -> np.ndarray:
    """400 × 300 px with a hole of 200 × 100 px in the middle, and a block beside it."""
    image = np.zeros((320, 512), bool)
    image[10:310, 10:410] = True
    image[110:210, 110:310] = False
    image[10:310, 430:500] = True
    return image


def test_straight_round_and_not_at_all():
    """Straight beside the hole, round its nearer side, and not to the other block."""
    straight, around, away = ways(a_plate(), [[20, 50, 400, 60], [200, 100, 220, 220], [50, 50, 450, 50]])
    assert len(straight) == 0
    assert away is None
    length = LineString([(200, 100), *around, (220, 220)]).length
    best = np.hypot(90, 10) + 100 + np.hypot(90, 10) + 0  # along the corners at x = 110 and 310
    assert best <= length < 1.12 * best
    assert len(around) <= 4


def test_a_long_way_round_is_not_worth_it():
    """The limit counts the whole way."""
    ends = [[200, 100, 220, 220]]
    assert ways(a_plate(), ends, 290.0)[0] is None
    assert ways(a_plate(), ends, 320.0)[0] is not None


@pytest.mark.parametrize("width", [11, 14, 16, 30])
@pytest.mark.parametrize("shift", range(8))
def test_through_a_wall_of_two_nozzles_wherever_it_lies(width, shift):
    """Round a corner inside a wall, from 11 px on for every place on the grid of cells."""
    image = np.zeros((256, 256), bool)
    image[20 + shift : 20 + shift + width, 20:200] = True
    image[20 + shift : 200, 180 + shift : 180 + shift + width] = True
    found = ways(image, [[25, 20 + shift + width / 2, 180 + shift + width / 2, 190]])[0]
    assert found is not None
    assert 1 <= len(found) <= 4


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_way_stays_in_the_solid(seed):
    """Looked at every half pixel; and where nothing is found, the ends are apart or there is no room for a nozzle."""
    random = np.random.default_rng(seed)
    image = np.kron(random.random((24, 24)) < random.uniform(0.5, 0.9), np.ones((8, 8))).astype(bool)
    y, x = np.nonzero(image)
    if len(x) < 2:
        return
    picked = random.integers(0, len(x), (12, 2))
    ends = np.column_stack([x[picked[:, 0]], y[picked[:, 0]], x[picked[:, 1]], y[picked[:, 1]]]) + 0.5
    label, _ = ndimage.label(image, np.ones((3, 3)))
    wide, _ = ndimage.label(ndimage.binary_erosion(image, np.ones((9, 9))))
    for end, way in zip(ends, ways(image, ends.tolist()), strict=True):
        a, b = (end[1].astype(int), end[0].astype(int)), (end[3].astype(int), end[2].astype(int))
        if way is None:
            assert label[a] != label[b] or not wide[a] or wide[a] != wide[b]
            continue
        assert label[a] == label[b]
        line = LineString([end[:2], *way, end[2:]]) if (end[:2] != end[2:]).any() or len(way) else Point(end[:2])
        at = np.array([line.interpolate(t).coords[0] for t in np.arange(0, line.length + 0.25, 0.5)])
        near = ndimage.binary_dilation(image, np.ones((3, 3)))  # a way may touch the corner of a pixel
        assert near[np.floor(at[:, 1]).astype(int), np.floor(at[:, 0]).astype(int)].all()


def test_ways_of_paths_are_in_mm_and_between_parts_of_one_number():
    """Three beads on a ring and one on another part: round the hole inside the ring, none to the other."""
    ring = Point(15, 15).buffer(14) - Point(15, 15).buffer(6)
    stack = stack_of(drawn((60, 30), ring | box(40, 5, 55, 25)))

    def bead(x: float, y: float) -> Path:
        return Path(np.array([[x, y], [x + 0.5, y]]), np.array([0.4]), "Perimeter")

    paths = [bead(15, 5), bead(16, 5), bead(15, 24), bead(45, 15)]
    near, around, away = ways_inside(paths, [0, 0, 0, 1], stack[0].rows, stack)
    assert len(near) == 0
    assert away is None
    line = LineString([paths[1].points_mm[-1], *around, paths[2].points_mm[0]])
    assert shapely.buffer(shape_of(stack, stack[0]), 0.05).contains(line)
    assert 19 < line.length < 25  # half round a hole of 6 mm is 19 mm and more
    assert ways_inside(paths[:1], [0], stack[0].rows, stack) == ()
