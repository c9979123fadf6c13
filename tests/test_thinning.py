"""Guo–Hall thinning and spur removal, phase by phase, against the slow twin and skimage.

The kernels look only at blocks of pixels near a change. So whole runs are compared after each phase, not only
single phases: a block wrongly left out shows up in the first phase that should have touched it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from skimage.morphology import thin

from layerfix.bits import pack, unpack
from layerfix.layers.columns import BLOCK, bounding_box, to_columns, to_rows, with_border
from layerfix.layers.thinning import FIRST, SECOND, SPURS, remove_spurs, start_changes, sub_iteration
from tests import slow_twin
from tests.pictures_as_text import drawing, images, picture, radii

WIDE = st.sampled_from([4095, 4096, 4097, 4100, 8300])
NO_SPURS, SPURS_TO_THE_END = 0.0, 1e9


class Thinner:
    """The kernels on one image, with the scratch arrays that they share from phase to phase."""

    def __init__(self, image: np.ndarray, anchor: np.ndarray) -> None:
        self.height, self.width = image.shape
        rows = pack(image)
        self.outer = with_border(bounding_box(rows), 0, 0)
        self.columns = to_columns(rows, self.outer)
        self.anchor = to_columns(pack(anchor), self.outer)
        words, height = self.columns.shape
        self.changed = np.empty((3, words, (height - 2) // BLOCK), np.uint8)
        self.active = np.zeros(self.changed.shape[1:], np.uint8)
        self.gone = np.zeros((2, height), np.uint64)
        self.ends = np.full_like(self.columns, 2**64 - 1)  # what an earlier call left must not matter
        start_changes(self.columns, self.changed)

    def thin(self, phase: int) -> bool:
        return sub_iteration(self.columns, self.anchor, phase, self.changed, self.active, self.gone)

    def spurs(self) -> bool:
        return remove_spurs(self.columns, self.anchor, self.changed, self.active, self.gone, self.ends)

    def image(self) -> np.ndarray:
        rows = np.zeros((self.height, (self.width + 63) // 64), np.uint64)
        to_rows(self.columns, self.outer, self.width, rows)
        return unpack(rows, self.width)


def fast_steps(image: np.ndarray, anchor: np.ndarray, spur_rounds: float) -> Iterator[np.ndarray]:
    """What `slow_twin.steps` gives, by the kernels: the image after each phase until nothing changes."""
    thinner, again, j = Thinner(image, anchor), True, 0
    while again:
        again = False
        for phase in (FIRST, SECOND):
            again |= thinner.thin(phase)
            yield thinner.image()
        if j < spur_rounds:
            again |= thinner.spurs()
            yield thinner.image()
        else:
            thinner.changed[SPURS] = 0
        j += 1


@st.composite
def anchored(draw: st.DrawFn, shapes: st.SearchStrategy[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """A non-empty image and its anchor: nothing, an erosion, or any of its pixels."""
    image = draw(shapes)
    assume(image.any())
    kind = draw(st.sampled_from(["none", "erosion", "any"]))
    if kind == "erosion":
        return image, slow_twin.erosion(image, *draw(radii(0.6, 5)))
    if kind == "any":
        share = draw(st.sampled_from([0.02, 0.3]))
        return image, image & (np.random.default_rng(draw(st.integers(0, 999))).random(image.shape) < share)
    return image, np.zeros_like(image)


def assert_same_steps(image: np.ndarray, anchor: np.ndarray, spur_rounds: float) -> None:
    """Kernels and twin agree after every phase and stop at the same time."""
    pairs = zip(fast_steps(image, anchor, spur_rounds), slow_twin.steps(image, anchor, spur_rounds), strict=True)
    for number, (fast, slow) in enumerate(pairs):
        assert np.array_equal(fast, slow), f"phase {number} of\n{drawing(image)}"


@pytest.mark.parametrize("phase", [FIRST, SECOND])
@given(case=anchored(images()))
def test_one_sub_iteration_equals_the_twin(phase, case):
    """Equation 3, conditions (a), (b) and (c.1) or (c.2), bit for bit; it says whether a pixel went."""
    image, anchor = case
    thinner = Thinner(image, anchor)
    changed = thinner.thin(phase)
    expected = slow_twin.sub_iteration(image, anchor, 1 if phase == FIRST else 2)
    assert np.array_equal(thinner.image(), expected), drawing(image)
    assert changed == (not np.array_equal(image, expected))


@given(anchored(images()))
def test_one_spur_step_equals_the_twin(case):
    """End points with their neighbour in the upper half first, then the rest; bit for bit."""
    image, anchor = case
    thinner = Thinner(image, anchor)
    changed = thinner.spurs()
    expected = slow_twin.spur_step(image, anchor)
    assert np.array_equal(thinner.image(), expected), drawing(image)
    assert changed == (not np.array_equal(image, expected))


@given(anchored(images()), st.sampled_from([NO_SPURS, 1, 2.5, 7]))
def test_whole_runs_equal_the_twin_after_every_phase(case, spur_rounds):
    """Widths around the word size, any anchor, spurs removed for some rounds."""
    assert_same_steps(*case, spur_rounds)


@given(
    anchored(images(heights=st.sampled_from([7, 8, 9, 15, 16, 17, 120, 250]), widths=st.integers(1, 20))),
    st.sampled_from([NO_SPURS, 3, SPURS_TO_THE_END]),
)
def test_whole_runs_equal_the_twin_on_tall_images(case, spur_rounds):
    """Blocks of rows with changes, far apart and near, with quiet ones between them."""
    assert_same_steps(*case, spur_rounds)


@given(anchored(images(heights=st.integers(1, 9), widths=WIDE)), st.sampled_from([NO_SPURS, 3]))
def test_whole_runs_equal_the_twin_on_wide_images(case, spur_rounds):
    """Past 4096 px, in a few rows."""
    assert_same_steps(*case, spur_rounds)


def test_a_change_travels_through_quiet_blocks():
    """A line shortens by a pixel or two a round across words and blocks, until only its anchor is left."""
    for image in (np.zeros((40, 300), bool), np.zeros((300, 40), bool), np.zeros((200, 200), bool)):
        height, width = image.shape
        steps = np.arange(max(image.shape))
        image[steps * height // len(steps), steps * width // len(steps)] = True
        anchor = np.zeros_like(image)
        anchor[height // 2] = image[height // 2] & (np.cumsum(image[height // 2]) == 1)
        *_, last = fast_steps(image, anchor, SPURS_TO_THE_END)
        assert np.array_equal(last, anchor)
        assert_same_steps(image, anchor, SPURS_TO_THE_END)


@given(images())
def test_without_anchor_and_spurs_it_is_skimage_thin_step_by_step(image):
    """After k rounds the image is `skimage.morphology.thin(image, max_num_iter=k)`."""
    assume(image.any())
    rounds = list(fast_steps(image, np.zeros_like(image), NO_SPURS))[1::2]
    for k, after in enumerate(rounds, start=1):
        assert np.array_equal(after, thin(image, max_num_iter=k)), drawing(image)
    assert np.array_equal(rounds[-1], thin(image))


@given(anchored(images()))
def test_anchored_pixels_stay_and_nothing_is_added(case):
    """Whatever the rounds, anchor ⊆ result ⊆ image."""
    image, anchor = case
    *_, last = fast_steps(image, anchor, SPURS_TO_THE_END)
    assert not (anchor & ~last).any()
    assert not (last & ~image).any()


def test_the_first_sub_iteration_takes_south_and_west_borders_the_second_the_others():
    """(c.1) keeps pixels with an eastern neighbour unless a border runs below or left of them."""
    block = picture("""
        # # # #
        # # # #
        # # # #
    """)
    thinner = Thinner(block, np.zeros_like(block))
    thinner.thin(FIRST)
    first = drawing(thinner.image())
    assert first == drawing(slow_twin.sub_iteration(block, np.zeros_like(block), 1))
    thinner.thin(SECOND)
    assert drawing(thinner.image()) != first


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("# #", ". #"),
        ("# # #", ". # ."),
        ("# # # #", ". # # ."),
        ("#", "#"),
        ("# . #", "# . #"),
        ("# . .\n. # .", "# . .\n. . ."),
        (". . #\n. # .", ". . #\n. . ."),
        ("# . #\n. # .\n# . #", ". . .\n. # .\n. . ."),
    ],
)
def test_spurs_shorten_by_a_pixel_and_two_pixels_become_one(before, after):
    """An end point goes; of two that have only each other, one stays."""
    image = picture(before)
    thinner = Thinner(image, np.zeros_like(image))
    thinner.spurs()
    assert np.array_equal(thinner.image(), picture(after)), drawing(thinner.image())
