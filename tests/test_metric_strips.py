"""The metric rule a strip at a time: the same pixels, however narrow the strips."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from layerfix import meso_skeleton
from layerfix.layers.metric import levels


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
