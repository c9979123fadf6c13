"""Layers with greys (anti-aliased): what of them is solid, and how a correction is drawn into them.

A pixel is solid from `threshold` on. A stroke so thin that it never gets there is a feature all the same, if it
stands alone and reaches `grey_floor`. What is added is drawn with the coverage of F's disc at its rim; every
other pixel keeps its value, and in mode "add_only" none gets darker.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, WORK, words_for
from layerfix.kernels import njit
from layerfix.layers.flood import flood
from layerfix.layers.morphology import dilate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

    Greys = NDArray[np.uint8]

IMAGE = types.Array(types.uint8, 2, "C", readonly=True)
TARGET = types.Array(types.uint8, 2, "C")
U8 = np.uint8(1)
SUBSTEPS = 64  # columns a pixel is cut into for its coverage; each is exact in y


@njit(types.void(IMAGE, types.uint8, WORK), cache=True, nogil=True)
def _pack_from(image, threshold, rows):  # type: ignore[no-untyped-def]
    height, width = image.shape
    for y in range(height):
        for w in range(rows.shape[1]):
            part = image[y, w * 64 : min(w * 64 + 64, width)]
            word = U0
            for i in range(part.shape[0]):
                word |= np.uint64(part[i] >= threshold) << np.uint64(i)
            rows[y, w] = word


def pack_from(image: Greys, threshold: int) -> Rows:
    """(H, W) uint8 → (H, words): solid where the value is at least `threshold`, 1 … 255."""
    rows = np.empty((image.shape[0], words_for(image.shape[1])), np.uint64)
    _pack_from(np.ascontiguousarray(image), threshold, rows)
    return rows


def solid_rows(image: Greys, threshold: int, grey_floor: int) -> Rows:
    """What of a grey layer is solid: (H, W) uint8 → (H, words).

    Pixels from `threshold` on, and strokes from `grey_floor` on that nowhere touch those (0: none).
    """
    solid = pack_from(image, threshold)
    if not 0 < grey_floor < threshold:
        return solid
    faint = pack_from(image, grey_floor)
    return solid | (faint & ~flood(solid, faint))


def disc_coverage(rx_px: float, ry_px: float) -> NDArray[np.float64]:
    """How much of each pixel the disc around a pixel's centre covers, 0 … 1: (2·Ry + 1, 2·Rx + 1).

    Integrated over SUBSTEPS columns a pixel, exactly in y, so that the rim has no steps of its own.
    """
    reach_x, reach_y = int(np.ceil(rx_px + 0.5)), int(np.ceil(ry_px + 0.5))
    x = np.arange(-reach_x, reach_x + 1)[:, None] + (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS - 0.5
    half = ry_px * np.sqrt(np.maximum(1 - (x / rx_px) ** 2, 0))  # (columns, substeps)
    y = np.arange(-reach_y, reach_y + 1)[:, None, None]
    covered = np.minimum(y + 0.5, half) - np.maximum(y - 0.5, -half)
    share: NDArray[np.float64] = np.clip(covered, 0, 1).mean(axis=2)
    return share


@njit(types.void(TARGET, ROWS, ROWS, ROWS, IMAGE, types.uint8), cache=True, nogil=True)
def _draw(image, paths, added, rim, stencil, threshold):  # type: ignore[no-untyped-def]
    """image = max(image, stencil) around every path pixel, where `added` or (below threshold) `rim` is set."""
    height, width = image.shape
    reach_y, reach_x = stencil.shape[0] // 2, stencil.shape[1] // 2
    for y in range(height):
        for w in range(paths.shape[1]):
            word = paths[y, w]
            bit = 0
            while word != U0:
                if word & U1:
                    x = w * 64 + bit
                    for v in range(max(y - reach_y, 0), min(y + reach_y + 1, height)):
                        for u in range(max(x - reach_x, 0), min(x + reach_x + 1, width)):
                            value = stencil[v - y + reach_y, u - x + reach_x]
                            if value <= image[v, u]:
                                continue
                            shift = np.uint64(u & 63)
                            if (added[v, u >> 6] >> shift) & U1:
                                image[v, u] = value
                            elif (rim[v, u >> 6] >> shift) & U1:
                                image[v, u] = max(image[v, u], min(value, threshold - U8))  # not solid itself
                word >>= U1
                bit += 1


@njit(types.void(TARGET, ROWS, types.uint8, types.boolean), cache=True, nogil=True)
def _set_where(image, rows, value, raise_only):  # type: ignore[no-untyped-def]
    """image = value where a bit is set (only where it is lower, if `raise_only`)."""
    height, width = image.shape
    for y in range(height):
        for w in range(rows.shape[1]):
            word = rows[y, w]
            if word == U0:
                continue
            for bit in range(min(64, width - w * 64)):
                if (word >> np.uint64(bit)) & U1 and not (raise_only and image[y, w * 64 + bit] >= value):
                    image[y, w * 64 + bit] = value


def corrected_greys(
    image: Greys, before: Rows, after: Rows, paths: Rows, radius_px: tuple[float, float], threshold: int
) -> Greys:
    """A grey layer with its correction drawn in: (H, W) uint8 → (H, W) uint8.

    before, after  what was solid (`solid_rows`) and what is, packed
    paths          where F was drawn, packed
    radius_px      (rx, ry) of F
    """
    out = image.copy()
    bright = pack_from(image, threshold)
    _set_where(out, before & ~after, 0, False)
    added = after & ~bright
    if not added.any():
        return out
    width = image.shape[1]
    rim = dilate(added, width, (1.5, 1.5)) & ~after & ~bright
    stencil = np.round(255 * disc_coverage(*radius_px)).astype(np.uint8)
    _draw(out, paths, added, rim, stencil, threshold)
    _set_where(out, added, threshold, True)  # pixels of F whose disc covers a little less than half of them
    return out
