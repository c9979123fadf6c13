"""Kernels of the toolpaths against slow twins in numpy, scikit-image and plain Python."""

from __future__ import annotations

import math
from itertools import pairwise

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import ndimage
from skimage.measure import find_contours
from skimage.morphology import thin

from layerfix.bits import pack
from layerfix.fdm.chains import lengths_of, needed_points, simplified, trace_lines
from layerfix.fdm.fields import (
    BESIDE_MM,
    NO_LEVEL,
    bits_above,
    bits_higher,
    field_within,
    half_spacings,
    paint_balls,
    pixels_of,
    smoothed,
    take_off,
)
from layerfix.fdm.infill import join_lines, parted, rectilinear, scan
from layerfix.fdm.level_sets import level_loops
from layerfix.fdm.rings import SMOOTH_PX, WEIGHTS
from tests.pictures_as_text import images

seeds = st.integers(0, 2**32 - 1)
widths = st.sampled_from([64, 128])  # of a field: whole words
heights = st.integers(3, 40)


def field_of(seed: int, height: int, width: int, *, smooth: float = 2.0) -> np.ndarray:
    """Hills and valleys between -1 and 1, negative along the border."""
    random = np.random.default_rng(seed)
    field = ndimage.gaussian_filter(random.normal(size=(height, width)), smooth) if smooth else random.normal(
        size=(height, width))  # fmt: skip
    field = field / max(abs(field).max(), 1e-9)
    field[[0, -1]], field[:, [0, -1]] = -0.5, -0.5
    return field.astype(np.float32)


def mask_of(seed: int, height: int, width: int) -> np.ndarray:
    return np.random.default_rng([seed, 1]).random((height, width)) < 0.4


# Fields and bits


@given(seeds, heights, widths, st.floats(-0.5, 0.5))
def test_bits_above(seed, height, width, level):
    """The pixels above a level, packed; equal is not above."""
    field = field_of(seed, height, width).round(1)
    level = np.float32(round(level, 1))
    assert np.array_equal(bits_above(field, level), pack(field > level))


@given(seeds, heights, widths)
def test_bits_higher(seed, height, width):
    """The pixels where one field is above another."""
    field, other = field_of(seed, height, width).round(1), field_of(seed + 1, height, width).round(1)
    assert np.array_equal(bits_higher(field, other), pack(field > other))


@given(images())
def test_pixels_of(image):
    """All set pixels, row by row."""
    rows, columns = pixels_of(pack(image))
    assert np.array_equal(np.stack([rows, columns]), np.argwhere(image).T)


@given(seeds, heights, widths, st.floats(0.1, 0.6), st.floats(0.1, 1.0))
def test_half_spacings(seed, height, width, one, more):
    """Half of the bead's spacing: as usual, a quarter or a sixth of the thickness, or out of reach."""
    random = np.random.default_rng(seed)
    local = (random.random((height, width)) * 1.5).astype(np.float32) * (random.random((height, width)) < 0.7)
    thick = mask_of(seed, height, width)
    one, two, elsewhere = np.float32(one), np.float32(one + more), np.float32(0.2)
    half = np.full((height, width), np.float32(9))
    half_spacings(half, local, pack(thick), one, two, elsewhere)
    expected = np.select(
        [(local == 0) | thick, local < one, local <= two], [elsewhere, NO_LEVEL, local / 4], local / 6
    )
    assert np.array_equal(half, expected.astype(np.float32))


@given(seeds, heights, widths)
def test_take_off(seed, height, width):
    """Twice the half spacing is taken off, but for some pixels."""
    remaining, half = field_of(seed, height, width), field_of(seed + 1, height, width)
    keep = mask_of(seed, height, width)
    expected = np.where(keep, remaining, remaining - 2 * half)
    take_off(remaining, half, pack(keep))
    assert np.array_equal(remaining, expected)


