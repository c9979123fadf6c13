"""The meso-skeleton: the recorded cases, the slow twin, and law 1."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from layerfix import correct_image, meso_skeleton
from layerfix.errors import InputError
from tests import slow_twin
from tests.pictures_as_text import block, drawing, framed, images, picture, radii, round_dot, strip

VECTORS = Path(__file__).parents[2] / "shared" / "vectors" / "meso_skeleton.npz"


@cache
def vectors() -> dict[str, np.ndarray]:
    """Everything in the file of recorded cases; nothing if it is not there."""
    if not VECTORS.is_file():
        return {}
    with np.load(VECTORS) as file:
        return dict(file)


def recorded(name: str, what: str) -> np.ndarray:
    """One image of a recorded case."""
    _, width = vectors()[f"{name}/shape"].tolist()
    return np.unpackbits(vectors()[f"{name}/{what}"], axis=1, count=width).astype(bool)


def assert_same(result: np.ndarray, expected: np.ndarray) -> None:
    """Equal to the pixel; shows both as text if not."""
    assert np.array_equal(result, expected), f"\n{drawing(result)}\n\nexpected\n{drawing(expected)}"


@pytest.mark.skipif(not VECTORS.is_file(), reason="the recorded cases are not here")
def test_there_are_74_recorded_cases():
    """None of them got lost."""
    assert len({key.rsplit("/", 1)[0] for key in vectors()}) == 74


@pytest.mark.skipif(not VECTORS.is_file(), reason="the recorded cases are not here")
@pytest.mark.parametrize("name", sorted({key.rsplit("/", 1)[0] for key in vectors()}))
def test_recorded_case(name):
    """M̂ and Ŝ as recorded, bit for bit."""
    rx, ry = vectors()[f"{name}/radius_px_xy"].tolist()
    image = recorded(name, "image")
    assert np.array_equal(meso_skeleton(image, (rx, ry)), recorded(name, "meso"))
    assert np.array_equal(correct_image(image, (rx, ry), "as_printed"), recorded(name, "corrected"))


@settings(max_examples=200)
@given(images(), radii())
def test_equals_the_twin(image, radius):
    """Bit for bit at widths around the word size, equal radii or not."""
    assert_same(meso_skeleton(image, radius), slow_twin.meso_skeleton(image, *radius))


@given(images(heights=st.sampled_from([63, 64, 65, 150]), widths=st.integers(1, 150)), radii())
def test_equals_the_twin_on_larger_images(image, radius):
    """Several blocks of rows and several words."""
    assert_same(meso_skeleton(image, radius), slow_twin.meso_skeleton(image, *radius))


@given(images(heights=st.integers(1, 9), widths=st.sampled_from([4095, 4097, 4100, 8300])), radii(0.6, 4))
def test_equals_the_twin_on_wide_images(image, radius):
    """Past 4096 px, too."""
    assert_same(meso_skeleton(image, radius), slow_twin.meso_skeleton(image, *radius))


@settings(max_examples=300)
@given(images(heights=st.integers(1, 90), widths=st.integers(1, 140)), radii())
def test_law_1_it_lies_between_erosion_and_image_and_keeps_the_topology(image, radius):
    """M ⊆ M̂ ⊆ S, with S's components (8-connected) and holes (4-connected void)."""
    skeleton = meso_skeleton(image, radius)
    assert not (slow_twin.erosion(image, *radius) & ~skeleton).any()
    assert not (skeleton & ~image).any()
    assert slow_twin.topology(skeleton) == slow_twin.topology(image), drawing(image)


@pytest.mark.parametrize("seed", range(4))
def test_law_1_on_very_many_small_images(seed):
    """The same for 10,000 random 8 × 8 px images at once, side by side with void between them."""
    random = np.random.default_rng(seed)
    images = framed(np.zeros((900, 900), bool), 0)
    cells = images.reshape(100, 9, 100, 9).swapaxes(1, 2)  # a view: [row, column] of a 9 × 9 px cell
    cells[:, :, 1:, 1:] = random.random((100, 100, 8, 8)) < random.uniform(0.3, 0.95, (100, 100, 1, 1))
    images = np.pad(cells.swapaxes(1, 2).reshape(900, 900), ((0, 1), (0, 1)))
    radius = (1.0, 1.5, 2.0, (1.0, 2.0))[seed]
    skeleton = meso_skeleton(images, radius)
    assert slow_twin.topology(skeleton) == slow_twin.topology(images)
    for connected, whole, thinned in ((8, images, skeleton), (4, ~images, ~skeleton)):
        assert np.array_equal(parts_per_cell(whole, connected), parts_per_cell(thinned, connected))


