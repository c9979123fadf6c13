"""Filling: pixel centres exactly, and of what is thinner than a pixel one line of pixels, whole and apart."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Polygon
from shapely.ops import unary_union

from layerfix import correct, slice_mesh
from layerfix.bits import unpack, words_for
from layerfix.mesh.fill import NONZERO, fill, sort
from tests import slow_twin
from tests.making import box, joined, turned
from tests.pictures_as_text import drawing

SIZE = 48
GRID = 1 / 1024  # px; what slicing snaps to


def snapped(shape: shapely.Geometry) -> shapely.Geometry:
    """On the grid, as vertices of a mesh are."""
    return shapely.set_precision(shape, GRID)


def segments_of(shape: shapely.Geometry) -> np.ndarray:
    """(n, 4) with the solid on the left, y up; rows run downwards, so in rows rings are walked the other way."""
    parts = []
    for polygon in getattr(shape, "geoms", [shape]):
        polygon = shapely.geometry.polygon.orient(polygon, -1.0)
        for ring in (polygon.exterior, *polygon.interiors):
            points = np.asarray(ring.coords)
            parts.append(np.concatenate([points[:-1], points[1:]], axis=1))
    return np.ascontiguousarray(np.concatenate(parts))


def filled(shape: shapely.Geometry, *, thin: bool = True) -> np.ndarray:
    """The pixels of a shape in px, x right and y down."""
    rows = np.zeros((SIZE, words_for(SIZE)), np.uint64)
    fill(segments_of(shape), SIZE, NONZERO, thin, rows)
    return unpack(rows, SIZE)


@st.composite
def strokes(draw: st.DrawFn, count: int = 1, widths: tuple[float, float] = (0.01, 3.0)) -> shapely.Geometry:
    """Bent strokes of any width, on the grid."""
    number = st.floats(3, SIZE - 4)
    shapes = []
    for _ in range(draw(st.integers(1, count))):
        points = draw(st.lists(st.tuples(number, number), min_size=2, max_size=4, unique=True))
        width = draw(st.one_of(st.floats(*widths), st.floats(widths[0], 0.5)))
        shapes.append(LineString(points).buffer(width / 2, cap_style="flat", join_style="mitre", mitre_limit=2))
    return snapped(unary_union(shapes))


def pieces_of(shape: shapely.Geometry) -> list[Polygon]:
    return [piece for piece in getattr(shape, "geoms", [shape]) if piece.geom_type == "Polygon" and piece.area > 0]


@given(st.lists(st.integers(-1000, 1000), max_size=3000))
def test_sort(numbers):
    """As Python sorts."""
    values = np.array(numbers, np.int64)
    sort(values)
    assert values.tolist() == sorted(numbers)


def test_sort_of_many():
    """More than the first gap."""
    values = np.random.default_rng(1).integers(0, 1 << 40, 200_000)
    expected = np.sort(values)
    sort(values)
    assert np.array_equal(values, expected)


@settings(max_examples=300)
@given(strokes(count=4))
def test_plain_fill_is_the_pixels_whose_centres_are_inside(shape):
    """Against shapely, but for centres on the outline itself."""
    pieces = pieces_of(shape)
    if not pieces:
        return
    y, x = np.mgrid[:SIZE, :SIZE]
    centres = shapely.points(x.ravel(), y.ravel())
    inside = shapely.contains(shape, centres).reshape(SIZE, SIZE)
    on = (shapely.distance(shape.boundary, centres) < 1e-4).reshape(SIZE, SIZE)
    assert not ((filled(shape, thin=False) != inside) & ~on).any()


@settings(max_examples=600)
@given(strokes())
def test_a_stroke_of_any_width_is_one_line(shape):
    """One piece in, one 8-connected component out; plain pixels stay; every mark is within a pixel of the piece."""
    pieces = pieces_of(shape)
    if len(pieces) != 1:
        return
    image, plain = filled(shape), filled(shape, thin=False)
    assert slow_twin.components(image) == 1, f"\n{drawing(image)}"
    assert not (plain & ~image).any()
    y, x = np.nonzero(image & ~plain)
    marks = shapely.box(x - 1, y - 1, x + 1, y + 1)
    assert shapely.dwithin(marks, shape, 1e-6).all()


@settings(max_examples=400)
@given(strokes(count=5))
def test_every_piece_is_there_and_only_near_ones_join(shape):
    """No fewer components than there are pieces farther than √5 px from one another, no more than pieces."""
    pieces = pieces_of(shape)
    if not pieces:
        return
    image = filled(shape)
    y, x = np.nonzero(image)
    pixels = shapely.box(x - 1, y - 1, x + 1, y + 1)
    tree = shapely.STRtree(pixels)
    assert all(len(tree.query(piece, predicate="intersects")) for piece in pieces)
    apart = pieces_of(unary_union([piece.buffer(1.13) for piece in pieces]))
    assert len(apart) <= slow_twin.components(image) <= len(pieces)


@settings(max_examples=300)
@given(strokes(count=4, widths=(0.01, 1.5)))
def test_voids_never_join(shape):
    """Each hole that a disc of 1.5 px radius fits into has a void of its own."""
    pieces = pieces_of(shape)
    if not pieces:
        return
    holes = [Polygon(ring) for piece in pieces for ring in piece.interiors]
    roomy = [hole for hole in holes if not hole.buffer(-1.6).is_empty]
    assert slow_twin.holes(filled(shape)) >= len(roomy)


@settings(max_examples=200)
@given(st.lists(st.tuples(st.floats(8, 40), st.floats(8, 40), st.floats(1.5, 8)), min_size=1, max_size=4))
def test_ordinary_parts_do_not_change(circles):
    """Round shapes that are nowhere thinner than a pixel and a half: plain fill, to the pixel."""
    shape = unary_union([shapely.Point(x, y).buffer(r) for x, y, r in circles])
    shape = snapped(shape.buffer(-0.8).buffer(1.6).buffer(-0.8))  # rounds what corners there are, inside and out
    assume(
        shape.difference(shape.buffer(-0.75).buffer(0.76)).area < 0.05
    )  # but two that nearly touch get a thin neck
    if pieces_of(shape):
        assert np.array_equal(filled(shape), filled(shape, thin=False))


@settings(max_examples=1500)
@given(
    st.lists(st.tuples(st.integers(40, 48), st.integers(40, 48)), min_size=3, max_size=8, unique=True), st.booleans()
)
def test_what_touches_centres_and_edges_is_there(corners, round_off):
    """Corners on quarters of a pixel, as drawn pins have them: a touch is no crossing, and nothing is lost for it."""
    hull = shapely.MultiPoint([(x / 4, y / 4) for x, y in corners]).convex_hull
    shape = snapped(hull.buffer(0.25, quad_segs=2) if round_off else hull)
    if pieces_of(shape):
        image = filled(shape)
        assert slow_twin.components(image) == 1, f"\n{drawing(image)}"
        y, x = np.nonzero(image)
        assert shapely.dwithin(shapely.box(x - 1, y - 1, x + 1, y + 1), shape, 1e-6).all()


@pytest.mark.parametrize("sides", [4, 8, 32])
@pytest.mark.parametrize("diameter", [0.5, 1.0])
def test_a_pin_as_wide_as_a_pixel_is_there_wherever_it_stands(diameter, sides):
    """Its middle on corners, on edges and on centres of pixels."""
    turn = np.arange(sides) * 2 * np.pi / sides
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1) * diameter / 2
    for x, y in product((20, 20.25, 20.5, 20.75), repeat=2):
        assert filled(snapped(Polygon(circle + np.array([x, y])))).any(), (x, y)


def test_a_pin_inside_a_cell_is_a_pixel():
    """It meets neither row nor column of centres."""
    for x, y in ((10.5, 10.5), (10.2, 10.8), (10.7, 10.1)):
        image = filled(snapped(shapely.Point(x, y).buffer(0.05)))
        assert image.sum() == 1
        ((row, column),) = np.argwhere(image)
        assert max(abs(row - y), abs(column - x)) <= 0.5


@pytest.mark.parametrize("degrees", [0, 15, 40, 70, 90])
def test_a_fin_of_20_um_is_printed(degrees):
    """Between two blocks, at 50 µm pixels: gone by its centres, whole as a line, corrected to the feature."""
    fin = turned(box([-2, -0.01, 0], [2, 0.01, 1]), "z", degrees)
    part = joined(fin, turned(joined(box([-3, -1, 0], [-2, 1, 1]), box([2, -1, 0], [3, 1, 1])), "z", degrees))
    plain = slice_mesh(part, pixel_mm=0.05, layer_mm=0.1, hairlines=False)[4]
    stack = slice_mesh(part, pixel_mm=0.05, layer_mm=0.1)
    assert slow_twin.components(plain.image()) != 1
    assert slow_twin.components(stack[4].image()) == 1
    assert plain.hairline_px == 0 < stack[4].hairline_px
    fixed = correct(stack, min_feature_mm=0.4)[4]
    assert slow_twin.components(fixed.image()) == 1
    assert fixed.change.thinnest_mm == pytest.approx(0.05, abs=0.01)
    width_px = (fixed.image().sum() - 2 * 20 * 40) * 0.05**2 / 4 / 0.05
    assert width_px == pytest.approx(8, abs=1)
