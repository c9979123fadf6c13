"""`Change.thinnest_mm`: the width of the narrowest thing that needed help, within half a pixel."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from layerfix import LayerStack, correct, correct_image
from layerfix.bits import pack, unpack
from layerfix.layers.columns import bounding_box, to_columns, with_border
from layerfix.layers.thickness import _seen_from, edges_mm, narrowest
from layerfix.layers.verdict import judge
from tests import slow_metric
from tests.pictures_as_text import block, framed, images, round_dot, strip

ANGLES = np.arange(0, 90.1, 7.5)
SQUARE, PANEL = (1.0, 1.0), (0.019, 0.024)


def thinnest_mm(image: np.ndarray, min_feature_mm: float, pixel_mm: tuple[float, float] = SQUARE) -> float | None:
    """What `correct` says about one layer; the same in both modes."""
    stack = LayerStack.from_images([image], pixel_mm=pixel_mm, layer_mm=0.05)
    said = {correct(stack, min_feature_mm=min_feature_mm, mode=mode)[0].change.thinnest_mm for mode in
            ("as_printed", "add_only")}  # fmt: skip
    assert len(said) == 1
    return said.pop()


@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("width", range(3, 10))
def test_a_wall_in_any_direction_is_as_wide_as_it_is_drawn(width, degrees):
    """3 to 9 px at every 7.5°, measured within half a pixel of what is drawn."""
    # along the diagonal rows of pixels lie 0.7 px apart: walls are drawn up to a third of a pixel off
    assert thinnest_mm(strip(width, degrees), 14) == pytest.approx(width, abs=0.85 if degrees == 45 else 0.5)


@pytest.mark.parametrize("pixel", [PANEL, PANEL[::-1]], ids=["19x24", "24x19"])
@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("width", range(3, 10))
def test_pixels_that_are_not_square_are_measured_in_mm(width, degrees, pixel):
    """19 × 24 µm pixels: within 13 µm of the wall as drawn, at every 7.5°."""
    image = strip(width * 0.024, degrees, length=80 * 0.019, pixel=pixel)
    assert thinnest_mm(image, 14 * 0.024, pixel) == pytest.approx(width * 0.024, abs=0.013)


@given(
    st.floats(2.5, 10),
    st.floats(0, 180),
    st.sampled_from([SQUARE, PANEL, PANEL[::-1], (0.05, 0.05)]),
    st.floats(1.2, 2),
)
def test_any_wall_within_a_pixel(width, degrees, pixel, wider):
    """Any width and angle: within half a pixel, the longer side counts, and what the raster makes of the width."""
    unit = max(pixel)
    image = strip(width * unit, degrees, length=80 * min(pixel), pixel=pixel)
    said = thinnest_mm(image, max(2, width * wider) * unit + 2 * unit, pixel)
    assert said == pytest.approx(width * unit, abs=0.75 * unit)  # along the grid it is drawn half a pixel off


@pytest.mark.parametrize("width", range(1, 8))
@pytest.mark.parametrize("turned", [np.asarray, np.transpose], ids=["lying", "standing"])
def test_a_straight_wall_is_measured_to_the_pixel(width, turned):
    """Along the pixel grid nothing is lost to rounding, also not in a wall across words."""
    assert thinnest_mm(turned(block(width, 150, 12)), 10) == width


@pytest.mark.parametrize("diameter", range(1, 12))
def test_a_pin_is_as_wide_as_it_is_drawn(diameter):
    """Round pins within half a pixel; one of a single pixel is one pixel."""
    said = thinnest_mm(round_dot(diameter / 2, 41), 14)
    assert said == pytest.approx(diameter, abs=0.5)
    assert diameter > 1 or said == 1


@pytest.mark.parametrize("width", [30, 50, 61, 62, 63, 64, 70, 90])
@pytest.mark.parametrize("turned", [np.asarray, np.transpose], ids=["lying", "standing"])
def test_a_wall_of_many_pixels_is_measured_too(width, turned):
    """1 mm in pixels of 10 µm is 100 px: a wall of 90 px is too thin for it, and reported as 90 px."""
    assert thinnest_mm(turned(block(width, 260, 60)), 100) == width


def test_a_pin_of_one_panel_pixel_is_its_shorter_side():
    """One pixel of 19 × 24 µm is 19 µm thin."""
    assert thinnest_mm(block(1, 1, 20), 0.3, PANEL) == pytest.approx(0.019)


@pytest.mark.parametrize("side", [2, 3, 4, 6])
def test_a_square_pin_is_as_wide_as_its_side(side):
    """Not as its diagonal."""
    assert thinnest_mm(block(side, side, 12), 10) == pytest.approx(side, abs=0.55)


def test_the_narrowest_of_several_counts():
    """A 3 px wall among walls of 6 and 8 px and a wide block, wherever it is."""
    for at in (5, 40, 70):
        image = np.zeros((110, 200), bool)
        for y, width in zip((5, 40, 70), (8, 6, 6), strict=True):
            image[y : y + (3 if y == at else width), 15:185] = True
        image[88:105, 20:180] = True
        assert thinnest_mm(image, 11) == 3


def test_a_neck_is_the_narrowest_place():
    """Two wide parts joined by a 2 px neck."""
    image = framed(np.zeros((30, 90), bool), 4)
    image[4:34, 4:34] = image[4:34, 60:90] = True
    image[20:22, 34:60] = True
    assert thinnest_mm(image, 9) == 2


def test_a_wall_at_the_frames_edge_ends_there():
    """Outside the frame is empty, so the frame's edge is a side of the wall."""
    image = np.zeros((40, 130), bool)
    image[:, :3] = True
    assert thinnest_mm(image, 9) == 3
    assert thinnest_mm(image.T.copy(), 9) == 3
    assert thinnest_mm(image[:, ::-1].copy(), 9) == 3