@given(seeds, heights, st.floats(0, 1))
def test_smoothed(seed, height, reach):
    """OpenCV's blur on some pixels near a level, the field itself elsewhere: where it is not near in 64 beside it."""
    field, level = field_of(seed, height, 256), field_of(seed + 1, height, 256)
    where = mask_of(seed, height, 256)
    where[:, :64] = where[:, 192:] = False
    found = smoothed(field, level, pack(where), WEIGHTS, np.float32(reach))
    blurred = cv2.GaussianBlur(field, (0, 0), SMOOTH_PX, borderType=cv2.BORDER_REPLICATE)
    near = abs(field - level) < np.float32(reach)
    word = np.repeat(near.reshape(height, 4, 64).any(axis=2), 64, axis=1)
    assert np.allclose(found, np.where(where & word, blurred, field), atol=1e-6)
    assert np.array_equal(found[~(where & word)], field[~(where & word)])


@given(seeds, heights, widths, st.floats(-0.5, 0.5))
def test_field_within(seed, height, width, level):
    """The field less a level on some pixels; -1 on the others, but hardly below 0 where it is above the level."""
    field, where = field_of(seed, height, width), mask_of(seed, height, width)
    level = np.float32(level)
    expected = np.where(where, field - level, np.where(field > level, BESIDE_MM, np.float32(-1)))
    assert np.array_equal(field_within(field, pack(where), level), expected)


@given(seeds, heights, widths, st.integers(0, 12))
def test_paint_balls(seed, height, width, count):
    """The largest value of all discs over a pixel, each a pixel larger than its radius."""
    random = np.random.default_rng(seed)
    rows, columns = random.integers(0, height, count), random.integers(0, width, count)
    radii = (random.integers(0, 24, count) / 4).astype(np.float32)
    values = random.random(count).astype(np.float32)
    field = np.where(random.random((height, width)) < 0.1, np.float32(0.5), np.float32(0))
    expected = field.copy()
    y, x = np.mgrid[:height, :width]
    for row, column, radius, value in zip(rows, columns, radii, values, strict=True):
        inside = (y - row) ** 2 + (x - column) ** 2 <= (radius + 1) ** 2
        expected[inside] = np.maximum(expected[inside], value)
    paint_balls(field, rows, columns, radii, values)
    assert np.array_equal(field, expected)


# Loops


def loops_of(field: np.ndarray, level: np.ndarray) -> list[np.ndarray]:
    """Each (n, 3), closed by its first point."""
    points, starts = level_loops(field, level, bits_higher(field, level))
    assert starts[0] == 0
    assert starts[-1] == len(points)
    return [np.concatenate([points[a:b], points[a : a + 1]]) for a, b in pairwise(starts)]


def signed_area(loop: np.ndarray) -> float:
    """Positive when counter-clockwise with y up."""
    x, y = loop[:, 0], loop[:, 1]
    return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2)


def at(field: np.ndarray, points: np.ndarray) -> np.ndarray:
    return ndimage.map_coordinates(field.astype(float), points[:, 1::-1].T, order=1)


def has_saddle(high: np.ndarray) -> bool:
    """Whether two diagonal neighbours are high between two that are not: there the ways differ between programs."""
    a, b, c, d = high[:-1, :-1], high[:-1, 1:], high[1:, :-1], high[1:, 1:]
    return bool(((a == d) & (b == c) & (a != b)).any())


@settings(max_examples=80)
@given(seeds, heights, widths, st.floats(-0.2, 0.4), st.sampled_from([1.5, 3.0]))
def test_level_loops_are_those_of_skimage(seed, height, width, level, smooth):
    """As many, as long, and round as much."""
    field, level = field_of(seed, height, width, smooth=smooth), float(np.float32(level))
    assume(not has_saddle(field > np.float32(level)))
    loops = loops_of(field, np.full_like(field, level))
    contours = [c[:, ::-1] for c in find_contours(field.astype(float), level)]
    assert len(loops) == len(contours)
    both = loops, contours
    lengths, expected = (sorted(np.hypot(*np.diff(c[:, :2], axis=0).T).sum() for c in each) for each in both)
    assert lengths == pytest.approx(expected, rel=1e-3, abs=1e-2)
    areas, expected = (sorted(abs(signed_area(c)) for c in each) for each in both)
    assert areas == pytest.approx(expected, rel=1e-3, abs=1e-2)


