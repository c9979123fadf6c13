"""What of a grey layer is solid, the coverage of discs, and corrections drawn into greys."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Picture
from scipy import ndimage

import layerfix as lf
from layerfix.bits import pack, unpack
from layerfix.layers.correction import correct_image
from layerfix.layers.grey_image import GreyImage
from layerfix.layers.greys import corrected_greys, disc_coverage, solid_rows
from layerfix.layers.skeleton import meso_skeleton
from tests import slow_twin
from tests.slow_greys import dimmed_in, solid_in

ALL_AROUND = np.ones((3, 3))
WIDTHS = (1, 63, 64, 65, 100, 128, 130)


def solid(grey: np.ndarray, threshold: int = 128, floor: int = 32) -> np.ndarray:
    return unpack(solid_rows(grey, threshold, floor).rows, grey.shape[1])


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
def test_solid_is_what_the_definition_says(grey, threshold, floor):
    """Bit by bit, for any threshold and floor."""
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
    grey[4, 58:70] = grey[15, 58:68] = 100
    grey[3, 58] = 100
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
    """(what was solid, what is to be, where F was drawn, the corrected greys)."""
    seen = solid_rows(grey, threshold, 32)
    before = unpack(seen.rows, grey.shape[1])
    after = correct_image(before, radius, mode)
    paths = meso_skeleton(before, radius) & ~slow_twin.erosion(before, *radius)
    held = GreyImage.of(grey)
    out = np.asarray(
        corrected_greys(held, seen.rows, pack(after), pack(paths), radius, threshold, dimmed=seen.dimmed)
    )
    return before, after, paths, out


def covered(paths: np.ndarray, radius: tuple[float, float]) -> np.ndarray:
    """The most that a disc around any of the path pixels covers of each pixel, 0 … 255."""
    stencil = np.round(255 * disc_coverage(*radius)).astype(np.uint8)
    high, wide = (n // 2 for n in stencil.shape)
    out = np.zeros(tuple(n + 2 * m for n, m in zip(paths.shape, (high, wide), strict=True)), np.uint8)
    for y, x in np.argwhere(paths):
        part = out[y : y + 2 * high + 1, x : x + 2 * wide + 1]
        np.maximum(part, stencil, out=part)
    return out[high : high + paths.shape[0], wide : wide + paths.shape[1]]


@pytest.mark.parametrize("threshold", [64, 128, 200])
@given(grey=anti_aliased(), radius=st.sampled_from([(2.0, 2.0), (3.0, 3.0), (3.5, 2.8), (1.2, 1.0)]))
def test_add_only_in_greys(threshold, grey, radius):
    """Solid afterwards is what is to be; nothing gets darker; what is drawn has at least the disc's coverage.

    Where no disc reaches, and in dimmed interiors, every pixel stays.
    """
    original = grey.copy()
    _, after, paths, out = drawn_in(grey, radius, "add_only", threshold)
    dimmed = dimmed_in(grey, threshold, 32) if threshold > 32 else np.zeros_like(after)
    assert np.array_equal(grey, original), "the input was written to"
    assert np.array_equal((out >= threshold) | dimmed, after)
    assert (out >= grey).all()
    cover = covered(paths, radius)
    drawn = after & ~dimmed
    if (after & (grey < threshold) & ~dimmed).any():
        assert (out[drawn] >= cover[drawn]).all()
    elsewhere = (cover == 0) & ~(after & (grey < threshold)) | dimmed
    assert np.array_equal(out[elsewhere], grey[elsewhere])


@given(anti_aliased(), st.sampled_from([(2.0, 2.0), (3.5, 2.8)]))
def test_as_printed_in_greys(grey, radius):
    """Solid afterwards is what is to be; what is removed is black, unless it is now the rim of what was added."""
    before, after, paths, out = drawn_in(grey, radius, "as_printed")
    dimmed = dimmed_in(grey, 128, 32)
    assert np.array_equal((out >= 128) | (dimmed & after), after)
    elsewhere = (covered(paths, radius) == 0) & ~(after & (grey < 128)) | dimmed & after
    removed = before & ~after
    assert not out[removed & elsewhere].any()
    assert np.array_equal(out[elsewhere & ~removed], grey[elsewhere & ~removed])


@pytest.mark.parametrize("level", [60, 255])
def test_the_rim_of_a_thickened_stroke_is_graded(level):
    """A hairline becomes as wide as F: full in the middle, the disc's coverage at its edge, alike on both sides."""
    grey = np.zeros((31, 90), np.uint8)
    grey[15, 20:70] = level
    radius = (3.3, 3.3)
    out = drawn_in(grey, radius, "add_only")[3]
    across = out[:, 45]
    assert (across[13:18] == 255).all()
    assert np.array_equal(across, across[::-1])
    # Half the width is 3.3 px: the row 3 away is covered from 2.5 to 3.3.
    assert 128 <= across[18] < 255
    assert across[18] == pytest.approx(0.8 * 255, abs=12)
    assert not across[20:].any()
    assert len(set(np.unique(out)) - {0, 255}) > 3
    assert across.sum() / 255 == pytest.approx(6.6, rel=0.03)


def test_strokes_that_are_wide_enough_keep_their_value():
    """A bar of 230 stays as it is; a stroke of 200 is made wider, and as bright as what was added beside it."""
    grey = np.zeros((31, 90), np.uint8)
    grey[15, 20:70] = 200
    grey[20:30, 5:85] = 230
    out = drawn_in(grey, (3.0, 3.0), "add_only")[3]
    assert (out[23:27, 10:80] == 230).all()
    assert (out[14:17, 25:65] == 255).all()