@pytest.mark.parametrize(
    "image",
    [
        block(30, 30, 6),
        block(9, 60, 6),
        round_dot(16, 45),
        round_dot(30, 75) & ~round_dot(12, 75),
        np.zeros((30, 30), bool),
        np.ones((30, 130), bool),
    ],
    ids=["block", "just wide enough", "disc", "wide ring", "empty", "full"],
)
def test_nothing_thin_is_none(image):
    """Where every place holds the feature of 8 px there is nothing to report."""
    assert thinnest_mm(image, 8) is None


@pytest.mark.parametrize("degrees", np.arange(0, 90, 7.5))
def test_the_corners_of_a_wide_block_are_not_thin(degrees):
    """A block of 36 px, turned any way, although paths run into some corners."""
    assert thinnest_mm(strip(36, degrees, length=36), 12) is None


def test_a_wall_wide_enough_is_none_and_one_too_thin_is_not():
    """F of 8 px fits into a wall of 8 px, and not into one of 7."""
    assert thinnest_mm(block(8, 60, 8), 8) is None
    assert thinnest_mm(block(7, 60, 8), 8) == 7


@settings(max_examples=150)
@given(images(heights=st.integers(1, 60), widths=st.integers(1, 150)), st.floats(1, 6))
def test_it_is_none_where_nothing_is_added_and_else_between_a_pixel_and_the_feature(image, radius):
    """On anything: at least a pixel, never above the feature, and nothing where S ∘ F is all there is to print."""
    assume(2 * radius <= max(image.shape))
    said = thinnest_mm(image, 2 * radius)
    printed = correct_image(image, min_feature_px=2 * radius)
    assert (said is None) == np.array_equal(printed, slow_metric.opening(image, 2 * radius, 2 * radius))
    if said is not None:
        assert 1 <= said <= 2 * radius