@settings(max_examples=60)
@given(seeds, heights, widths, st.floats(-0.2, 0.4), st.sampled_from([0.0, 1.0, 3.0]))
def test_level_loops_lie_at_the_level(seed, height, width, level, smooth):
    """Also in noise with saddles: closed, from cell to cell, and the field is at the level along them."""
    field = field_of(seed, height, width, smooth=smooth)
    high = field > np.float32(level)
    loops = loops_of(field, np.full_like(field, level))
    crossings = (high[:, 1:] != high[:, :-1]).sum() + (high[1:] != high[:-1]).sum()
    assert sum(len(loop) - 1 for loop in loops) == crossings
    for loop in loops:
        assert at(field, loop) == pytest.approx(np.full(len(loop), level), abs=1e-4)
        assert np.hypot(*np.diff(loop[:, :2], axis=0).T).max() <= math.sqrt(2) + 1e-6
        assert loop[:, 2] == pytest.approx(np.full(len(loop), level), abs=1e-6)


@settings(max_examples=60)
@given(seeds, heights, widths, st.floats(-0.2, 0.4))
def test_level_loops_enclose_what_is_higher(seed, height, width, level):
    """Winding numbers are 1 at every pixel above the level and 0 at all others: no pixel is lost or gained."""
    field = field_of(seed, height, width)
    loops = loops_of(field, np.full_like(field, level))
    winding = np.zeros((height, width), int)
    centres = shapely.points(*np.meshgrid(np.arange(width), np.arange(height)))
    for loop in loops:
        if abs(signed_area(loop)) > 1e-9:
            polygon = shapely.Polygon(loop[:, :2])
            winding += np.where(shapely.covers(polygon, centres), 1 if signed_area(loop) < 0 else -1, 0)
    clear = abs(field - np.float32(level)) > 1e-3  # not on the loop itself
    assert np.array_equal(winding[clear], (field > np.float32(level)).astype(int)[clear])


def test_what_is_higher_lies_to_the_left():
    """Seen with y down: a hill is walked one way, a hole in it the other."""
    y, x = np.mgrid[:64, :64]
    away = np.hypot(x - 31.3, y - 30.8)
    ring = (10 - abs(away - 15)).astype(np.float32)
    outer, inner = sorted(loops_of(ring, np.zeros_like(ring)), key=len, reverse=True)
    assert signed_area(outer) < 0 < signed_area(inner)
    assert signed_area(outer) == pytest.approx(-math.pi * 25**2, rel=0.002)
    assert signed_area(inner) == pytest.approx(math.pi * 5**2, rel=0.01)
    here = (outer[:-1, :2] + outer[1:, :2]) / 2
    along = np.diff(outer[:, :2], axis=0)
    left = here + 0.3 * np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    assert (at(ring, left) > 0).all()


@given(seeds, heights, widths)
def test_loops_at_a_level_that_is_a_field(seed, height, width):
    """There the two are equal, and the third coordinate is the level."""
    field = field_of(seed, height, width)
    level = (0.1 + 0.1 * field_of(seed + 1, height, width)).astype(np.float32)
    level[[0, -1]], level[:, [0, -1]] = 0.1, 0.1
    for loop in loops_of(field, level):
        assert at(field, loop) == pytest.approx(at(level, loop), abs=1e-4)
        assert loop[:, 2] == pytest.approx(at(level, loop), abs=1e-5)


def test_loops_beside_a_level_out_of_reach_have_the_width_of_the_side_in_reach():
    """`NO_LEVEL` is no width: where the loop ends at it, its own level counts."""
    field = np.full((20, 64), -1, np.float32)
    field[5:15, 5:50] = 1
    level = np.full_like(field, 0.25)
    level[:, 25:] = NO_LEVEL
    (loop,) = loops_of(field, level)
    assert loop[:, 2] == pytest.approx(np.full(len(loop), 0.25))
    assert 23.9 < loop[:, 0].max() < 25


