"""Segments of a cut → greys: how much of each pixel the cross-section covers, exactly.

Each segment adds, row by row, the signed area between itself and the right edge of the frame; sums along a row give
the winding number averaged over each pixel. For a cross-section whose winding number is 0 or 1 that is its coverage;
where shells overlap inside one pixel's edge it is an approximation that the winding rule bounds.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.kernels import njit
from layerfix.mesh.fill import EVEN_ODD, NONZERO, SEGMENTS

IMAGE = types.Array(types.uint8, 2, "C")


@njit
def _add(line, x0, x1, height):  # type: ignore[no-untyped-def]  # numba types it
    """Add part of a segment within one row: from x0 to x1, `height` of the row high (signed). line[x] is what pixel x
    differs by from the one to its left."""
    width = float(line.shape[0] - 2)
    left, right = min(x0, x1), max(x0, x1)
    if right <= 0 or left >= width:
        line[0 if right <= 0 else line.shape[0] - 2] += height
        return
    slope = height / (right - left) if right > left else 0.0
    if left < 0:  # left of the frame, all of its rows' share lies right of it
        line[0] -= slope * left
        height += slope * left
        left = 0.0
    if right > width:
        height -= slope * (right - width)
        right = width
    first = int(left)
    if right <= first + 1:  # within one pixel
        part = height * (1 - ((left + right) / 2 - first))
        line[first] += part
        line[first + 1] += height - part
        return
    # What lies right of the segment in each pixel it crosses, against what did in the one before.
    before, covered, x = 0.0, 0.0, left
    i = first
    while x < right:
        stop = min(float(i + 1), right)
        within = slope * (stop - x)
        here = covered + within * (1 - ((x + stop) / 2 - i))
        line[i] += here - before
        before = here
        covered += within
        x = stop
        i += 1
    line[i] += height - before


@njit(IMAGE(SEGMENTS, types.int64, types.int64, types.int64), cache=True, nogil=True)
def coverage(segments, width, height, rule):  # type: ignore[no-untyped-def]  # numba types it
    """(H, W) uint8: 255 times the share of each pixel that is inside by the winding rule.

    segments  as `fill` takes them
    """
    out = np.zeros((height, width), np.uint8)
    starts = np.zeros(height + 1, np.int64)
    for s in range(segments.shape[0]):
        low, high = min(segments[s, 1], segments[s, 3]) + 0.5, max(segments[s, 1], segments[s, 3]) + 0.5
        for j in range(max(math.floor(low), 0), min(math.ceil(high), height)):
            starts[j + 1] += 1
    for j in range(height):
        starts[j + 1] += starts[j]
    chosen = np.empty(starts[height], np.int32)
    where = starts.copy()
    for s in range(segments.shape[0]):
        low, high = min(segments[s, 1], segments[s, 3]) + 0.5, max(segments[s, 1], segments[s, 3]) + 0.5
        for j in range(max(math.floor(low), 0), min(math.ceil(high), height)):
            chosen[where[j]] = s
            where[j] += 1
    line = np.zeros(width + 2, np.float64)
    for j in range(height):
        if starts[j] == starts[j + 1]:
            continue
        for p in range(starts[j], starts[j + 1]):
            s = chosen[p]
            x0, y0, x1, y1 = segments[s, 0] + 0.5, segments[s, 1] + 0.5, segments[s, 2] + 0.5, segments[s, 3] + 0.5
            sign = 1.0
            if y1 < y0:
                x0, y0, x1, y1, sign = x1, y1, x0, y0, -1.0
            if y1 == y0:
                continue
            slope = (x1 - x0) / (y1 - y0)
            top, bottom = max(y0, float(j)), min(y1, float(j + 1))
            if bottom > top:
                _add(line, x0 + (top - y0) * slope, x0 + (bottom - y0) * slope, sign * (bottom - top))
        total = 0.0
        row = out[j]
        for i in range(width):
            total += line[i]
            line[i] = 0.0
            value = total if rule != NONZERO else abs(total)
            if rule == EVEN_ODD:
                value = abs(value) % 2.0
                value = 2.0 - value if value > 1 else value
            row[i] = np.uint8(min(max(value, 0.0), 1.0) * 255 + 0.5)
        line[width] = 0.0
        line[width + 1] = 0.0
    return out