def test_nothing_to_add_changes_nothing():
    """The greys are the same, in an array of their own."""
    grey = soft(np.pad(np.ones((12, 60), bool), 8))
    before = solid_rows(grey, 128, 32).rows
    out = np.asarray(corrected_greys(GreyImage.of(grey), before, before, np.zeros_like(before), (3.0, 3.0), 128))
    assert np.array_equal(out, grey)
    assert out is not grey


@pytest.mark.parametrize("place", [(0, 0), (0, 89), (30, 0), (30, 89)])
def test_a_dot_in_the_corner(place):
    """What would be outside the frame is cut off."""
    grey = np.zeros((31, 90), np.uint8)
    grey[place] = 255
    _, after, _, out = drawn_in(grey, (3.0, 3.0), "add_only")
    assert np.array_equal(out >= 128, after)
    assert out.sum() / 255 == pytest.approx(np.pi * 9 / 4 + 3 + 0.25, rel=0.12)


def line(width_px: float, degrees: float, size: int = 61) -> np.ndarray:
    """An anti-aliased stroke through the middle: each pixel's value is how much of it the stroke covers."""
    fine = 12
    at = (np.arange(size * fine) + 0.5) / fine - size / 2
    a = np.radians(degrees)
    along, across = np.cos(a) * at + np.sin(a) * at[:, None], np.cos(a) * at[:, None] - np.sin(a) * at
    inside = (np.abs(across - 0.13) < width_px / 2) & (np.abs(along) < size * 0.4)
    return np.round(255 * inside.reshape(size, fine, size, fine).mean(axis=(1, 3))).astype(np.uint8)


@pytest.mark.parametrize("width_px", [0.4, 0.5, 0.6, 0.75, 0.9, 1.3])
@pytest.mark.parametrize("degrees", [0, 3, 5, 10, 15, 30, 45, 60, 77, 90])
def test_a_stroke_thinner_than_a_pixel_is_one_piece(width_px, degrees):
    """And as long as it is, within two pixels at each end; corrected, it is full in the middle and one piece."""
    grey = line(width_px, degrees)
    seen = solid(grey)
    assert ndimage.label(seen, ALL_AROUND)[1] == 1
    y, x = np.nonzero(seen)
    assert np.hypot(np.ptp(x) + 1, np.ptp(y) + 1) >= 0.8 * 61 - 4
    _, _, paths, out = drawn_in(grey, (2.5, 2.5), "add_only")
    assert ndimage.label(out >= 128, ALL_AROUND)[1] == 1
    assert (out[paths] == 255).all()


@pytest.mark.parametrize("degrees", [0, 4, 13, 30, 45])
def test_the_soft_edge_of_what_is_wide_is_no_crest(degrees):
    """A bar of 20 px with a soft edge: nothing of it is solid but what is bright."""
    grey = line(20, degrees)
    assert np.array_equal(solid(grey), grey >= 128)


def test_a_part_that_is_dim_all_over_is_left_as_it_is():
    """It is no stroke: whatever happens beside it, its greys stay; a faint stroke is thickened."""
    grey = np.zeros((64, 128), np.uint8)
    grey[5:20, 5:30], grey[30, 5:60], grey[40, 5:60] = 100, 255, 100
    _, after, _, out = drawn_in(grey, (2.0, 2.0), "add_only")
    assert (out[5:20, 5:30] == 100).all()
    assert after[5:20, 5:30].all()
    for row in (30, 40):
        assert (out[row - 1 : row + 2, 6:59] >= 128).all()


@pytest.mark.parametrize("pattern", ["chess", "stripes", "half"])
def test_a_dimmed_interior_is_left_as_it_is(pattern):
    """A block with full walls, dimmed inside, stays; a hairline beside it is thickened."""
    grey = np.zeros((80, 120), np.uint8)
    grey[10:70, 10:70] = 255
    inner = grey[13:67, 13:67]
    y, x = np.indices(inner.shape)
    inner[{"chess": (x + y) % 2 == 0, "stripes": y % 2 == 0, "half": y >= 0}[pattern]] = 127
    grey[20:60, 90] = 255
    seen = solid_rows(grey, 128, 32)
    assert np.array_equal(unpack(seen.rows, 120), grey > 0)
    _, _, _, out = drawn_in(grey, (3.0, 3.0), "add_only")
    assert np.array_equal(out[:, :80], grey[:, :80])
    assert (out[30:50, 88:93] == 255).all()


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5), (-0.5, 0.5)])
def test_the_coverage_of_a_disc_between_pixels(offset):
    """Its area, and its middle where it is said to be."""
    share = disc_coverage(2.2, 3.1, offset)
    y, x = np.indices(share.shape)
    assert share.sum() == pytest.approx(np.pi * 2.2 * 3.1, rel=0.005)
    middle = (
        (x * share).sum() / share.sum() - share.shape[1] // 2,
        (y * share).sum() / share.sum() - share.shape[0] // 2,
    )
    assert middle == pytest.approx(offset, abs=1e-3)


def test_what_is_kept_of_a_layer_with_greys_is_small(tmp_path):
    """A run keeps something of every layer until its end: no image, or a large job of greys takes gigabytes."""
    image = np.zeros((400, 400), np.uint8)
    image[100:300, 100:300], image[50:350, 200], image[99, 100:300] = 255, 255, 90
    folder = tmp_path / "greys"
    folder.mkdir()
    Picture.fromarray(image).save(folder / "0.png")
    fixed = lf.correct(lf.read(folder, pixel_mm=0.05, layer_mm=0.05), min_feature_mm=0.4)
    layer = fixed[0]
    assert layer.change is not None
    assert layer.change.paths is not None, "where F was drawn is known while greys are written"
    assert len(pickle.dumps(layer.without_pixels())) < 4000
