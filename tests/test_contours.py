"""Outlines of layers: exact ones keep every pixel, simplified ones the area, the topology and the tolerance."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from layerfix.errors import InputError
from layerfix.layers.correction import correct
from layerfix.mesh.slicing import slice_mesh
from layerfix.outlines import contours
from layerfix.outlines.contours import trace_contours
from layerfix.stack import LayerStack
from tests.making import thin_part
from tests.pictures_as_text import block, drawing, framed, images, picture, round_dot

WIDTHS = st.sampled_from((1, 63, 64, 65, 130))
PITCHES = st.sampled_from((1.0, 0.05, (0.05, 0.05), (0.019, 0.024), (0.3, 0.1)))
BIG_PX = 60  # from here on a simplified polygon can have the area of its pixels


def one(image: np.ndarray, pixel_mm: float | tuple[float, float] = 1.0) -> LayerStack:
    """A stack of this image alone."""
    return LayerStack.from_images([image], pixel_mm=pixel_mm, layer_mm=0.1)


def outlines(
    image: np.ndarray, tolerance_mm: float | None = None, pixel_mm: float | tuple[float, float] = 1.0
) -> shapely.MultiPolygon:
    return trace_contours(one(image, pixel_mm), tolerance_mm=tolerance_mm)[0]


def painted(polygons: shapely.MultiPolygon, stack: LayerStack) -> np.ndarray:
    """(H, W) bool: the pixels of the frame whose middle is inside."""
    x = stack.origin_mm[0] + (np.arange(stack.width) + 0.5) * stack.pixel_mm[0]
    y = stack.origin_mm[1] - (np.arange(stack.height) + 0.5) * stack.pixel_mm[1]
    shapely.prepare(polygons)
    return shapely.contains_xy(polygons, *np.meshgrid(x, y))


def solids(image: np.ndarray) -> int:
    """Pieces that hang together by the edges of pixels."""
    return ndimage.label(image)[1]


def holes(image: np.ndarray) -> int:
    """Of every solid taken alone, the voids that it parts from the outside.

    Voids of one solid that meet at a corner are two, as in a ring that closes at a corner only: a valid polygon
    has rings that pass no point twice. Two solids that enclose a void between them have no hole.
    """
    labels, _ = ndimage.label(framed(image, 1))
    boxes = ndimage.find_objects(labels)
    return sum(
        ndimage.label(framed(labels[box] != k, 1) | ~framed(np.ones_like(labels[box]), 1))[1] - 1
        for k, box in enumerate(boxes, 1)
    )


def counts(polygons: shapely.MultiPolygon) -> tuple[int, int]:
    """(polygons, holes)."""
    return len(polygons.geoms), int(shapely.get_num_interior_rings(polygons.geoms).sum()) if polygons.geoms else 0


def farthest_mm(polygons: shapely.MultiPolygon, exact: shapely.MultiPolygon, step_mm: float) -> float:
    """How far the outline strays from that of `exact`, looked at in steps."""
    points = shapely.get_coordinates(shapely.segmentize(polygons.boundary, step_mm))
    edges = shapely.STRtree(shapely.get_parts(exact.boundary))
    _, distance = edges.query_nearest(shapely.points(points), return_distance=True)
    return float(distance.max(initial=0.0))


def check_rings(polygons: shapely.MultiPolygon) -> None:
    """Closed, outer ones counter-clockwise, holes clockwise, as one valid MultiPolygon."""
    assert shapely.get_type_id(polygons) == shapely.GeometryType.MULTIPOLYGON
    assert shapely.is_valid_reason(polygons) == "Valid Geometry"
    for polygon in polygons.geoms:
        assert polygon.exterior.is_closed
        assert polygon.exterior.is_ccw
        assert not any(ring.is_ccw for ring in polygon.interiors)


# Exact outlines


@given(images(WIDTHS), PITCHES)
def test_exact_outlines_have_the_area_of_the_pixels(image, pixel_mm):
    """To the last digit, whatever the pixels' shape."""
    stack = one(image, pixel_mm)
    polygons = trace_contours(stack, tolerance_mm=0)[0]
    pixel_mm2 = stack.pixel_mm[0] * stack.pixel_mm[1]
    assert polygons.area / pixel_mm2 == pytest.approx(image.sum(), rel=1e-9, abs=1e-9)


