"""Flood fill on packed rows against scipy's labels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from layerfix.bits import pack, unpack
from layerfix.layers.flood import flood

WIDTHS = (1, 2, 63, 64, 65, 127, 128, 129, 130, 200)


def by_labels(seed: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The 8-connected components of the mask that hold a seed."""
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    found = np.zeros(count + 1, bool)
    found[labels[seed & mask]] = True
    found[0] = False
    return found[labels]


def flooded(seed: np.ndarray, mask: np.ndarray) -> np.ndarray:
    rows = flood(pack(seed), pack(mask))
    image = unpack(rows, mask.shape[1])
    assert np.array_equal(pack(image), rows), "bits past the width"
    return image


@given(st.integers(1, 30), st.sampled_from(WIDTHS), st.sampled_from([0.05, 0.3, 0.4, 0.5, 0.6, 0.9, 1.0]),
       st.sampled_from([0.0, 0.002, 0.05, 1.0]), st.integers(0, 2**32 - 1))  # fmt: skip
def test_random_masks_and_seeds(height, width, share, seeds, number):
    """Seeds outside the mask count for nothing; whole components are found, others not at all."""
    rng = np.random.default_rng(number)
    mask, seed = rng.random((height, width)) < share, rng.random((height, width)) < seeds
    assert np.array_equal(flooded(seed, mask), by_labels(seed, mask))


def spiral(size: int) -> np.ndarray:
    """One path of single pixels from the corner to the middle."""
    image = np.zeros((size, size), bool)
    y = x = 0
    dy, dx = 0, 1
    image[0, 0] = True
    while True:
        steps = 0
        while True:
            ny, nx = y + dy, x + dx
            ahead = ny + dy, nx + dx
            if not (0 <= ny < size and 0 <= nx < size):
                break
            if 0 <= ahead[0] < size and 0 <= ahead[1] < size and image[ahead]:
                break
            y, x, steps = ny, nx, steps + 1
            image[y, x] = True
        if steps < 2:
            return image
        dy, dx = dx, -dy


def snake(height: int, width: int) -> np.ndarray:
    """Up one column and down the next but one."""
    image = np.zeros((height, width), bool)
    image[:, ::2] = True
    image[0, 1::4] = image[-1, 3::4] = True
    return image


@pytest.mark.parametrize("turned", range(4))
@pytest.mark.parametrize("picture", [spiral(130), spiral(65), snake(40, 150), snake(41, 129)])
def test_long_winding_paths(picture, turned):
    """From one end to the other, however often the path turns, and no further."""
    mask = np.ascontiguousarray(np.rot90(picture, turned))
    ends = np.argwhere(mask)
    for y, x in (ends[0], ends[-1]):
        seed = np.zeros_like(mask)
        seed[y, x] = True
        assert np.array_equal(flooded(seed, mask), by_labels(seed, mask))


@pytest.mark.parametrize("width", [64, 65, 128, 130])
def test_diagonal_steps_over_the_ends_of_words(width):
    """Pixels that touch by their corners hang together, between two words too."""
    mask = np.eye(width, dtype=bool)
    for picture in (mask, mask[:, ::-1].copy()):
        seed = np.zeros_like(picture)
        seed[0] = True
        assert np.array_equal(flooded(seed, picture), picture)


def test_a_large_snake_takes_no_time():
    """A path that turns a thousand times on a layer of a million pixels."""
    mask = snake(600, 2000)
    seed = np.zeros_like(mask)
    seed[0, 0] = True
    assert np.array_equal(flooded(seed, mask), mask)
