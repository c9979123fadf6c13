"""The metric spur rule: corners, strips, bumps and edges come out alike at every angle (see `tests.isotropy`)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from layerfix import meso_skeleton
from layerfix.layers.columns import Room
from layerfix.layers.metric.levels import plan_for
from tests import isotropy, slow_metric, slow_twin
from tests.pictures_as_text import drawing, framed, images, radii, strip

OFF_GRID = np.arange(2.3, 90, 9.7)


@settings(max_examples=150)
@given(images(), radii(1, 9))
def test_equals_the_twin_by_radius(image, radius):
    """Square pixels and others, whatever touches the frame."""
    image = framed(image, 1)
    expected = slow_metric.thin_metric(
        image, slow_twin.erosion(image, *radius), *radius, slow_metric.disc_offsets(*radius)
    )
    found = meso_skeleton(image, radius, spurs="metric")
    assert np.array_equal(found, expected), f"\n{drawing(found)}\n\nexpected\n{drawing(expected)}"


@settings(max_examples=40)
@given(images(heights=st.integers(60, 150), widths=st.integers(60, 150)), radii(4, 20))
def test_equals_the_twin_on_larger_images(image, radius):
    """Several tiles, many levels."""
    image = framed(image, 1)
    expected = slow_metric.thin_metric(
        image, slow_twin.erosion(image, *radius), *radius, slow_metric.disc_offsets(*radius)
    )
    assert np.array_equal(meso_skeleton(image, radius, spurs="metric"), expected)


@settings(max_examples=300)
@given(images(widths=st.integers(1, 130), heights=st.integers(1, 90)), radii(1, 12))
def test_law_1(image, radius):
    """M ⊆ M̂ ⊆ S, and M̂ has S's components and holes."""
    skeleton = meso_skeleton(image, radius, spurs="metric")
    assert not (skeleton & ~image).any()
    assert not (slow_twin.erosion(image, *radius) & ~skeleton).any()
    assert slow_twin.topology(skeleton) == slow_twin.topology(image)


def test_one_room_serves_one_layer_after_the_other():
    """Whatever their sizes, and whatever was there before."""
    random = np.random.default_rng(5)
    from layerfix import LayerStack, correct

    layers = [random.random((n, n + 7)) < 0.6 for n in (90, 40, 200, 41, 130, 199)]
    size = max(max(layer.shape) for layer in layers)
    padded = [np.pad(layer, ((0, size - layer.shape[0]), (0, size - layer.shape[1]))) for layer in layers]
    stack = LayerStack.from_images(padded, pixel_mm=1.0, layer_mm=1.0)
    one_room = [layer.image() for layer in correct(stack, min_feature_mm=8).with_workers(1)]
    for image, fixed in zip(padded, one_room, strict=True):
        alone = LayerStack.from_images([image], pixel_mm=1.0, layer_mm=1.0)
        assert np.array_equal(correct(alone, min_feature_mm=8)[0].image(), fixed)


def test_what_was_lent_and_not_given_back_is_not_lent_again():
    """Someone who breaks off leaves nothing behind."""
    room = Room()
    first = room.zeros(420)
    first[:] = 1
    assert not room.zeros(420).any()
    first[:] = 0
    room.emptied(first)
    assert np.shares_memory(room.zeros(210), first)


@pytest.mark.parametrize("size", [8, 12, 20])
@pytest.mark.parametrize("sides", [4, 6])
def test_nothing_is_added_at_blunt_corners(size, sides):
    """Squares and hexagons at every 5° and at angles off that grid."""
    fix = isotropy.rules(size)["metric"]
    for angles in (isotropy.ANGLES[::2], OFF_GRID):
        assert isotropy.corners(fix, size, sides, angles)[0] == 0


@pytest.mark.parametrize("size", [8, 10, 12, 14, 16, 20, 25, 30])
def test_strips_keep_their_length(size):
    """Within 2 px in 99 %, never beyond 3 px, on and off the grid; of F by size."""
    fix = isotropy.rules(size)["metric"]
    errors = np.concatenate([isotropy.strip_errors(fix, size, angles) for angles in (isotropy.ANGLES[::2], OFF_GRID)])
    assert (abs(errors) > 2.01).mean() <= 0.01
    assert abs(errors).max() <= 3
    assert abs(errors.mean()) <= 0.35


@pytest.mark.parametrize("size", [8, 12, 16])
def test_short_bumps_vanish_and_long_ones_keep_their_tips(size):
    """Under d / 4 nothing is added; from d on the tip is within 1.5 px."""
    fix = isotropy.rules(size)["metric"]
    assert isotropy.bumps(fix, size, (0.15, 0.24), OFF_GRID[::2])[0] == 0
    _, least, most = isotropy.bumps(fix, size, (1, 3), OFF_GRID[::2])
    assert -1.5 <= least <= most <= 1.5


@pytest.mark.parametrize("size", [8, 14])
def test_noisy_edges_stay_edges(size):
    """Hundredths of a pixel per pixel of a straight edge with a pixel of noise."""
    assert isotropy.edges(isotropy.rules(size)["metric"], size, OFF_GRID[::3]) <= 0.01


def test_thousands_of_ends():
    """A comb of 1,500 teeth is many combs of three."""
    comb = np.zeros((40, 9 * 1500), bool)
    comb[4:12] = True
    for tooth in range(1500):
        comb[:33, 9 * tooth + 4 : 9 * tooth + 6] = True
    comb[33:] = False
    comb[:4] = False
    found = meso_skeleton(comb, min_feature_px=6)
    middle = meso_skeleton(comb[:, : 9 * 9], min_feature_px=6)[:, 27:54]
    for first in range(27, 9 * 1500 - 54, 27):
        assert np.array_equal(found[:, first : first + 27], middle)


@pytest.mark.parametrize("degrees", [0, 11, 25, 45, 62, 90])
def test_a_thin_strip_has_one_path(degrees):
    """As by the paper's rule: one component, a pixel wide."""
    skeleton = meso_skeleton(strip(4, degrees), 6, spurs="metric")
    assert slow_twin.topology(skeleton) == (1, 0)
    assert skeleton.sum() <= 84


@pytest.mark.parametrize("radius", [2.0, 4.0, 7.5, 20.0])
def test_levels_are_discs(radius):
    """The sums of elements have the area of discs of their radius, and stay below F."""
    plan = plan_for(radius, radius)
    assert plan.round
    for first, length in zip(plan.outside, plan.lengths[plan.outside], strict=True):
        assert length <= radius + 0.5
        assert np.pi * (length - 1.1) ** 2 <= first + 1
