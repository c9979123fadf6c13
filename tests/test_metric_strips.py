"""The metric rule a strip at a time: the same pixels, however narrow the strips."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from layerfix import meso_skeleton
from layerfix.layers.metric import rule


@pytest.mark.parametrize("size", [(8, 8), (8, 6), (20, 20), (13, 21), (60, 45)])
@pytest.mark.parametrize("seed", [0, 1])
def test_strips_make_no_difference(monkeypatch, size, seed):
    """Blobs some words wide, with walls through them."""
    noise = np.random.default_rng(seed).standard_normal((260, 900)).astype(np.float32)
    image = cv2.GaussianBlur(noise, (0, 0), 4 + 8 * seed) > 0
    image[120:124] = True
    image[:, 500:503] = True
    monkeypatch.setattr(rule, "STRIP", 100)
    whole = meso_skeleton(image, min_feature_px=size, spurs="metric")
    monkeypatch.setattr(rule, "STRIP", 1)
    assert np.array_equal(meso_skeleton(image, min_feature_px=size, spurs="metric"), whole)
