"""The metric rule a strip at a time: the same pixels, however narrow the strips."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from layerfix import meso_skeleton
from layerfix.bits import pack, unpack
from layerfix.layers.columns import to_columns, to_rows
from layerfix.layers.metric import levels
from layerfix.layers.metric.tiles import near_free, tiles_of


@pytest.mark.parametrize("size", [(8, 8), (8, 6), (20, 20), (13, 21), (60, 45)])
@pytest.mark.parametrize("seed", [0, 1])
def test_strips_make_no_difference(monkeypatch, size, seed):
    """Blobs some words wide, with walls through them."""
    noise = np.random.default_rng(seed).standard_normal((260, 900)).astype(np.float32)
    image = cv2.GaussianBlur(noise, (0, 0), 4 + 8 * seed) > 0
    image[120:124] = True
    image[:, 500:503] = True
    found = []
    for strip in (100, 1):
        monkeypatch.setattr(levels, "STRIP", strip)
        levels.plan_for.cache_clear()
        found.append(meso_skeleton(image, min_feature_px=size, spurs="metric"))
    levels.plan_for.cache_clear()
    assert np.array_equal(*found)


@given(
    st.integers(1, 900),
    st.integers(1, 900),
    st.integers(1, 400),
    st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=3),
)
def test_what_is_near_free_pixels_is_looked_at(height, width, margin, free):
    """All of S and A within the margin of a pixel of S that is not anchored, in tiles of any number."""
    solid = np.ones((height, width), bool)
    anchor = solid.copy()
    near = np.zeros_like(solid)
    for down, across in free:
        y, x = int(down * (height - 1)), int(across * (width - 1))
        anchor[y, x] = False
        near[max(y - margin, 0) : y + margin + 1, max(x - margin, 0) : x + margin + 1] = True
    box = (-1, height + 1, -1, pack(solid).shape[1] + 1)
    images = [to_columns(pack(image), box) for image in (solid, anchor)]
    found = np.zeros((2, *images[0].shape), np.uint64)
    live = np.zeros((2, len(images[0]), tiles_of(images[0].shape[1])), np.uint8)
    near_free(*images, margin, found[0], live[0], found[1], live[1])
    for image, columns in zip((solid, anchor), found, strict=True):
        rows = np.zeros_like(pack(image))
        to_rows(columns, box, width, rows)
        assert np.array_equal(unpack(rows, width)[near], image[near])