@given(images(WIDTHS), PITCHES)
def test_exact_outlines_give_the_image_back(image, pixel_mm):
    """Painted on the frame again, every pixel is what it was."""
    stack = one(image, pixel_mm)
    again = painted(trace_contours(stack, tolerance_mm=0)[0], stack)
    assert np.array_equal(again, image), f"from\n{drawing(image)}\nto\n{drawing(again)}"


@given(images(WIDTHS))
def test_exact_outlines_are_valid_and_oriented(image):
    """Outer rings counter-clockwise, holes clockwise; no ring touches itself."""
    check_rings(outlines(image, 0))


@given(images(WIDTHS))
def test_exact_outlines_have_the_solids_and_holes_of_the_pixels(image):
    """A polygon for each solid, a ring for each void that a solid encloses."""
    assert counts(outlines(image, 0)) == (solids(image), holes(image)), drawing(image)


@given(images(WIDTHS, kinds=("blobs",)))
def test_holes_are_the_voids_where_nothing_meets_at_a_corner(image):
    """Grown until it is smooth, an image has as many holes as voids, by edges or by corners alike."""
    image = framed(image, 1).repeat(2, axis=0).repeat(2, axis=1)
    image = ndimage.binary_opening(ndimage.binary_closing(image, np.ones((3, 3))), np.ones((3, 3)))
    corners = image[:-1, :-1] != image[:-1, 1:]
    corners &= (image[:-1, :-1] == image[1:, 1:]) & (image[:-1, 1:] == image[1:, :-1])
    if not corners.any():
        voids = ndimage.label(~framed(image, 1), np.ones((3, 3)))[1] - 1
        assert counts(outlines(image, 0)) == (solids(image), voids)


@given(images(WIDTHS))
def test_exact_outlines_turn_at_every_point(image):
    """No corner lies on a straight line: runs of pixels are one edge."""
    for ring in shapely.get_parts(shapely.get_rings(outlines(image, 0).geoms) if image.any() else []):
        steps = np.diff(ring.coords, axis=0)
        along = steps[:, 0] != 0
        assert (along != np.roll(along, 1)).all()
        assert (np.abs(steps).sum(axis=1) == np.abs(steps).max(axis=1)).all()


# Simplified outlines


@given(images(WIDTHS), PITCHES)
def test_simplified_outlines_are_valid_and_keep_solids_and_holes(image, pixel_mm):
    """Whatever the picture, nothing vanishes, joins or crosses."""
    polygons = outlines(image, None, pixel_mm)
    check_rings(polygons)
    assert counts(polygons) == (solids(image), holes(image)), drawing(image)


@given(images(WIDTHS), PITCHES, st.sampled_from((0.05, 0.3, 0.5, 0.7, 1.0, 2.0, 5.0)))
def test_outlines_stay_within_the_tolerance(image, pixel_mm, share):
    """No point of the outline is farther from the pixels' edges, at corners and between them; from half a pixel on,
    straightened stairs add half a pixel to that."""
    stack = one(image, pixel_mm)
    tolerance_mm = share * min(stack.pixel_mm)
    exact, polygons = trace_contours(stack, tolerance_mm=0)[0], trace_contours(stack, tolerance_mm=tolerance_mm)[0]
    check_rings(polygons)
    assert counts(polygons) == counts(exact)
    allowed_mm = tolerance_mm + (max(stack.pixel_mm) / 2 if share >= 0.5 else 0)
    assert farthest_mm(polygons, exact, min(stack.pixel_mm) / 8) <= allowed_mm * (1 + 1e-6)