def test_no_loops_in_a_flat_field():
    """Nothing above, or nothing at all."""
    assert loops_of(np.full((9, 64), -1, np.float32), np.zeros((9, 64), np.float32)) == []


# One-pixel lines


@settings(max_examples=80)
@given(images(widths=st.sampled_from([40, 62, 100])))
def test_chains_cover_all_lines(image):
    """Every pixel is on a chain; steps go to neighbours; chains end at ends, junctions or where they began."""
    lines = np.pad(thin(image), 2)
    rows, columns = np.nonzero(lines)
    points, starts = trace_lines(np.zeros(lines.shape, np.uint8), rows.astype(np.int64), columns.astype(np.int64))
    chains = [points[a:b].astype(int) for a, b in pairwise(starts)]
    degree = ndimage.convolve(lines.astype(int), np.ones((3, 3), int), mode="constant") - lines
    covered, inner = np.zeros(lines.shape, bool), []
    for chain in chains:
        assert len(chain)
        covered[chain[:, 1], chain[:, 0]] = True
        if len(chain) > 1:
            assert (abs(np.diff(chain, axis=0)).max(axis=1) == 1).all()
        else:
            assert degree[chain[0, 1], chain[0, 0]] == 0
        closed = len(chain) > 2 and (chain[0] == chain[-1]).all()
        if not closed:
            for x, y in (chain[0], chain[-1]):
                assert degree[y, x] != 2
        assert (degree[chain[1:-1, 1], chain[1:-1, 0]] == 2).all()
        inner += [tuple(p) for p in chain[1:-1].tolist()]
    assert len(inner) == len(set(inner))  # no stretch is walked twice
    junctions = ndimage.binary_dilation(lines & (degree > 2), np.ones((3, 3)))
    assert (covered | junctions)[lines].all()
    assert not (covered & ~lines).any()


def test_chains_of_a_cross_a_ring_and_a_dot():
    """Four arms; one closed chain; one of a single pixel."""
    image = np.zeros((30, 64), bool)
    image[5, 2:15] = image[1:12, 8] = True  # a cross
    y, x = np.mgrid[:30, :64]
    image |= thin(abs(np.hypot(x - 40, y - 14) - 9) < 1.2)
    image[25, 5] = True
    rows, columns = np.nonzero(image)
    points, starts = trace_lines(np.zeros(image.shape, np.uint8), rows.astype(np.int64), columns.astype(np.int64))
    chains = [points[a:b] for a, b in pairwise(starts)]
    rings = [c for c in chains if len(c) > 2 and (c[0] == c[-1]).all()]
    assert len(rings) == 1
    assert sum(len(c) == 1 for c in chains) == 1
    arms = [c for c in chains if len(c) > 1 and c[:, 0].max() < 20]
    assert len(arms) == 4
    ends = {tuple(p) for c in arms for p in (c[0].tolist(), c[-1].tolist())}
    assert {(2, 5), (14, 5), (8, 1), (8, 11)} <= ends


# Simplification


def twin_of_needed_points(points: np.ndarray, tolerance: float) -> set[int]:
    """Douglas and Peucker by recursion, in place and in width."""

    def away(k: int, a: int, b: int) -> float:
        u, v = points[b] - points[a], points[k] - points[a]
        length2 = u[0] ** 2 + u[1] ** 2
        t = min(max((v[0] * u[0] + v[1] * u[1]) / length2, 0.0), 1.0) if length2 > 0 else 0.0
        return max((v[0] - t * u[0]) ** 2 + (v[1] - t * u[1]) ** 2, (v[2] - t * u[2]) ** 2)

    def between(a: int, b: int) -> set[int]:
        found = [(away(k, a, b), -k) for k in range(a + 1, b)]
        farthest, k = max(found, default=(0.0, 0))
        if farthest <= tolerance**2:
            return set()
        return between(a, -k) | {-k} | between(-k, b)

    return {0, len(points) - 1} | between(0, len(points) - 1)


