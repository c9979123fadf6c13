"""Outlines corrected in place: only what is narrow is drawn, and what did not change comes back bit for bit."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

import layerfix as lf
from layerfix.layers.feature import feature_of_mm
from layerfix.outlines import narrow
from layerfix.outlines.regions import _drawn, _segments, change_in
from layerfix.outlines.windows import Window, windows_of
from tests.outlines_drawn import UNIT_MM, random_part, rings, shape_of

PIXEL_MM = 0.05
PX = PIXEL_MM / UNIT_MM
PLATE = shapely.box(0, 0, 10, 10).difference(shapely.Point(5, 5).buffer(2))
WALL = shapely.box(12, 0, 12.2, 10)


def corrected(*shapes, min_feature_mm=0.8, **options):
    """(the regions given, what came back)."""
    regions = [rings(shape) for shape in shapes]
    options = {"pixel_mm": PIXEL_MM, "unit_mm": UNIT_MM, **options}
    return regions, lf.correct_regions(regions, min_feature_mm=min_feature_mm, **options)


def changed_pixels(segments, places, min_feature_mm, keep_gaps_mm=None):
    """All windows' changes on one canvas, and its upper left pixel."""
    whole = next(iter(windows_of(None, segments, min_feature_mm / PIXEL_MM)))
    canvas = np.zeros((whole.height + 64, whole.width + 64), bool)
    for window in windows_of(places, segments, min_feature_mm / PIXEL_MM):
        found = change_in(window, segments, min_feature_mm, PIXEL_MM, "add_only", keep_gaps_mm)
        if found is not None:
            y, x = window.top - whole.top, window.left - whole.left
            part = canvas[y : y + window.height, x : x + window.width]
            part |= found[1][: part.shape[0], : part.shape[1]]
    return canvas, (whole.left, whole.top)


@pytest.mark.parametrize("seed", range(30))
def test_windows_change_what_the_whole_layer_changes(seed):
    """Pixel by pixel: no narrow place is missed, and no window's edge is seen."""
    rng = np.random.default_rng(seed)
    part, feature_mm = random_part(rng), float(rng.choice([0.4, 0.6, 0.8]))
    gap_mm = 0.1 if seed % 3 == 0 else None
    segments = _segments(rings(part), UNIT_MM / PIXEL_MM)
    places = narrow.narrow_places(segments, feature_mm / PIXEL_MM + 2)
    seen, _ = changed_pixels(segments, places, feature_mm, gap_mm)
    whole, _ = changed_pixels(segments, None, feature_mm, gap_mm)
    assert np.array_equal(seen, whole)


@pytest.mark.parametrize("seed", range(100, 112))
def test_outlines_change_only_within_a_pixel_of_what_changed(seed):
    """Elsewhere every corner stays, and polygons that are not near are the same arrays."""
    part = random_part(np.random.default_rng(seed))
    (before,), done = corrected(part)
    (after,) = done.regions
    segments = _segments(before, UNIT_MM / PIXEL_MM)
    pixels, (left, top) = changed_pixels(segments, None, 0.8)
    rows, columns = np.nonzero(pixels)
    x, y = (columns + left) * PX, -(rows + top) * PX
    zone = shapely.union_all(shapely.box(x - PX, y - 2 * PX, x + 2 * PX, y + PX)).buffer(2)
    old, new = (shape_of(region).difference(zone) for region in (before, after))
    nanometre = 1.5  # an edge gets a corner where it enters the zone, and corners are whole nanometres
    assert old.difference(new.buffer(nanometre)).area == new.difference(old.buffer(nanometre)).area == 0
    kept = {tuple(point) for polygon in after for ring in polygon for point in ring.tolist()}
    far = [point for polygon in before for ring in polygon for point in ring.tolist()]
    assert all(tuple(point) in kept for point in far if not zone.intersects(shapely.Point(point)))
    same = {id(polygon) for polygon in after}
    for polygon in before:
        if not shapely.Polygon(polygon[0], polygon[1:]).intersects(zone):
            assert id(polygon) in same
    assert all(ring.dtype == np.int64 for polygon in after for ring in polygon)
    assert all(shapely.Polygon(polygon[0], polygon[1:]).is_valid for polygon in after)