@pytest.mark.parametrize("pixel_mm", [1.0, (0.019, 0.024), (0.024, 0.019), (0.3, 0.1), (0.1, 0.3)])
@pytest.mark.parametrize("run", [1, 2, 3, 9, 30])
@pytest.mark.parametrize("steps", [1, 2, 5])
def test_steps_stay_within_half_a_pixel_and_the_tolerance(pixel_mm, run, steps):
    """A staircase, steep or shallow: the line through its steps is at most half a pixel from them."""
    image = np.zeros((steps + 1, run * (steps + 1)), bool)
    for k in range(steps + 1):
        image[k, max(run * k - 1, 0) : run * (k + 1)] = True
    for turned in (image, image.T):
        stack = one(framed(turned, 1), pixel_mm)
        exact, polygons = trace_contours(stack, tolerance_mm=0)[0], trace_contours(stack)[0]
        allowed_mm = (min(stack.pixel_mm) + max(stack.pixel_mm)) / 2
        assert farthest_mm(polygons, exact, min(stack.pixel_mm) / 20) <= allowed_mm * (1 + 1e-6)


def test_a_shallow_diagonal_of_square_pixels_is_a_line():
    """The line through long steps is within half a pixel of them, and simplification hardly moves it."""
    polygons, exact = (
        outlines(
            picture("""
                # # # # # # . . . . . . . . . . . . . . . . . .
                . . . . . # # # # # # # # # # . . . . . . . . .
                . . . . . . . . . . . . . . # # # # # # # # # #
            """),
            tolerance_mm,
        )
        for tolerance_mm in (None, 0)
    )
    assert farthest_mm(polygons, exact, 0.05) <= 0.6
    assert len(shapely.get_coordinates(polygons)) < len(shapely.get_coordinates(exact))


@given(images(WIDTHS, heights=st.integers(20, 60), kinds=("blobs",)), PITCHES)
def test_the_area_of_smooth_shapes_is_that_of_their_pixels(image, pixel_mm):
    """Within 0.1 % for each polygon of some size."""
    exact, polygons = outlines(image, 0, pixel_mm), outlines(image, None, pixel_mm)
    pixel_mm2 = exact.area / max(image.sum(), 1)
    for a, b in zip(exact.geoms, polygons.geoms, strict=True):
        if a.area > BIG_PX * pixel_mm2:
            assert b.area == pytest.approx(a.area, rel=1e-3)


@given(st.integers(1, 130), st.integers(1, 70), st.sampled_from((None, 0.3, 0.1)), PITCHES)
def test_rectangles_are_exact(width, height, share, pixel_mm):
    """Four corners, also when they are a pixel wide."""
    stack = one(block(height, width, 2), pixel_mm)
    dx, dy = stack.pixel_mm
    tolerance_mm = None if share is None else share * min(dx, dy)
    polygons = trace_contours(stack, tolerance_mm=tolerance_mm)[0]
    box = shapely.box(2 * dx, -2 * dy, (2 + width) * dx, -(2 + height) * dy)
    assert len(shapely.get_coordinates(polygons)) == 5
    assert shapely.hausdorff_distance(polygons, box) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("pixel_mm", [0.05, (0.05, 0.08)])
def test_a_circle_becomes_round(pixel_mm):
    """Steps are smoothed: edges of pixels are 27 % longer than the circle, the outline hardly 3 %."""
    dx, dy = np.broadcast_to(pixel_mm, 2)
    radius_mm = 4.0
    image = round_dot(radius_mm, 175, (dx, dy))
    exact, polygons = outlines(image, 0, (dx, dy)), outlines(image, None, (dx, dy))
    assert exact.length > 1.2 * math.tau * radius_mm
    assert polygons.length == pytest.approx(math.tau * radius_mm, rel=0.03)
    assert polygons.area == pytest.approx(exact.area, rel=1e-4)
    assert len(shapely.get_coordinates(polygons)) < len(shapely.get_coordinates(exact)) / 2


