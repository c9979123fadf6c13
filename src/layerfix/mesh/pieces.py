"""Small pieces of a cross-section: compact closed contours no larger than a tool, and the middle pixel of each.

Two pieces less than a pixel apart hang together in the raster, and a small one may then pass for a bump of its
neighbour, which the method need not keep. Contours tell them apart.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.bits import WORK
from layerfix.kernels import njit
from layerfix.layers.neighbours import bit_at
from layerfix.mesh.fill import SEGMENTS

COMPACT = 0.45  # share of its box that a piece fills: a triangle half
CRUMB_PX = 2.0
LARGEST_PX = 64  # of a small piece, along x and along y
PLACES = types.Array(types.int64, 2, "C")
NONE = -1


@njit
def _slot(x, y, mask):  # type: ignore[no-untyped-def]  # numba types it
    """Where a point is looked for first in a table of mask + 1 places. Points of neighbouring segments are equal."""
    value = np.int64(x * 1048576.0) * np.int64(0x2545F491) ^ np.int64(y * 1048576.0) * np.int64(0x5851F42D)
    value ^= value >> np.int64(23)
    value *= np.int64(0x2127599B)
    value ^= value >> np.int64(19)
    return value & mask


@njit(PLACES(SEGMENTS, WORK), cache=True, nogil=True)
def small_pieces(segments, rows):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 2) row and column of the centroid of each closed contour that has the solid inside, is small and compact.

    segments  (n, 4) x, y of start and end, solid on the left (of x right, y up; rows run down)
    rows      packed: what they fill. A centroid is solid (that of a ring or a bow is not), but for crumbs, which may
              hold no pixel
    """
    n = segments.shape[0]
    size = 4
    while size < 2 * n:
        size *= 2
    table = np.full(size, NONE, np.int64)
    for s in range(n):
        at = _slot(segments[s, 0], segments[s, 1], np.int64(size - 1))
        while table[at] != NONE:
            at = (at + 1) & (size - 1)
        table[at] = s
    used = np.zeros(n, np.bool_)
    out, found = np.empty((16, 2), np.int64), 0
    for first in range(n):
        if used[first]:
            continue
        x0 = x1 = segments[first, 0]
        y0 = y1 = segments[first, 1]
        double_area, mx, my, s, closed = 0.0, 0.0, 0.0, int(first), False
        while s != NONE and not used[s]:
            used[s] = True
            ax, ay, bx, by = segments[s]
            x0, x1, y0, y1 = min(x0, bx), max(x1, bx), min(y0, by), max(y1, by)
            px, py = ax - segments[first, 0], ay - segments[first, 1]
            qx, qy = bx - segments[first, 0], by - segments[first, 1]
            part = px * qy - qx * py
            double_area += part
            mx += part * (px + qx)
            my += part * (py + qy)
            if bx == segments[first, 0] and by == segments[first, 1]:
                closed = True
                break
            at = _slot(bx, by, np.int64(size - 1))
            s = NONE
            while table[at] != NONE:
                other = table[at]
                if not used[other] and segments[other, 0] == bx and segments[other, 1] == by:
                    s = int(other)
                    break
                at = (at + 1) & (size - 1)
        # Solid is on the left with y up: clockwise in columns and rows.
        wide, high = x1 - x0, y1 - y0
        if not closed or double_area >= 0 or max(wide, high) > LARGEST_PX or -double_area < 2 * COMPACT * wide * high:
            continue
        y = np.int64(math.floor(segments[first, 1] + my / (3 * double_area) + 0.5))
        x = np.int64(math.floor(segments[first, 0] + mx / (3 * double_area) + 0.5))
        if not bit_at(rows, y, x) and max(wide, high) > CRUMB_PX:
            continue
        if found == out.shape[0]:
            longer = np.empty((2 * found, 2), np.int64)
            longer[:found] = out
            out = longer
        out[found, 0], out[found, 1] = y, x
        found += 1
    return out[:found].copy()
