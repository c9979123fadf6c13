"""What of a grey layer is solid, the coverage of discs, and corrections drawn into greys."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from layerfix.bits import pack, unpack
from layerfix.layers.correction import correct_image
from layerfix.layers.greys import corrected_greys, disc_coverage, solid_rows
from layerfix.layers.skeleton import meso_skeleton
from tests import slow_twin

ALL_AROUND = np.ones((3, 3))
WIDTHS = (1, 63, 64, 65, 100, 128, 130)


def solid_in(grey: np.ndarray, threshold: int, floor: int) -> np.ndarray:
    """Pixels from the threshold on, and strokes from the floor on that nowhere touch those."""
    bright = grey >= threshold
    if not 0 < floor < threshold:
        return bright
    labels, count = ndimage.label(grey >= floor, ALL_AROUND)
    touched = np.zeros(count + 1, bool)
    touched[labels[bright]] = True
    return bright | ((labels > 0) & ~touched[labels])


def solid(grey: np.ndarray, threshold: int = 128, floor: int = 32) -> np.ndarray:
    return unpack(solid_rows(grey, threshold, floor), grey.shape[1])


def soft(image: np.ndarray, sigma: float = 0.7) -> np.ndarray:
    """A black and white drawing with soft edges."""
    return np.round(ndimage.gaussian_filter(255.0 * image, sigma)).astype(np.uint8)


@st.composite
def anti_aliased(draw: st.DrawFn) -> np.ndarray:
    """A few blocks and strokes with soft edges, some of them faint."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    height, width = draw(st.integers(8, 50)), draw(st.sampled_from(WIDTHS))
    grey = np.zeros((height, width))
    for _ in range(draw(st.integers(1, 5))):
        y, x = rng.integers(0, height), rng.integers(0, width)
        high, wide = rng.integers(1, 15, 2)
        grey[y : y + high, x : x + wide] = rng.choice([60, 110, 255, 255])
    return np.round(ndimage.gaussian_filter(grey, draw(st.sampled_from([0, 0.4, 0.8])))).astype(np.uint8)


@given(anti_aliased(), st.integers(1, 255), st.integers(0, 255))
def test_solid_is_what_the_labels_say(grey, threshold, floor):
    """Against scipy's components, for any threshold and floor."""
    assert np.array_equal(solid(grey, threshold, floor), solid_in(grey, threshold, floor))


def test_a_faint_stroke_on_its_own_is_solid():
    """All of it that reaches the floor."""
    grey = np.zeros((9, 70), np.uint8)
    grey[4, 5:66] = 40
    grey[4, 30] = 31
    assert np.array_equal(solid(grey), grey >= 32)


def test_the_halo_of_a_block_is_not_solid():
    """Greys that touch what is bright, at a corner too, are its edge."""
    grey = np.zeros((20, 70), np.uint8)
    grey[5:15, 60:68] = 255
    grey[4, 55:70] = grey[15, 58:68] = 100
    grey[3, 54] = 100
    assert np.array_equal(solid(grey), grey == 255)


@pytest.mark.parametrize("floor", [0, 128, 200])
def test_no_faint_strokes_without_a_floor_below_the_threshold(floor):
    """A floor of 0, or one that is not below the threshold, asks for none."""
    grey = np.full((5, 70), 100, np.uint8)
    assert not solid(grey, 128, floor).any()