def test_a_wall_becomes_as_wide_as_f_and_the_plate_beside_it_stays():
    """0.2 mm to 0.8 mm, at both sides alike within a pixel."""
    (before,), done = corrected(shapely.union_all([PLATE, WALL]))
    (after,) = done.regions
    assert after[0] is before[0]
    left, bottom, right, top = shapely.bounds(shape_of(after[1:])) * UNIT_MM
    assert (left, right) == pytest.approx((11.7, 12.5), abs=PIXEL_MM)
    assert (bottom, top) == pytest.approx((0, 10), abs=1.5 * PIXEL_MM)
    assert done.added_mm2 == pytest.approx(6, abs=0.2)
    assert done.removed_mm2 == 0


@pytest.mark.parametrize("angle", [0, 17, 30, 45, 90])
def test_walls_at_every_angle_get_wide_enough(angle):
    """The corrected wall holds a disc nearly as wide as F wherever it is, and is nowhere much wider."""
    wall = shapely.affinity.rotate(shapely.box(-5, -0.1, 5, 0.1), angle)
    _, done = corrected(wall)
    body = shape_of(done.regions[0])
    inside = body.buffer(-(0.4 - PIXEL_MM) / UNIT_MM)
    middle = shapely.affinity.rotate(shapely.LineString([(-4.4, 0), (4.4, 0)]), angle)
    assert inside.buffer(PX).covers(shapely.affinity.scale(middle, 1 / UNIT_MM, 1 / UNIT_MM, origin=(0, 0)))
    assert shape_of(rings(wall.buffer(0.3 + 2 * PIXEL_MM))).covers(body)


@pytest.mark.parametrize("mode", ["add_only", "as_printed"])
@pytest.mark.parametrize("seed", range(200, 206))
def test_regions_stay_disjoint_and_lose_nothing(seed, mode):
    """Three regions that meet, cut across thin walls: no overlap, nothing added twice, none takes of another."""
    part = shapely.union_all([random_part(np.random.default_rng(seed)), PLATE, WALL])
    cut = shapely.box(3, 3, 20, 6)
    parts = [part.difference(cut), part.intersection(cut), shapely.box(30, 0, 34, 4)]
    before, done = corrected(*parts, mode=mode)
    old, new = ([shape_of(region) for region in regions] for regions in (before, done.regions))
    assert shapely.area(shapely.intersection(new[0], new[1])) * UNIT_MM**2 < 1e-6
    grown = shapely.union_all(new).area - shapely.union_all(old).area
    assert grown * UNIT_MM**2 == pytest.approx(done.added_mm2 - done.removed_mm2, abs=2e-5)
    if mode == "add_only":
        assert all(shapely.difference(a, b.buffer(2)).area == 0 for a, b in zip(old, new, strict=True))
        assert done.regions[2] is before[2]
        one = corrected(part, mode=mode)[1]
        assert done.added_mm2 == pytest.approx(one.added_mm2, rel=0.02)


def test_what_is_added_goes_to_the_nearest_region():
    """A wall of two materials is thickened in both, each beside its own."""
    upper, lower = shapely.box(12, 5, 12.2, 10), shapely.box(12, 0, 12.2, 5)
    _, done = corrected(upper, lower)
    _, bottom, _, _ = shapely.bounds(shape_of(done.regions[0])) * UNIT_MM
    _, _, _, top = shapely.bounds(shape_of(done.regions[1])) * UNIT_MM
    assert bottom == pytest.approx(5, abs=PIXEL_MM)
    assert top == pytest.approx(5, abs=PIXEL_MM)
    widths = [np.ptp(shapely.bounds(shape_of(region))[[0, 2]]) * UNIT_MM for region in done.regions]
    assert widths == pytest.approx([0.8, 0.8], abs=PIXEL_MM)


def test_walls_that_are_thin_only_as_regions_are_left_alone():
    """A strip of another material inside a plate: the solid there is not thin."""
    strip = shapely.box(2, 1, 2.2, 9)
    before, done = corrected(shapely.box(0, 0, 10, 10).difference(strip), strip)
    assert not done.changed
    assert all(a is b for a, b in zip(before, done.regions, strict=True))


