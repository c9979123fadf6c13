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
from layerfix.layers.grey_image import AT, FIRSTS, pack_part
from layerfix.mesh.fill import EVEN_ODD, NONZERO, SEGMENTS

ROWS_OUT = types.Array(types.uint64, 2, "C")
IMAGE = types.Array(types.uint8, 2, "C")


@njit
def _add(line, touched, x0, x1, height):  # type: ignore[no-untyped-def]  # numba types it
    """Add part of a segment within one row: from x0 to x1, `height` of the row high (signed). line[x] is what pixel x
    differs by from the one to its left; touched[w] tells whether any of 64 may differ."""
    width = float(line.shape[0] - 2)
    left, right = min(x0, x1), max(x0, x1)
    if right <= 0 or left >= width:
        at = 0 if right <= 0 else line.shape[0] - 2
        line[at] += height
        touched[at >> 6] = True
        return
    slope = height / (right - left) if right > left else 0.0
    if left < 0:  # left of the frame, all of its rows' share lies right of it
        touched[0] = True
        line[0] -= slope * left
        height += slope * left
        left = 0.0
    if right > width:
        height -= slope * (right - width)
        right = width
    first = int(left)
    for w in range(first >> 6, (math.ceil(right) >> 6) + 1):
        touched[w] = True
    if right <= first + 1:  # within one pixel
        touched[(first + 1) >> 6] = True
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


@njit
def _by_rows(segments, height):  # type: ignore[no-untyped-def]  # numba types it
    """(starts, numbers): which segments have a part in each row of pixels."""
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
    return starts, chosen


@njit
def _add_row(segments, chosen, j, line, touched):  # type: ignore[no-untyped-def]  # numba types it
    """Add the parts in row j of the chosen segments."""
    for p in range(chosen.shape[0]):
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
            _add(line, touched, x0 + (top - y0) * slope, x0 + (bottom - y0) * slope, sign * (bottom - top))


@njit
def _grey(total, rule):  # type: ignore[no-untyped-def]  # numba types it
    """255 times what a mean winding number means."""
    value = total if rule != NONZERO else abs(total)
    if rule == EVEN_ODD:
        value = abs(value) % 2.0
        value = 2.0 - value if value > 1 else value
    return np.uint8(min(max(value, 0.0), 1.0) * 255 + 0.5)


@njit(IMAGE(SEGMENTS, types.int64, types.int64, types.int64), cache=True, nogil=True)
def coverage(segments, width, height, rule):  # type: ignore[no-untyped-def]  # numba types it
    """(H, W) uint8: 255 times the share of each pixel that is inside by the winding rule.

    segments  as `fill` takes them
    """
    out = np.zeros((height, width), np.uint8)
    starts, chosen = _by_rows(segments, height)
    line, touched = np.zeros(width + 2, np.float64), np.zeros((width >> 6) + 2, np.bool_)
    for j in range(height):
        if starts[j] == starts[j + 1]:
            continue
        _add_row(segments, chosen[starts[j] : starts[j + 1]], j, line, touched)
        total = 0.0
        for i in range(width):
            total += line[i]
            line[i] = 0.0
            out[j, i] = _grey(total, rule)
        line[width] = 0.0
        line[width + 1] = 0.0
    return out


@njit
def _longer(at, values):  # type: ignore[no-untyped-def]  # numba types it
    """The same lists with as much room again."""
    n = at.shape[0]
    more_at, more_values = np.empty(2 * n, np.int32), np.empty((2 * n, 64), np.uint8)
    for k in range(n):
        more_at[k] = at[k]
        for i in range(64):
            more_values[k, i] = values[k, i]
    return more_at, more_values


@njit(
    types.Tuple((ROWS_OUT, FIRSTS, AT, IMAGE))(SEGMENTS, types.int64, types.int64, types.int64),
    cache=True,
    nogil=True,
)
def coverage_in_words(segments, width, height, rule):  # type: ignore[no-untyped-def]  # numba types it
    """The same as the parts of a `GreyImage`: only words that a segment crosses are looked at, pixel by pixel."""
    words = (width + 63) // 64
    bright, firsts = np.zeros((height, words), np.uint64), np.zeros(height + 1, np.int64)
    starts, chosen = _by_rows(segments, height)
    line, touched = np.zeros(width + 2, np.float64), np.zeros((width >> 6) + 2, np.bool_)
    at, values, found = np.empty(256, np.int32), np.empty((256, 64), np.uint8), 0
    part = np.zeros(64, np.uint8)
    for j in range(height):
        firsts[j] = found
        if starts[j] == starts[j + 1]:
            continue
        _add_row(segments, chosen[starts[j] : starts[j + 1]], j, line, touched)
        total = 0.0
        for w in range(words):
            size = min(64, width - 64 * w)
            if touched[w]:
                touched[w] = False
                for i in range(size):
                    total += line[64 * w + i]
                    line[64 * w + i] = 0.0
                    part[i] = _grey(total, rule)
            else:
                value = _grey(total, rule)
                if value == 0:
                    continue
                for i in range(size):
                    part[i] = value
            bright[j, w], greys = pack_part(part[:size], np.uint8(255))
            if greys:
                if found == at.shape[0]:
                    at, values = _longer(at, values)
                at[found] = w
                for i in range(64):
                    values[found, i] = part[i] if i < size else np.uint8(0)
                found += 1
        line[width] = 0.0
        line[width + 1] = 0.0
        for w in range(words, touched.shape[0]):
            touched[w] = False
    firsts[height] = found
    return bright, firsts, at[:found].copy(), values[:found].copy()