@pytest.mark.parametrize("rx", [0.5, 1.0, 1.7, 2.5, 3.0, 4.2, 10.0])
@pytest.mark.parametrize("stretch", [1.0, 0.79, 1.6])
def test_the_coverage_of_a_disc_adds_up_to_its_area(rx, stretch):
    """π·rx·ry within half a percent, at most 1 in any pixel, the same mirrored, nothing at the rim of the array."""
    ry = rx * stretch
    share = disc_coverage(rx, ry)
    assert share.shape == (2 * int(np.ceil(ry + 0.5)) + 1, 2 * int(np.ceil(rx + 0.5)) + 1)
    assert share.sum() == pytest.approx(np.pi * rx * ry, rel=0.005)
    assert share.min() >= 0
    assert share.max() <= 1
    assert np.allclose(share, share[::-1])
    assert np.allclose(share, share[:, ::-1])
    assert share[share.shape[0] // 2, share.shape[1] // 2] == pytest.approx(share.max())


def test_the_coverage_of_a_disc_against_many_points():
    """Each pixel's share as counted on a fine grid."""
    rx, ry, fine = 3.3, 2.1, 200
    share = disc_coverage(rx, ry)
    high, wide = share.shape
    y = (np.arange(high * fine) + 0.5) / fine - high / 2
    x = (np.arange(wide * fine) + 0.5) / fine - wide / 2
    inside = (x / rx) ** 2 + (y[:, None] / ry) ** 2 <= 1
    counted = inside.reshape(high, fine, wide, fine).mean(axis=(1, 3))
    assert np.abs(share - counted).max() < 0.005


def drawn_in(
    grey: np.ndarray, radius: tuple[float, float], mode: str, threshold: int = 128
) -> tuple[np.ndarray, ...]:
    """(what was solid, what is to be, the corrected greys)."""
    before = solid(grey, threshold)
    after = correct_image(before, radius, mode)
    paths = meso_skeleton(before, radius) & ~slow_twin.erosion(before, *radius)
    return before, after, corrected_greys(grey, pack(before), pack(after), pack(paths), radius, threshold)


@pytest.mark.parametrize(
    "threshold",
    [
        pytest.param(
            64,
        ),
        128,
        200,
    ],
)
@given(grey=anti_aliased(), radius=st.sampled_from([(2.0, 2.0), (3.0, 3.0), (3.5, 2.8), (1.2, 1.0)]))
def test_add_only_in_greys(threshold, grey, radius):
    """Solid afterwards is what is to be; nothing gets darker; other pixels than the added and their rim stay."""
    original = grey.copy()
    _, after, out = drawn_in(grey, radius, "add_only", threshold)
    assert np.array_equal(grey, original), "the input was written to"
    assert np.array_equal(out >= threshold, after)
    assert (out >= grey).all()
    added = after & (grey < threshold)
    rim = ndimage.binary_dilation(added, ALL_AROUND)
    assert np.array_equal(out[~rim], grey[~rim])


@given(anti_aliased(), st.sampled_from([(2.0, 2.0), (3.5, 2.8)]))
def test_as_printed_in_greys(grey, radius):
    """Solid afterwards is what is to be; what is removed is black, unless it is now the rim of what was added."""
    before, after, out = drawn_in(grey, radius, "as_printed")
    assert np.array_equal(out >= 128, after)
    removed, elsewhere = before & ~after, ~ndimage.binary_dilation(after & (grey < 128), ALL_AROUND)
    assert not out[removed & elsewhere].any()
    assert np.array_equal(out[elsewhere & ~removed], grey[elsewhere & ~removed])


@pytest.mark.parametrize("level", [60, 255])
def test_the_rim_of_a_thickened_stroke_is_graded(level):
    """A hairline becomes as wide as F: full in the middle, the disc's coverage at its edge, alike on both sides."""
    grey = np.zeros((31, 90), np.uint8)
    grey[15, 20:70] = level
    radius = (3.3, 3.3)
    out = drawn_in(grey, radius, "add_only")[2]
    across = out[:, 45]
    assert (across[13:18] == 255).all()
    assert np.array_equal(across, across[::-1])
    # Half the width is 3.3 px: the row 3 away is covered from 2.5 to 3.3.
    assert 128 <= across[18] < 255
    assert across[18] == pytest.approx(0.8 * 255, abs=12)
    assert not across[20:].any()
    assert len(set(np.unique(out)) - {0, 255}) > 3
    assert across.sum() / 255 == pytest.approx(6.6, rel=0.03)


def test_strokes_that_were_bright_keep_their_value():
    """A stroke of 200 is solid: it stays 200 where nothing is added, and is made wider beside it."""
    grey = np.zeros((31, 90), np.uint8)
    grey[15, 20:70] = 200
    grey[20:30, 5:85] = 230
    out = drawn_in(grey, (3.0, 3.0), "add_only")[2]
    assert (out[23:27, 10:80] == 230).all()
    assert (out[14, 25:65] == 255).all()


def test_nothing_to_add_changes_nothing():
    """The greys are the same, in an array of their own."""
    grey = soft(np.pad(np.ones((12, 60), bool), 8))
    before = solid_rows(grey, 128, 32)
    out = corrected_greys(grey, before, before, np.zeros_like(before), (3.0, 3.0), 128)
    assert np.array_equal(out, grey)
    assert out is not grey


@pytest.mark.parametrize("place", [(0, 0), (0, 89), (30, 0), (30, 89)])
def test_a_dot_in_the_corner(place):
    """What would be outside the frame is cut off."""
    grey = np.zeros((31, 90), np.uint8)
    grey[place] = 255
    _, after, out = drawn_in(grey, (3.0, 3.0), "add_only")
    assert np.array_equal(out >= 128, after)
    assert out.sum() / 255 == pytest.approx(np.pi * 9 / 4 + 3 + 0.25, rel=0.12)