def test_a_greater_tolerance_needs_fewer_corners():
    """Down to some dozen for a disc of 80 px; the area stays."""
    image = round_dot(40, 91)
    numbers = []
    for tolerance_mm in (0, 0.5, 1, 2, 4):
        polygons = outlines(image, tolerance_mm)
        numbers.append(len(shapely.get_coordinates(polygons)))
        assert polygons.area == pytest.approx(image.sum(), rel=1e-3)
    assert numbers == sorted(numbers, reverse=True)
    assert numbers[-1] < 30


# Where it lies


def test_outlines_lie_where_the_pixels_are():
    """Row 0 is at the back: an F stands upright when y points up, at the frame's origin, in mm."""
    image = picture("""
        . . . . . .
        . # # # # .
        . # . . . .
        . # # # . .
        . # . . . .
        . # . . . .
        . . . . . .
        . . . . . .
    """)
    plain = one(image, (0.5, 0.25))
    stack = LayerStack(6, 8, (0.5, 0.25), plain.z_mm, plain.make, origin_mm=(10.0, 20.0))
    corners = [(1, 1), (5, 1), (5, 2), (2, 2), (2, 3), (4, 3), (4, 4), (2, 4), (2, 6), (1, 6)]
    expected = shapely.Polygon([(10 + 0.5 * x, 20 - 0.25 * y) for x, y in corners])
    found = trace_contours(stack, tolerance_mm=0)[0]
    assert found.geoms[0].normalize().equals_exact(expected.normalize(), 1e-12)
    assert found.bounds == pytest.approx((10.5, 18.5, 12.5, 19.75))


def test_layers_of_a_sliced_part_lie_where_the_part_is():
    """A plate from (10, 20) to (16, 24) and the fin on it."""
    contours = trace_contours(slice_mesh(thin_part().moved([10, 20, 0]), pixel_mm=0.05, layer_mm=0.1))
    assert contours[0].bounds == pytest.approx((10, 20, 16, 24), abs=0.05)
    assert contours[-1].bounds == pytest.approx((12, 20.5, 12.1, 23.5), abs=0.05)
    assert contours.z_mm[0].tolist() == [0, 0.1]


# Pictures that are hard


@pytest.mark.parametrize("tolerance_mm", [0, None, 0.3, 1.0, 3.0])
@pytest.mark.parametrize(
    ("text", "solid", "hollow"),
    [
        pytest.param(". . \n . .", 0, 0, id="nothing"),
        pytest.param("#", 1, 0, id="one pixel"),
        pytest.param("# . # \n . # . \n # . #", 5, 0, id="checkerboard"),
        pytest.param(". # . \n # . # \n . # .", 4, 0, id="four round a void"),
        pytest.param("# . . . \n . # . . \n . . # . \n . . . #", 4, 0, id="diagonal"),
        pytest.param("# # . . \n # # . . \n . . # # \n . . # #", 2, 0, id="pinch of two blocks"),
        pytest.param("# # # # \n # . # # \n # # . # \n # # # #", 1, 2, id="two voids that meet at a corner"),
        pytest.param("# # # # \n # . . # \n # . . . \n # # # #", 1, 0, id="a C that is open"),
        pytest.param("# # # . \n # . . # \n # . . # \n # # # #", 1, 1, id="a C that closes at a corner"),
        pytest.param("# # . \n # . # \n . # #", 2, 0, id="two parts joined at two corners"),
        pytest.param("# # # # # \n # . . . # \n # . # . # \n # . . . # \n # # # # #", 2, 1, id="island in a hole"),
        pytest.param(
            "# # # # # \n # . . # # \n # . # . # \n # # . . # \n # # # # #", 2, 1, id="island at two corners"
        ),
        pytest.param("# # # # \n # # . # \n # . # # \n # # # #", 1, 2, id="voids that meet the other way"),
        pytest.param("# # # # # \n # . # . # \n # # . # # \n # . # . # \n # # # # #", 1, 5, id="five voids"),
    ],
)
def test_pictures_that_are_hard(text, solid, hollow, tolerance_mm):
    """Solids and holes that meet at corners, by any tolerance."""
    image = picture(text)
    for turned in (image, image[:, ::-1], image.T, image[::-1]):
        for margin in (0, 1, 63):
            polygons = outlines(framed(turned, margin), tolerance_mm)
            check_rings(polygons)
            assert counts(polygons) == (solid, hollow)
            if tolerance_mm == 0:
                assert polygons.area == turned.sum()