@given(seeds, st.integers(2, 60), st.floats(0.01, 2), st.booleans())
def test_needed_points(seed, count, tolerance, closed):
    """Those that Douglas and Peucker keep; no point left out is farther from its piece, in place or in width."""
    random = np.random.default_rng(seed)
    points = np.cumsum(random.normal(size=(count, 3)) * [1, 1, 0.3], axis=0)
    if closed:
        points[-1] = points[0]
    keep = needed_points(points, tolerance)
    assert set(np.flatnonzero(keep).tolist()) == twin_of_needed_points(points, tolerance)
    kept = np.flatnonzero(keep)
    for a, b in pairwise(kept.tolist()):
        piece = shapely.LineString(points[[a, b], :2])
        for k in range(a + 1, b):
            assert shapely.distance(piece, shapely.Point(points[k, :2])) <= tolerance + 1e-9


def test_needed_points_of_a_straight_line_of_changing_width():
    """Straight and even needs its ends only; a width that bulges in the middle needs the middle."""
    even = np.column_stack([np.arange(21.0), np.zeros(21), np.full(21, 3.0)])
    assert np.flatnonzero(needed_points(even, 0.25)).tolist() == [0, 20]
    even[10, 2] = 4
    assert np.flatnonzero(needed_points(even, 0.25)).tolist() == [0, 9, 10, 11, 20]


def line_of(seed: int, count: int, step: float) -> np.ndarray:
    """A random walk of points x, y and spacing, in the middle of a mask of 64 × 64."""
    walk = np.cumsum(np.random.default_rng(seed).normal(size=(count, 3)) * [step, step, 0.3], axis=0)
    walk[:, :2] = np.abs((walk[:, :2] + 31) % 120 - 60)
    return walk


@given(st.lists(st.integers(0, 6), min_size=1, max_size=5), seeds)
def test_lengths_of_lines(counts, seed):
    points = line_of(seed, sum(counts) + 1, 5.0)
    starts = np.cumsum([0, *counts])
    wanted = [np.hypot(*np.diff(points[a:b, :2], axis=0).T).sum() for a, b in pairwise(starts.tolist())]
    np.testing.assert_allclose(lengths_of(points, starts), wanted, atol=1e-9)


@given(seeds, st.integers(2, 40), st.floats(0.1, 3), st.floats(0.05, 2), st.floats(1, 200))
def test_simplified_lines(seed, count, share, tolerance, turns):
    """The points that are needed, with the width in px, and the mean spacing of each piece."""
    line = line_of(seed, count, 3.0)
    finest = min(tolerance, np.hypot(*np.diff(line[:, :2], axis=0).T).sum() / turns)
    kept = line[needed_points(line * [1, 1, share], finest)]
    points, spacings = simplified(line, share, tolerance, turns)
    np.testing.assert_array_equal(points, kept[:, :2])
    np.testing.assert_allclose(spacings, (kept[1:, 2] + kept[:-1, 2]) / 2)


def twin_of_parted(points: np.ndarray, mask: np.ndarray) -> list[tuple[np.ndarray, bool]]:
    """The same, by looking at a list of all places where the line is looked at."""
    looked = [
        (*(points[k] + i / n * (points[k + 1] - points[k])), i == 0)
        for k in range(len(points) - 1)
        for n in [max(math.ceil(math.hypot(*(points[k + 1] - points[k]))), 1)]
        for i in range(n)
    ] + [(*points[-1], True)]
    within = [bool(mask[round(y), round(x)]) for x, y, _ in looked]
    cuts = [0, *(k for k in range(1, len(looked)) if within[k] != within[k - 1]), len(looked) - 1]
    parts = []
    for a, b in pairwise(cuts):
        if b > a:
            corners = [k for k in range(a + 1, b) if looked[k][2]]
            parts.append((np.array([looked[k][:2] for k in [a, *corners, b]]), within[a]))
    return parts


