"""F by size: it is as wide as it says, and what is that wide already is left alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from layerfix import correct_image, meso_skeleton
from layerfix.errors import InputError
from layerfix.layers.feature import feature_of_mm, feature_of_radius, feature_of_size
from tests import slow_metric, slow_twin
from tests.isotropy import axes
from tests.pictures_as_text import block, drawing, framed, images

SIZES = st.one_of(st.integers(2, 16).map(float), st.floats(1.5, 16))
SPURS = st.sampled_from(["metric", "paper"])
ANGLES = (7, 15, 22.5, 30, 37, 45, 53, 60, 67.5, 75, 83)
MARGIN_PX = 18


def offsets(size_px: float | tuple[float, float]) -> set[tuple[int, int]]:
    """F from what `feature_of_size` says: G, swept over the block."""
    feature = feature_of_size(size_px)
    half_widths = feature.half_widths
    return {
        (dx + bx, dy + by)
        for dy in range(-len(half_widths) + 1, len(half_widths))
        for dx in range(-half_widths[abs(dy)], half_widths[abs(dy)] + 1)
        for bx in range(feature.block[0] + 1)
        for by in range(feature.block[1] + 1)
    }


@given(SIZES, SIZES)
def test_f_is_the_pixels_within_half_its_size_of_a_point(dx, dy):
    """The definition, pixel by pixel, on each axis of its own."""
    assert offsets((dx, dy)) == set(slow_metric.feature_offsets(dx, dy))
    assert feature_of_size((dx, dy)).size_px == (np.floor(dx + 0.5), np.floor(dy + 0.5))


@pytest.mark.parametrize("size", range(7, 40))
def test_f_has_the_area_of_a_disc(size):
    """Within 10 % from seven pixels on."""
    assert len(offsets(float(size))) == pytest.approx(np.pi * size**2 / 4, rel=0.1)


@pytest.mark.parametrize(("size_mm", "wide"), [(0.1, 2), (0.2, 4), (0.3, 6), (0.4, 8), (0.8, 16), (0.35, 7)])
def test_a_feature_in_mm_is_that_wide(size_mm, wide):
    """At 50 µm: 0.8 mm is 16 px, not 17."""
    assert feature_of_mm(size_mm, (0.05, 0.05)).size_px == (wide, wide)


@pytest.mark.parametrize("size", range(2, 25))
@pytest.mark.parametrize("turned", [np.asarray, np.transpose], ids=["lying", "standing"])
@pytest.mark.parametrize("spurs", ["metric", "paper"])
def test_walls_along_an_axis_are_exact(size, turned, spurs):
    """A wall of F's width gains nothing; one of a pixel comes out as wide as F, no more and no less."""
    wide = turned(block(size, 3 * size + 20, size + 2))
    assert not (correct_image(wide, min_feature_px=size, spurs=spurs) & ~wide).any()
    line = turned(block(1, 6 * size + 20, size + 2))
    fixed = turned(correct_image(line, min_feature_px=size, spurs=spurs))
    middle = fixed.shape[1] // 2
    assert fixed[:, middle - 5 : middle + 5].sum(axis=0).tolist() == [size] * 10


@pytest.mark.parametrize("size", [5, 6, 7, 8, 11, 12, 16])
def test_slanted_walls_of_half_a_pixel_more_are_left_alone(size):
    """At eleven angles, three places each."""
    for degrees in ANGLES:
        for place in (0, 0.31, 0.5):
            u, v = axes(10 * size + 60, degrees)
            length = (10 * size + 60) / 2
            wall = (abs(v + place) <= (size + 0.5) / 2) & (abs(u) < length - 2 * size - 2)
            fixed = correct_image(wall, min_feature_px=size)
            assert not (fixed & ~wall & (abs(u) < length - 4 * size - 6)).any(), (degrees, place)


@pytest.mark.parametrize("size", [4, 5, 8, 9, 12, 14, 20])
def test_slanted_lines_of_a_pixel_come_out_as_wide_as_f(size):
    """Area over length, within a pixel, at eleven angles."""
    for degrees in ANGLES:
        for place in (0, 0.31, 0.5):
            n = 10 * size + 60
            u, v = axes(n, degrees)
            line = (abs(v + place) <= 0.72) & (abs(u) < n / 2 - 2 * size - 2)
            inner = n / 2 - 4 * size - 6
            area = (correct_image(line, min_feature_px=size) & (abs(u) < inner)).sum()
            assert area / (2 * inner) == pytest.approx(size, abs=1), (degrees, place)


@pytest.mark.parametrize("size", range(2, 25))
def test_a_single_pixel_becomes_f(size):
    """No more, no less."""
    dot = block(1, 1, size + 2)
    fixed = correct_image(dot, min_feature_px=size)
    expected = np.zeros_like(dot)
    for dx, dy in slow_metric.feature_offsets(size, size):
        expected[size + 2 + dy, size + 2 + dx] = True
    assert np.array_equal(fixed, expected), drawing(fixed)