def test_an_empty_layer_is_an_empty_multipolygon():
    """Nothing solid: still a MultiPolygon, by any tolerance."""
    for tolerance_mm in (0, None, 3):
        polygons = outlines(np.zeros((5, 70), bool), tolerance_mm)
        assert polygons.is_empty
        assert shapely.get_type_id(polygons) == shapely.GeometryType.MULTIPOLYGON


def test_a_full_frame_is_one_rectangle():
    """What reaches the frame ends there."""
    polygons = outlines(np.ones((40, 130), bool))
    assert polygons.equals(shapely.box(0, 0, 130, -40))


# The sequence


@pytest.fixture
def stack() -> LayerStack:
    """Nine layers, one of them empty, not at the origin."""
    random = np.random.default_rng(7)
    smooth = [ndimage.gaussian_filter(random.random((50, 70)), 3) for _ in range(9)]
    pictures = [picture_ < np.quantile(picture_, 0.1 * k) for k, picture_ in enumerate(smooth)]
    plain = LayerStack.from_images(pictures, pixel_mm=(0.05, 0.07), layer_mm=0.1, first_layer_mm=0.3)
    return LayerStack(70, 50, (0.05, 0.07), plain.z_mm, plain.make, origin_mm=(-1.0, 4.0))


def same(one: shapely.MultiPolygon, other: shapely.MultiPolygon) -> bool:
    """Equal to the last bit."""
    return shapely.to_wkb(one) == shapely.to_wkb(other)


def test_slices_and_iteration_agree_with_items(stack):
    """A sequence like any other; `each` gives the layers along."""
    contours = trace_contours(stack)
    assert len(contours) == len(stack) == 9
    items = [contours[k] for k in range(9)]
    assert all(map(same, contours, items))
    assert same(contours[-1], items[8])
    assert all(map(same, contours[2:7:2], items[2:7:2]))
    assert contours[2:7:2].z_mm.tolist() == stack.z_mm[2:7:2].tolist()
    for k, (layer, polygons) in enumerate(contours.each()):
        assert same(polygons, items[k])
        assert layer.z_mm == tuple(stack.z_mm[k])
    with pytest.raises(IndexError):
        contours[9]


def test_the_number_of_workers_changes_nothing(stack):
    """The same bits by one thread or eight."""
    alone = list(trace_contours(stack.with_workers(1)))
    assert all(map(same, alone, trace_contours(stack.with_workers(8))))


def test_layers_that_repeat_have_the_same_outlines(stack):
    """Where a stack knows that layers repeat, iterating makes their outlines once."""
    made = []

    def make(index):
        made.append(index)
        return stack[3]

    repeats = np.arange(9) > 0
    alike = LayerStack(70, 50, (0.05, 0.07), stack.z_mm, make, (-1.0, 4.0), repeats=repeats)
    assert len({shapely.to_wkb(polygons) for polygons in trace_contours(alike)}) == 1
    assert made == [0]


def test_the_input_is_untouched(stack):
    """Layers have the same rows before and after."""
    before = [layer.rows.copy() for layer in stack]
    for tolerance_mm in (0, None, 0.2):
        list(trace_contours(stack, tolerance_mm=tolerance_mm))
    assert all(np.array_equal(rows, layer.rows) for rows, layer in zip(before, stack, strict=True))


# Errors