@settings(max_examples=150)
@given(images(heights=st.integers(1, 60), widths=st.integers(1, 150)), st.floats(1, 6))
def test_a_path_one_pixel_wide_is_found(image, radius):
    """Whatever else there is: a lone pixel far from everything is the narrowest, at one pixel."""
    image = framed(image, 20)
    image[2, 2] = True
    assume(2 * radius <= 12)
    assert thinnest_mm(image, 2 * radius) == 1
    assert correct_image(image, radius)[2, 2]


def measured(image: np.ndarray, limit_mm: float, pixel_mm: tuple[float, float]) -> float:
    """The kernel alone: a path of every pixel in the middle third of a wall."""
    rows, middle = pack(image), np.zeros_like(image)
    y, x = np.nonzero(image)
    thirds = tuple(slice(v.min() + len(set(v)) // 3, v.max() + 1 - len(set(v)) // 3) for v in (y, x))
    middle[thirds] = image[thirds]
    outer = with_border(bounding_box(rows), 0, 0)
    return float(narrowest(to_columns(rows, outer), to_columns(pack(middle), outer), limit_mm, *pixel_mm, False))


@pytest.mark.parametrize("pixel_mm", [(1.0, 1.0), (0.5, 1.0), (1.0, 0.5), (0.019, 0.024)])
@pytest.mark.parametrize("width", [1, 2, 3, 4, 7, 12, 31, 32, 62, 63, 64, 65, 90])
def test_a_wall_hardly_narrower_than_the_limit_is_still_measured(width, pixel_mm):
    """The look for the nearest void reaches far enough for any width below the limit, lying or standing; and it says
    the limit where the wall is as wide as that, or wider.
    """
    px, py = pixel_mm
    for image, across_mm in ((block(width, 300, 3), py), (block(300, width, 3), px)):
        exact = width * across_mm
        for above in (1e-6, 0.3 * across_mm, 0.999 * across_mm, 5 * across_mm):
            assert measured(image, exact + above, pixel_mm) == pytest.approx(exact)
        assert measured(image, exact - 1e-6, pixel_mm) == exact - 1e-6


def slow_edges_mm(image, y, x, ux, uy, beyond_mm, along_mm, px_mm, py_mm):
    """(farthest solid, nearest void) centre in the half-strip before (y, x), pixel by pixel; outside is void."""
    reach = int((beyond_mm + along_mm) / min(px_mm, py_mm)) + 2
    solid, void = 0.0, np.inf
    for v in range(int(y) - reach, int(y) + reach + 2):
        for u in range(int(x) - reach, int(x) + reach + 2):
            away = ux * (u - x) * px_mm + uy * ((v - y) * py_mm)
            aside = uy * (u - x) * px_mm - ux * ((v - y) * py_mm)
            if 0 < away <= beyond_mm + 1e-9 and abs(aside) <= along_mm + 1e-9:
                inside = 0 <= v < image.shape[0] and 0 <= u < image.shape[1] and image[v, u]
                solid, void = (max(solid, away), void) if inside else (solid, min(void, away))
    return solid, void


@given(
    images(),
    st.floats(0, 1),
    st.floats(0, 1),
    st.floats(0, 2 * np.pi) | st.sampled_from([k * np.pi / 4 for k in range(8)]),
    st.floats(1, 90),
    st.floats(0.3, 9),
    st.sampled_from([SQUARE, PANEL]),
)
def test_edges_are_where_a_look_at_every_pixel_finds_them(image, down, across, angle, beyond_px, along_px, pixel):
    """64 pixels at once, at any angle and from any point; and it stops only where that could not matter."""
    y, x = down * (image.shape[0] - 1), across * (image.shape[1] - 1)
    ux, uy, unit = np.cos(angle), np.sin(angle), max(pixel)
    columns = to_columns(pack(image), (0, image.shape[0], 0, pack(image).shape[1]))
    how = y, x, ux, uy, beyond_px * unit, along_px * unit
    solid, void = slow_edges_mm(image, *how, *pixel)
    assert edges_mm(columns, *how, -np.inf, *pixel) == pytest.approx((solid, void), abs=1e-12)
    for enough in (-1.5 * unit, 0.0):
        early = edges_mm(columns, *how, enough, *pixel)
        if void - solid > enough:
            assert early == pytest.approx((solid, void), abs=1e-12)
        else:
            assert early[1] - early[0] <= enough


def comb(wall: float, gap: float, length: float, degrees: float = 0.0, size: int = 130) -> np.ndarray:
    """Three walls side by side, turned about the middle of the picture."""
    turn = np.radians(degrees)
    y, x = np.mgrid[:size, :size] - (size / 2 - 0.2)
    along, across = y * np.cos(turn) - x * np.sin(turn), x * np.cos(turn) + y * np.sin(turn)
    image = np.zeros((size, size), np.bool_)
    for k in (-1, 0, 1):
        image |= (np.abs(across - k * (wall + gap)) <= wall / 2) & (np.abs(along) <= length / 2)
    return image


def judged(image: np.ndarray, size: float) -> tuple[float | None, float | None]:
    """(thinnest, thinnest gap) in pixels."""
    (verdict,) = judge(LayerStack.from_images(image[None], pixel_mm=1, layer_mm=1), min_feature_mm=size)
    return verdict.thinnest_mm, verdict.thinnest_gap_mm


@pytest.mark.parametrize("size", [6, 9, 12])
def test_walls_and_gaps_side_by_side(size):
    """What is behind a gap or a wall of a pixel is not taken for its edge, and nor is the end of a wall."""
    for wall in range(1, size):
        for gap in (*range(1, size), 20):
            image = np.zeros((100, 130), np.bool_)
            for k in range(3):
                image[12:88, 20 + k * (wall + gap) : 20 + k * (wall + gap) + wall] = True
            found, found_gap = judged(image, size)
            assert found == pytest.approx(wall, abs=0.5), (wall, gap)
            assert found_gap is None if gap >= size else found_gap == pytest.approx(gap, abs=0.5), (wall, gap)


@pytest.mark.parametrize("pixel_mm", [(0.1, 0.05), (0.019, 0.024)])
@pytest.mark.parametrize("lying", [False, True])
def test_walls_and_gaps_of_oblong_pixels(pixel_mm, lying):
    """In mm, within half of the longer side; of a gap of one pixel, its ends are not measured alone."""
    for size, wall, gap in ((8, 2, 1), (8, 3, 1), (8, 5, 2), (10, 3, 4), (10, 7, 7)):
        image = np.zeros((110, 130), np.bool_)
        for k in range(3):
            start = 20 + k * (wall + gap)
            image[
                (slice(start, start + wall), slice(12, 98)) if lying else (slice(12, 98), slice(start, start + wall))
            ] = 1
        pitch, limit = pixel_mm[lying], size * pixel_mm[lying]
        stack = LayerStack.from_images(image[None], pixel_mm=pixel_mm, layer_mm=0.1)
        (verdict,) = judge(stack, min_feature_mm=limit)
        assert verdict.thinnest_mm == pytest.approx(wall * pitch, abs=max(pixel_mm) / 2), (size, wall, gap)
        assert verdict.thinnest_gap_mm == pytest.approx(gap * pitch, abs=max(pixel_mm) / 2), (size, wall, gap)


@pytest.mark.parametrize("degrees", [5, 17, 26.6, 33, 45, 63, 71])
def test_walls_and_gaps_side_by_side_at_angles(degrees):
    """Long ones and stubs, within half a pixel and what the raster adds; one place in fifty may be off by more."""
    off, off_gap = [], []
    for wall in (2, 3, 4, 5.5, 8):
        for gap in (2, 3, 4, 6.5, 9):
            for length in (14, 30, 90):
                found, found_gap = judged(comb(wall, gap, length, degrees), 12)
                off.append(abs((found or 99) - wall))
                off_gap.append(abs((found_gap or 99) - gap))
    assert max(off) < 0.65
    assert np.mean(np.array(off_gap) < 0.7) > 0.97


def slow_seen(image: np.ndarray, y: int, x: int, reach: int, of_void: bool) -> set[tuple[int, int]]:
    """What of the solid is seen: from square to square outwards, each pixel from a neighbour further in, unless two
    in a row on the straight way to it, rounded from square to square, are not seen."""

    def solid(v: int, u: int) -> bool:
        return 0 <= v < image.shape[0] and 0 <= u < image.shape[1] and bool(image[v, u])

    def on_the_way(v: int, u: int, ring: int) -> tuple[int, int]:
        share = Fraction(ring - 1, ring)
        return y + math.floor((v - y) * share + Fraction(1, 2)), x + math.floor((u - x) * share + Fraction(1, 2))

    seen = {(y, x)} if solid(y, x) else set()
    for ring in range(1, reach + 1):
        around = [(dy, dx) for dy in range(-ring, ring + 1) for dx in range(-ring, ring + 1)]
        new = set()
        for v, u in [(y + dy, x + dx) for dy, dx in around if max(abs(dy), abs(dx)) == ring]:
            inner = [(a, b) for a in (v - 1, v, v + 1) for b in (u - 1, u, u + 1) if (a, b) in seen]
            inner = [(a, b) for a, b in inner if max(abs(a - y), abs(b - x)) == ring - 1]
            ways = [not of_void or a == v or b == u or solid(a, u) or solid(v, b) for a, b in inner]
            first = on_the_way(v, u, ring)
            second = on_the_way(*first, ring - 1) if ring > 1 else first
            if solid(v, u) and any(ways) and (ring < 2 or first in seen or second in seen):
                new.add((v, u))
        seen |= new
    return seen


@given(images(), st.integers(0, 60), st.integers(0, 60), st.integers(1, 9), st.booleans())
def test_seen_equals_its_slow_twin(image, y, x, reach, of_void):
    """Noise and drawings, from any pixel, in the solid or not."""
    y, x = y % image.shape[0], x % image.shape[1]
    seen, top, left = _seen_from(np.ascontiguousarray(pack(image).T), y, x, reach, of_void)
    found = unpack(np.ascontiguousarray(seen.T), 2 * reach + 1)
    assert {
        (v + top, u + left) for v, u in zip(*map(np.ndarray.tolist, np.nonzero(found)), strict=True)
    } == slow_seen(image, y, x, reach, of_void)


def test_behind_a_wall_is_not_seen():
    """Nor past a line of pixels that touch at corners, if it is void that is looked at."""
    wall = np.ones((21, 21), np.bool_)
    wall[2:19, 13] = False
    seen = slow_seen(wall, 10, 10, 8, True)
    assert all((v, 12) in seen and (v, 14) not in seen for v in range(4, 17))
    line = ~np.eye(9, dtype=np.bool_)
    assert (3, 6) not in slow_seen(line, 6, 3, 4, True)
    assert (3, 6) in slow_seen(line, 6, 3, 4, False)


def test_necks_and_pins_side_by_side():
    """Pins in rows, and what is left between the holes of a plate, wherever they lie between the pixels' centres."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:120, :120].astype(float)
    for size in (9, 14):
        for wide in (3, 5, 8):
            for apart in (2, 3, 5, 8):
                start, step = 35 + rng.random(2), wide + apart
                dots = np.zeros((120, 120), np.bool_)
                for i, j in np.ndindex(3, 3):
                    dots |= (y - start[0] - i * step) ** 2 + (x - start[1] - j * step) ** 2 <= (wide / 2) ** 2
                found, found_gap = judged(dots, size)
                assert found == pytest.approx(wide, abs=0.85), (size, wide, apart)
                assert found_gap == pytest.approx(apart, abs=0.9), (size, wide, apart)
                found, found_gap = judged(~dots, size)
                assert found == pytest.approx(apart, abs=0.9), (size, wide, apart)
                assert found_gap == pytest.approx(wide, abs=0.85), (size, wide, apart)
