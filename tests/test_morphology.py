"""Erosion, dilation and opening by the disc, compared with the slow twin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix.bits import pack, unpack
from layerfix.errors import InputError
from layerfix.layers.morphology import dilate, disc_half_widths, erode, opened
from tests import slow_twin
from tests.pictures_as_text import drawing, framed, images, picture, radii

OPERATIONS = [(erode, slow_twin.erosion), (dilate, slow_twin.dilation), (opened, slow_twin.opening)]
each_operation = pytest.mark.parametrize(("fast", "slow"), OPERATIONS, ids=lambda f: f.__name__)


def applied(operation, image: np.ndarray, radius: tuple[float, float]) -> np.ndarray:
    """A packed operation on an image; bits past the width must have stayed 0."""
    width = image.shape[1]
    rows = operation(pack(image), width, radius)
    result = unpack(rows, width)
    assert np.array_equal(pack(result), rows)
    return result


def assert_same(result: np.ndarray, expected: np.ndarray) -> None:
    """Equal to the pixel; shows both as text if not."""
    assert np.array_equal(result, expected), f"\n{drawing(result)}\n\nexpected\n{drawing(expected)}"


def half_widths_of(offsets: list[tuple[int, int]]) -> list[int]:
    """The largest dx in each row of a disc, from the middle down."""
    lowest = max(dy for _, dy in offsets)
    return [max(dx for dx, dy in offsets if dy == row) for row in range(lowest + 1)]


@given(radii(0.05, 30))
def test_the_disc_is_that_of_its_equation(radius):
    """Half-widths are those of the offsets with (dx/rx)² + (dy/ry)² ≤ 1."""
    assert disc_half_widths(*radius).tolist() == half_widths_of(slow_twin.disc(*radius))


@pytest.mark.parametrize("mm", [0.0475, 0.05, 0.2, 0.3, 0.35, 0.4, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("pitch", [0.019, 0.024, 0.035, 0.0472, 0.05, 0.1])
def test_the_disc_of_a_feature_in_mm_includes_offsets_exactly_on_its_rim(mm, pitch):
    """0.3 mm in 50 µm pixels is 3 px to every side, although 0.3 / 2 / 0.05 is a hair less than 3."""
    r = mm / 2 / pitch
    half_widths = disc_half_widths(r, r)
    assert half_widths.tolist() == half_widths_of(slow_twin.disc(r, r))
    assert half_widths[0] == len(half_widths) - 1 == math.floor(round(r, 6))


def test_the_smallest_disc_is_one_pixel():
    """Under a pixel of radius nothing grows and nothing shrinks."""
    image = picture("# . # #")
    assert_same(applied(dilate, image, (0.9, 0.9)), image)
    assert_same(applied(erode, image, (0.9, 0.9)), image)


@each_operation
@given(image=images(), radius=radii())
def test_equals_the_twin(fast, slow, image, radius):
    """Bit for bit at widths around the word size, whatever touches the frame."""
    assert_same(applied(fast, image, radius), slow(image, *radius))


@each_operation
@given(image=images(heights=st.integers(100, 300), widths=st.integers(1, 20)), radius=radii())
def test_equals_the_twin_on_tall_images(fast, slow, image, radius):
    """Blocks of rows far apart, and gaps of all lengths between them, make no difference."""
    assert_same(applied(fast, image, radius), slow(image, *radius))


@each_operation
@given(
    image=images(heights=st.integers(1, 9), widths=st.sampled_from([4095, 4096, 4100, 8300])), radius=radii(0.5, 4)
)
def test_equals_the_twin_on_wide_images(fast, slow, image, radius):
    """Past 4096 px, too."""
    assert_same(applied(fast, image, radius), slow(image, *radius))


@each_operation
@pytest.mark.parametrize("radius", [(62.5, 3), (63, 2), (64, 1), (65, 2), (127.5, 2), (130, 1.5), (2, 40), (33, 33)])
def test_equals_the_twin_for_discs_of_several_words(fast, slow, radius):
    """A disc may reach over one word and more."""
    random = np.random.default_rng(7)
    image = np.ones((12, 300), bool) if fast is dilate else framed(np.ones((130, 400), bool), 3)
    image &= random.random(image.shape) < (0.004 if fast is dilate else 0.9999)
    assert_same(applied(fast, image, radius), slow(image, *radius))


def test_the_outside_of_the_frame_is_void():
    """Erosion eats from the frame's edge, and what grows past it is cut off."""
    solid = np.ones((5, 7), bool)
    assert_same(
        applied(erode, solid, (1, 2)),
        picture("""
            . . . . . . .
            . . . . . . .
            . # # # # # .
            . . . . . . .
            . . . . . . .
        """),
    )
    assert_same(applied(dilate, solid, (3, 3)), solid)


def test_a_dot_grows_to_the_disc():
    """The disc of radius 2, and the one of pixels twice as high as wide."""
    dot = framed(np.ones((1, 1), bool), 2)
    assert_same(
        applied(dilate, dot, (2, 2)),
        picture("""
            . . # . .
            . # # # .
            # # # # #
            . # # # .
            . . # . .
        """),
    )
    assert_same(
        applied(dilate, dot, (2, 1)),
        picture("""
            . . . . .
            . . # . .
            # # # # #
            . . # . .
            . . . . .
        """),
    )


@given(images(), radii())
def test_opening_takes_away_and_does_so_once(image, radius):
    """S ∘ F ⊆ S, and opening again changes nothing, as long as the frame cuts nothing off."""
    image = framed(image, 8)
    once = applied(opened, image, radius)
    assert not (once & ~image).any()
    assert_same(applied(opened, once, radius), once)


@each_operation
@given(image=images(), radius=radii())
def test_leaves_its_input_alone(fast, slow, image, radius):
    """Rows may be read-only, and come out as they went in."""
    rows = pack(image)
    rows.flags.writeable = False
    before = rows.copy()
    fast(rows, image.shape[1], radius)
    assert np.array_equal(rows, before)


@each_operation
@pytest.mark.parametrize("shape", [(1, 1), (4, 64), (3, 200)])
def test_empty_stays_empty(fast, slow, shape):
    """Nothing comes of nothing."""
    assert not applied(fast, np.zeros(shape, bool), (2, 3)).any()


@pytest.mark.parametrize("radius", [(0, 1), (1, 0), (-1, 1), (math.nan, 1), (1, math.inf)])
def test_a_radius_is_above_0_and_finite(radius):
    """The message names both radii."""
    with pytest.raises(InputError, match=rf"radius \({radius[0]}, {radius[1]}\) px"):
        disc_half_widths(*radius)