@pytest.mark.parametrize(
    "shape",
    [
        shapely.box(0, 0, 50, 50),
        shapely.Point(0, 0).buffer(20),
        PLATE,
        shapely.union_all([shapely.box(0, 0, 5, 5), shapely.box(5.02, 0, 9, 5)]),  # a slit is not solid
        shapely.Polygon([(0, 0), (10, 0), (13, 8), (5, 14), (-3, 8)]),  # no corner under 90°
    ],
)
def test_where_nothing_is_narrow_nothing_is_drawn(shape):
    """Not one pixel, and the very lists come back."""
    (before,), done = corrected(shape)
    assert len(narrow.narrow_places(_segments(before, UNIT_MM / PIXEL_MM), 18.0)) == 0
    assert done.regions[0] is before
    assert not done.changed


def test_edges_through_pixels_centres_are_drawn_alike_in_every_window():
    """Two squares on their corners, joined by a dot as wide as F: whether it holds depends on single pixels."""
    square = shapely.affinity.rotate(shapely.box(0, 0, 5, 5), 45, origin=(0, 0))
    below = shapely.affinity.scale(square, 1, -1, origin=(0, 0))
    part = shapely.union_all([square, below, shapely.Point(0, 0).buffer(0.2)])
    segments = _segments(rings(part), UNIT_MM / PIXEL_MM)
    images = []
    for left in range(-100, -40, 3):
        rows, _ = _drawn(segments, Window(left, -60, -2 * left, 120, None))
        images.append(lf.unpack(rows, -2 * left)[:, -left - 30 : -left + 30])
    assert all(np.array_equal(images[0], image) for image in images[1:])


def notch(opening: float, turned: float, tip: tuple[float, float]) -> shapely.Polygon:
    """A wedge of void of so many degrees, its tip pointing down, turned about it."""
    half = 9 * np.tan(np.radians(opening / 2))
    wedge = shapely.Polygon([(0, 0), (-half, 9), (half, 9)])
    return shapely.affinity.translate(shapely.affinity.rotate(wedge, turned, origin=(0, 0)), *tip)


@pytest.mark.parametrize(("openings", "turned"), [((60, 25), 60), ((60, 25), -60), ((40, 10), 60), ((25, 90), 40)])
def test_a_neck_between_two_notches_is_found(openings, turned):
    """No two edges face each other there, only the notches' tips do."""
    notches = notch(openings[0], turned, (0, 0.05)), notch(openings[1], 180, (0, -0.05))
    part = shapely.box(-8, -8, 8, 8).difference(shapely.union_all(notches))
    segments = _segments(rings(part), UNIT_MM / PIXEL_MM)
    seen, _ = changed_pixels(segments, narrow.narrow_places(segments, 18.0), 0.8)
    whole, _ = changed_pixels(segments, None, 0.8)
    assert whole.any()
    assert np.array_equal(seen, whole)


def brute_force(segments, reach):
    """`narrow_places`, pair by pair."""
    pieces = narrow._pieces(segments, reach)
    found = np.zeros(len(pieces), bool)
    for i in range(len(pieces)):
        for j in range(i):
            facing = pieces[i, 4:6] @ pieces[j, 4:6] < narrow.FACING
            sides = [
                max((pieces[b, k : k + 2] - pieces[a, :2]) @ pieces[a, 4:6] for k in (0, 2)) > 1e-6
                for a, b in ((i, j), (j, i))
            ]
            a, b = (shapely.LineString(pieces[k, :4].reshape(2, 2)) for k in (i, j))
            if facing and all(sides) and shapely.distance(a, b) <= reach:
                found[[i, j]] = True
    x, y = pieces[found][:, 0:4:2], pieces[found][:, 1:4:2]
    return np.stack([x.min(1), y.min(1), x.max(1), y.max(1)], axis=1) if found.any() else np.empty((0, 4))


@pytest.mark.parametrize("seed", range(300, 306))
def test_narrow_places_are_those_of_all_pairs(seed):
    """The grid of cells leaves no pair out."""
    segments = _segments(rings(random_part(np.random.default_rng(seed), 6.0)), UNIT_MM / PIXEL_MM)[:60]
    assert np.array_equal(narrow.narrow_places(segments, 10.0), brute_force(segments, 10.0))


def test_gaps_are_kept():
    """Two thin walls 0.3 mm apart: one body, or two at least 0.1 mm apart."""
    walls = shapely.union_all([shapely.box(0, 0, 0.2, 8), shapely.box(0.5, 0, 0.7, 8)])
    joined = shape_of(corrected(walls)[1].regions[0])
    apart = shapely.get_parts(shape_of(corrected(walls, keep_gaps_mm=0.1)[1].regions[0]))
    assert joined.geom_type == "Polygon"
    assert len(apart) == 2
    assert shapely.distance(*apart) * UNIT_MM > 0.1 - PIXEL_MM