@given(seeds, st.integers(2, 9), st.floats(0.1, 30))
def test_parted_lines(seed, count, step):
    """Cut where they enter or leave a mask; the parts touch, and together they are the line."""
    points, mask = np.ascontiguousarray(line_of(seed, count, step)[:, :2]), mask_of(seed, 64, 64)
    cut, starts, inside = parted(points, pack(mask))
    parts = [(cut[a:b], within) for (a, b), within in zip(pairwise(starts.tolist()), inside.tolist(), strict=True)]
    wanted = twin_of_parted(points, mask)
    assert [within for _, within in parts] == [within for _, within in wanted]
    for (mine, _), (theirs, _) in zip(parts, wanted, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-12)


# Infill


ANGLES = st.sampled_from([math.pi / 4, -math.pi / 4, 0.3, 2.0])


@settings(max_examples=60)
@given(seeds, st.integers(20, 60), widths, ANGLES, st.floats(2.5, 9), st.floats(0, 9))
def test_scan_lines(seed, height, width, angle, spacing, offset):
    """They lie at exact multiples of the spacing and where the field is positive, and miss nothing wide enough."""
    field = field_of(seed, height, width, smooth=4)
    lines = scan(field, angle, spacing, offset)
    normal, along = np.array([-math.sin(angle), math.cos(angle)]), np.array([math.cos(angle), math.sin(angle)])
    for number, x0, y0, x1, y1 in lines.tolist():
        a, b = np.array([x0, y0]), np.array([x1, y1])
        assert a @ normal == pytest.approx(offset + number * spacing, abs=1e-6)
        assert b @ normal == pytest.approx(offset + number * spacing, abs=1e-6)
        assert (b - a) @ along > 0
        steps = a + np.arange(0.5, math.dist(a, b), 1.0)[:, None] * (b - a) / math.dist(a, b)
        assert (at(field, steps) > -0.05).all()
        for end, outwards in ((a, -along), (b, along)):  # within a pixel beyond its ends the field is not positive
            assert at(field, end + np.linspace(0, 1, 41)[:, None] * outwards).min() <= 1e-6
    assert (np.diff(lines[:, 0]) >= 0).all()
    solid = (field > 0).sum() / spacing
    if solid > 60:
        length = np.hypot(lines[:, 3] - lines[:, 1], lines[:, 4] - lines[:, 2]).sum()
        assert length == pytest.approx(solid, rel=0.35)


@settings(max_examples=60)
@given(seeds, st.integers(20, 60), widths, ANGLES, st.floats(2.5, 7))
def test_joined_lines_stay_inside(seed, height, width, angle, spacing):
    """Every line is walked once; the ways between them are short, forwards, and where the field allows it."""
    field = field_of(seed, height, width, smooth=4)
    lines = scan(field, angle, spacing, 0.5 * spacing)
    least = -0.05
    points, starts = join_lines(field, lines, 2.2 * spacing, least)
    assert len(points) == 2 * len(lines)
    walked = []
    for a, b in pairwise(starts.tolist()):
        chain = points[a:b]
        assert len(chain) % 2 == 0
        walked += [tuple(sorted(map(tuple, pair.tolist()))) for pair in chain.reshape(-1, 2, 2)]
        for end, start in zip(chain[1:-1:2], chain[2::2], strict=True):
            assert math.dist(end, start) < 2.2 * spacing
            t = np.linspace(0, 1, 30)[:, None]
            assert (at(field, end + t * (start - end)) >= least - 0.1).all()
    whole = [tuple(sorted([(x0, y0), (x1, y1)])) for _, x0, y0, x1, y1 in lines.tolist()]
    assert sorted(walked) == sorted(whole)


def test_a_square_is_one_zigzag():
    """No line is left alone where all can be joined."""
    field = np.full((80, 128), -1, np.float32)
    field[10:70, 10:100] = 1
    ways = rectilinear(field, math.pi / 4, 5.0, -0.5, np.zeros(2))
    assert len(ways) <= 2
    length = sum(np.hypot(*np.diff(way, axis=0).T).sum() for way in ways)
    assert length == pytest.approx(60 * 90 / 5, rel=0.2)
