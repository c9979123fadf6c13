"""Layers to measure on."""

import cv2
import numpy as np


def blobs(width: int, height: int, scale_px: float, seed: int = 0) -> np.ndarray:
    """(height, width) bool: random blobs about `scale_px` wide, half of the layer solid."""
    noise = np.random.default_rng(seed).standard_normal((height, width)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), scale_px / 3) > 0


def sparse(width: int, height: int) -> np.ndarray:
    """(height, width) bool: a ring wall and a bar, 6 and 40 px thick; 2 % of the layer solid."""
    y, x = np.mgrid[:height, :width]
    distance = np.hypot(y - height / 2, x - width / 2)
    radius = min(width, height) / 3
    layer = (distance < radius) & (distance > radius - 6)
    layer[height // 20 : height // 20 + 40, width // 10 : -width // 10] = True
    return layer


def plate(width: int, height: int, tile: np.ndarray) -> np.ndarray:
    """(height, width) bool: `tile` repeated over the frame."""
    repeats = -(-height // tile.shape[0]), -(-width // tile.shape[1])
    return np.tile(tile, repeats)[:height, :width]