def test_as_printed_rounds_corners_everywhere():
    """A square loses what the disc does not reach: within a pixel's area (1 - π/4) F² in all."""
    _, done = corrected(shapely.box(0, 0, 5, 5), mode="as_printed")
    assert done.removed_mm2 == pytest.approx((1 - np.pi / 4) * 0.8**2, abs=0.03)
    assert done.added_mm2 == 0
    assert done.changed


def test_numbers_stay_what_they_are():
    """Floats in mm give floats, and the same places."""
    whole = corrected(WALL)[1]
    floats = lf.correct_regions(
        [[[ring * UNIT_MM for ring in polygon] for polygon in rings(WALL)]], min_feature_mm=0.8, pixel_mm=PIXEL_MM
    )
    assert floats.regions[0][0][0].dtype == np.float64
    a, b = shape_of(whole.regions[0]), shape_of(floats.regions[0])
    scaled = shapely.affinity.scale(b, 1 / UNIT_MM, 1 / UNIT_MM, origin=(0, 0))
    assert a.symmetric_difference(scaled).area * UNIT_MM**2 < 2e-5  # whole nanometres round 20 mm


def test_a_far_away_layer_is_the_same_layer():
    """Pixels lie on whole multiples of the pitch, wherever the part is: moved by 400 of them it comes out moved."""
    near, far = (corrected(shapely.affinity.translate(WALL, d, -d))[1] for d in (0, 20))
    moved = [[ring - np.array([20e6, -20e6], np.int64) for ring in polygon] for polygon in far.regions[0]]
    assert all(np.array_equal(a, b) for a, b in zip(near.regions[0][0], moved[0], strict=True))


def test_empty_regions_stay():
    """No polygons, no regions."""
    assert lf.correct_regions([], min_feature_mm=0.8).regions == []
    assert lf.correct_regions([[], []], min_feature_mm=0.8).regions == [[], []]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"min_feature_mm": 0}, "minimum feature 0 mm"),
        ({"min_feature_mm": -1}, "minimum feature -1 mm"),
        ({"min_feature_mm": math.nan}, "minimum feature nan mm"),
        ({"min_feature_mm": 1e9}, "20000000000 pixels of 50 µm; at most"),
        ({"unit_mm": 1e9}, "outlines of .* pixels of 50 µm long; at most"),
        ({"min_feature_mm": 0.05}, "under two pixels"),
        ({"pixel_mm": -1}, "pixel -1 mm"),
        ({"unit_mm": 0}, "unit 0 mm"),
        ({"mode": "thick"}, "mode='thick' is not known"),
        ({"keep_gaps_mm": -0.1}, "keep gaps of -0.1 mm"),
        ({"pixel_mm": 1e-5, "mode": "as_printed", "min_feature_mm": 0.02}, "use larger pixels"),
    ],
)
def test_what_cannot_be_is_refused(options, told):
    """One sentence with the value."""
    with pytest.raises(lf.LayerfixError, match=told):
        corrected(WALL, **options)


@pytest.mark.parametrize("ring", [[[0, 0], [1, 0], [1, 1]], np.zeros((2, 2)), np.zeros((4, 3))])
def test_rings_are_arrays_of_points(ring):
    """A list, two points and three columns are none."""
    with pytest.raises(lf.LayerfixError, match="a ring is an"):
        lf.correct_regions([[[ring]]], min_feature_mm=0.8)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_coordinates_are_finite(value):
    """One that is not, among those that are."""
    ring = np.array([[0, 0], [1, 0], [1, value]])
    with pytest.raises(lf.LayerfixError, match="no finite numbers"):
        lf.correct_regions([[[ring]]], min_feature_mm=0.8)


def test_f_is_that_of_correct():
    """The same pixels as `correct` has: a square of F's size is left alone, one a pixel narrower is not."""
    size = feature_of_mm(0.8, (PIXEL_MM, PIXEL_MM)).size_px[0] * PIXEL_MM
    assert not corrected(shapely.box(0, 0, size, 8))[1].changed
    assert corrected(shapely.box(0, 0, size - PIXEL_MM, 8))[1].changed