def parts_per_cell(image: np.ndarray, connected: int) -> np.ndarray:
    """How many 8- or 4-connected parts touch each 9 × 9 px cell (its void includes the lines between cells)."""
    from scipy import ndimage

    labels, _ = ndimage.label(image, np.ones((3, 3)) if connected == 8 else None)
    y, x = np.nonzero(image)
    inside = (y < 900) & (x < 900)
    pairs = np.unique(np.stack([y // 9 * 100 + x // 9, labels[y, x]])[:, inside], axis=1)
    return np.bincount(pairs[0], minlength=10_000)


def test_a_part_larger_than_the_feature_is_its_erosion():
    """Nothing thin, no path: M̂ = M for a block and for a disc."""
    for image in (block(20, 30, 4), round_dot(12, 31)):
        assert_same(meso_skeleton(image, 3), slow_twin.erosion(image, 3, 3))


def test_a_thin_wall_becomes_a_line_shorter_by_the_radius_at_either_end():
    """A 3 px wall, 15 px long, with radius 3: a path one pixel wide that ends about 3 px before the wall."""
    skeleton = meso_skeleton(block(3, 15, 4), 3)
    assert skeleton.sum(axis=0).max() == 1
    assert skeleton.sum() == np.ptp(np.flatnonzero(skeleton.any(axis=0))) + 1
    assert 15 - 2 * 3 - 2 <= skeleton.sum() <= 15 - 2 * 3 + 2
    assert np.flatnonzero(skeleton.any(axis=1)).tolist() == [5]


def test_two_pixels_become_one():
    """Spur removal never erases a component (the literal rule would)."""
    for pair in ("# #", "# .\n. #", ". #\n# .", "#\n#"):
        assert meso_skeleton(framed(picture(pair), 2), 3).sum() == 1


def test_every_single_pixel_stays():
    """Pins of one pixel, however many."""
    image = np.zeros((40, 130), bool)
    image[1::3, ::2] = True
    assert_same(meso_skeleton(image, 2.5), image)


def test_a_thin_ring_becomes_a_closed_line():
    """One component, one hole, before and after."""
    ring = round_dot(12, 35) & ~round_dot(9, 35)
    skeleton = meso_skeleton(ring, 4)
    assert slow_twin.topology(skeleton) == slow_twin.topology(ring) == (1, 1)
    assert skeleton.sum() < ring.sum() / 2


def test_a_fin_on_a_block_keeps_a_path_to_it():
    """The neck between a wide part and a thin one is not lost: one component, and the path is one pixel wide."""
    image = framed(np.zeros((30, 60), bool), 2)
    image[4:30, 4:26] = True
    image[15:18, 26:55] = True
    skeleton = meso_skeleton(image, 4)
    assert slow_twin.topology(skeleton) == (1, 0)
    assert skeleton[:, 35:50].sum(axis=0).tolist() == [1] * 15


@pytest.mark.parametrize("degrees", [0, 13, 22.5, 45, 77, 90])
def test_a_slanted_thin_wall_keeps_one_path(degrees):
    """At every angle: one component, no hole, about as many pixels as the wall is long."""
    skeleton = meso_skeleton(strip(4, degrees), 6)
    assert slow_twin.topology(skeleton) == (1, 0)
    long_side = 80 * max(abs(np.cos(np.radians(degrees))), abs(np.sin(np.radians(degrees))))
    assert long_side - 20 < skeleton.sum() <= long_side + 2


def test_one_radius_is_two_equal_ones():
    """radius_px is one number or (rx, ry)."""
    image = strip(4, 30)
    assert_same(meso_skeleton(image, 3.5), meso_skeleton(image, (3.5, 3.5)))
    assert_same(meso_skeleton(image, 3), meso_skeleton(image, (3.0, 3.0)))


@pytest.mark.parametrize("radius", [np.int64(3), np.float32(3)])
def test_a_radius_may_be_a_numpy_number(radius):
    """What comes out of an array counts as a number too."""
    image = strip(4, 30)
    assert_same(meso_skeleton(image, radius), meso_skeleton(image, 3.0))


@given(images(), radii())
def test_the_input_is_untouched(image, radius):
    """Also when it may not be written to."""
    image.flags.writeable = False
    before = image.copy()
    meso_skeleton(image, radius)
    assert_same(image, before)


def test_anything_but_0_is_solid_and_lists_are_images():
    """As `pack` has it."""
    assert meso_skeleton([[0, 255, 0]], 1).tolist() == [[False, True, False]]


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (1, 1), (3, 64)])
def test_empty_stays_empty(shape):
    """Images without solid, or without pixels, keep their shape."""
    result = meso_skeleton(np.zeros(shape, bool), 2)
    assert result.shape == shape
    assert not result.any()


@pytest.mark.parametrize("radius", [0, -1, float("nan"), float("inf"), (1, 0), (float("nan"), 1), (1, 2, 3), (1,)])
def test_a_radius_is_one_or_two_numbers_above_0(radius):
    """The message names the radius."""
    with pytest.raises(InputError) as caught:
        meso_skeleton(np.ones((3, 3), bool), radius)
    assert str(radius) in str(caught.value)


def test_an_unknown_spur_rule_lists_the_known():
    """The message names the rule and the choices."""
    with pytest.raises(InputError, match=r"spurs='sharp' is not known; choose from metric, paper"):
        meso_skeleton(np.ones((3, 3), bool), 1, spurs="sharp")


@pytest.mark.parametrize("shape", [(5,), (2, 3, 4)])
def test_an_image_has_two_dimensions(shape):
    """The message says what came."""
    with pytest.raises(InputError, match="two dimensions"):
        meso_skeleton(np.ones(shape), 1)