@settings(max_examples=150)
@given(images(), SIZES, SIZES, st.booleans(), SPURS)
def test_equals_the_twin(image, dx, dy, round_one, spurs):
    """The anchor, M̂, what is drawn and the result, bit for bit."""
    dy = dx if round_one else dy
    image = framed(image, 20)
    anchor = slow_metric.anchor_of(image, dx, dy)
    if spurs == "paper":
        *_, skeleton = slow_twin.steps(image, anchor, max(dx, dy) / 2)
    else:
        skeleton = slow_metric.thin_metric(image, anchor, dx / 2, dy / 2, slow_metric.feature_offsets(dx, dy))
    found = meso_skeleton(image, min_feature_px=(dx, dy), spurs=spurs)
    assert np.array_equal(found, skeleton), f"\n{drawing(found)}\n\nexpected\n{drawing(skeleton)}"
    expected = slow_metric.corrected(image, dx, dy, skeleton)
    assert np.array_equal(correct_image(image, min_feature_px=(dx, dy), spurs=spurs), expected)
    added = correct_image(image, mode="add_only", min_feature_px=(dx, dy), spurs=spurs)
    assert np.array_equal(added, expected | image)


@settings(max_examples=300)
@given(images(), SIZES, SIZES, SPURS)
def test_the_laws(image, dx, dy, spurs):
    """A ⊆ M̂ ⊆ S ∩ Ŝ, M̂ has S's topology, S ∘ F ⊆ Ŝ, and what comes out is printable: Ŝ ∘ F = Ŝ."""
    image = framed(image, MARGIN_PX)
    skeleton = meso_skeleton(image, min_feature_px=(dx, dy), spurs=spurs)
    printed = correct_image(image, min_feature_px=(dx, dy), spurs=spurs)
    assert slow_twin.topology(skeleton) == slow_twin.topology(image)
    assert not (skeleton & ~(image & printed)).any()
    assert not (slow_metric.anchor_of(image, dx, dy) & ~skeleton).any()
    assert not (slow_metric.opening(image, dx, dy) & ~printed).any()
    assert np.array_equal(slow_metric.opening(printed, dx, dy), printed)


@pytest.mark.parametrize("width", [0.8, 1.0, 1.2, 1.5, 2.0])
def test_hairline_slots_stay_open(width):
    """Slots of about a pixel between thick bodies that touch in corners, at 13 angles: filled by 1 % on average."""
    filled, size = [], 8
    for degrees in (0, *ANGLES, 90):
        for place in (0, 0.31, 0.5):
            u, v = axes(8 * size + 50, degrees)
            radius = (8 * size + 50) / 2 - 4
            slot = (abs(v + place) < width / 2) & (abs(u) < radius - 2.5 * size - 2)
            image = (np.hypot(u, v) < radius) & ~slot
            if slot.any():
                filled.append((correct_image(image, mode="add_only", min_feature_px=size) & slot).sum() / slot.sum())
    assert np.mean(filled) < 0.01


@pytest.mark.parametrize("size", [4, 8, 12])
def test_hairlines_that_meet_a_body_stay_joined(size):
    """A line of a pixel on a block is thickened up to the block."""
    image = framed(np.zeros((8 * size, 12 * size), bool), size)
    image[2 * size : 6 * size, size : 5 * size] = True
    image[4 * size, 5 * size : 11 * size] = True
    fixed = correct_image(image, min_feature_px=size)
    assert slow_twin.topology(fixed) == (1, 0)
    assert fixed[:, 6 * size : 10 * size].sum(axis=0).tolist() == [size] * 4 * size


def test_by_radius_or_by_size():
    """One of the two, not both and not neither."""
    for given_twice in ({}, {"radius_px": 3, "min_feature_px": 6}):
        with pytest.raises(InputError, match="either by radius_px or by min_feature_px"):
            meso_skeleton(block(3, 9, 4), **given_twice)


def test_by_radius_it_is_the_papers():
    """Every path is drawn, and spurs are the paper's unless asked otherwise."""
    image = framed(images_of_a_bar(), 6)
    assert feature_of_radius(3.0).block == (0, 0)
    assert np.array_equal(correct_image(image, 3), slow_twin.corrected(image, 3, 3, "as_printed"))
    assert not np.array_equal(correct_image(image, 3), correct_image(image, 3, spurs="metric"))


def images_of_a_bar() -> np.ndarray:
    """A bar turned by 20°, six pixels wide."""
    u, v = axes(60, 20)
    return (abs(u) < 24) & (abs(v) < 3)


@pytest.mark.parametrize("size", [0, -1, float("nan"), (1, 0), (1, 2, 3)])
def test_a_size_is_one_or_two_numbers_above_0(size):
    """The message names it."""
    with pytest.raises(InputError, match="minimum feature"):
        feature_of_size(size)


def test_a_feature_of_a_metre_is_refused():
    """Before any work."""
    with pytest.raises(InputError, match="at most 8192 px"):
        feature_of_size(8193)
    with pytest.raises(InputError, match="at most 4096 px"):
        feature_of_radius(4097)