@pytest.mark.parametrize("tolerance_mm", [-0.1, math.inf, -math.inf, math.nan])
def test_a_tolerance_that_makes_no_sense(stack, tolerance_mm):
    """The message names it."""
    with pytest.raises(InputError, match=rf"tolerance {tolerance_mm} mm: it must be 0 or more"):
        trace_contours(stack, tolerance_mm=tolerance_mm)


def test_a_tolerance_above_the_feature_would_undo_the_correction(stack):
    """Refused once it is known that layers were corrected for a smaller feature; up to it is fine."""
    fixed = correct(stack, min_feature_mm=0.4)
    assert trace_contours(fixed, tolerance_mm=0.35)[4].area > 0
    with pytest.raises(InputError, match=r"tolerance 0\.5 mm is larger than the minimum feature of 0\.4 mm"):
        trace_contours(fixed, tolerance_mm=0.5)[4]
    with pytest.raises(InputError, match=r"tolerance 0\.5 mm"):
        list(trace_contours(fixed, tolerance_mm=0.5))
    assert trace_contours(stack, tolerance_mm=0.5)[4].area > 0


def ring(points: np.ndarray) -> contours.Rings:
    """One closed ring."""
    return contours.Rings(np.asarray(points, float), np.array([0, len(points)]), np.array([0]))


def sides_from(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Signed distance of each side's line from `centre`, positive to its left."""
    along = np.roll(points, -1, axis=0) - points
    left = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    return ((centre - points) * left).sum(axis=1)


@given(st.integers(4, 12), st.floats(0, 1), st.floats(0.8, 1.25), st.integers(0, 99), st.booleans())
def test_a_ring_grows_by_the_same_at_every_side(corners, turn, growth, seed, is_hole):
    """Any convex ring without sharp corners: each side moves by what is missing over the ring's length, its corners
    along; a hole of a smaller area moves inwards as far.
    """
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi * (np.arange(corners) + turn + 0.2 * rng.random(corners)) / corners
    points = 5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if is_hole:
        points = points[::-1]
    before = ring(points)
    area = before.areas()[0]
    length = np.hypot(*(np.roll(points, -1, axis=0) - points).T).sum()
    by = (growth - 1) * area / length
    after = contours._grown(before, np.array([area * growth]))
    moved = sides_from(after.points, np.zeros(2)) - sides_from(points, np.zeros(2))
    assert moved == pytest.approx(np.full(corners, by), abs=1e-9)


def test_several_rings_grow_each_by_its_own():
    """A square that lacks area, one that has its own, and a hole: corners where they must be, to the digit."""
    square = np.array([[0, 0], [10, 0], [10, 10], [0, 10]], float)
    points = np.concatenate([square, square + 20, square[::-1] + 40])
    rings = contours.Rings(points, np.array([0, 4, 8, 12]), np.array([0, 1]))
    after = contours._grown(rings, np.array([108.0, 100.0, -96.0])).points
    out = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    assert after[:4] == pytest.approx(square + 0.2 * out)
    assert np.array_equal(after[4:8], square + 20)
    assert after[8:] == pytest.approx((square - 0.1 * out)[::-1] + 40)


def test_a_tip_does_not_shoot_away():
    """At the tip of a needle the sides' lines meet far out; it moves by no more than about the sides do."""
    needle = np.array([[0, -0.1], [10, 0], [0, 0.1]])
    after = contours._grown(ring(needle), np.array([3.0]))
    by = (3.0 - 1.0) / (0.2 + 2 * math.hypot(10, 0.1))
    assert 0 < math.dist(after.points[1], needle[1]) < by


@pytest.mark.parametrize("radius", [4.5, 6.0, 9.0])
def test_small_discs_keep_their_area_closely(radius):
    """Moving the sides once leaves what the corners make of it, 1e-6 to 1e-5 of such a disc; twice leaves 1e-10."""
    image = round_dot(radius, 31)
    polygons = outlines(image, None, (1.0, 1.0))
    assert polygons.area == pytest.approx(image.sum(), rel=1e-8)
