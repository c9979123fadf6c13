"""How far each pixel is from the edge of its layer, exactly, as far as anybody asks."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, popcount
from layerfix.fdm.fields import LEAST_MM, MUTABLE_FIELD
from layerfix.kernels import njit

FAR = np.float32(1e9)


@njit
def _down_columns(rows, reach):  # type: ignore[no-untyped-def]  # numba types it
    """(H, W) float32: rows to the nearest void pixel of the same column, at most `reach`; 0 where it is void."""
    height, words = rows.shape
    away = np.zeros((height, 64 * words), np.float32)
    for y in range(height):
        for w in range(words):
            word = rows[y, w]
            if word == U0:
                continue
            line, before = away[y, 64 * w : 64 * w + 64], away[max(y - 1, 0), 64 * w : 64 * w + 64]
            for x in range(64):
                bit = np.float32((word >> np.uint64(x)) & U1)
                line[x] = min(before[x] + np.float32(1), reach) * bit
    for y in range(height - 2, -1, -1):
        for w in range(words):
            if rows[y, w] == U0:
                continue
            line, after = away[y, 64 * w : 64 * w + 64], away[y + 1, 64 * w : 64 * w + 64]
            for x in range(64):
                line[x] = min(line[x], after[x] + np.float32(1))
    return away


@njit(
    MUTABLE_FIELD(ROWS, types.float32, types.float32, types.float32),
    cache=True,
    nogil=True,
    fastmath={"nnan", "ninf"},
)
def edge_distance(rows, reach_px, pixel_mm, inset_mm):  # type: ignore[no-untyped-def]  # numba types it
    """(H, W) float32 mm from the edge of a packed layer, less `inset_mm`: negative outside, and right up to
    `reach_px`; what is deeper is as deep as that.

    The border of the layer is void. Solid pixels keep at least LEAST_MM: nothing is too thin to be laid. The squares
    of a column's distances are taken to the sides, as far as something nearer can be (Saito and Toriwaki 1994).
    """
    away = _down_columns(rows, reach_px)
    height, words = rows.shape
    width, reach = 64 * words, int(reach_px)
    squares = np.full(width + 2 * reach, FAR, np.float32)  # of one row, with room on both sides
    least, lowest = np.empty(64, np.float32), np.empty(words, np.float32)
    beside, deep = (reach + 63) // 64, np.float32(reach) * np.float32(reach)
    for y in range(height):
        line = away[y]
        solid = U0
        for w in range(words):
            solid |= rows[y, w]
        if solid == U0:
            line[:] = -np.float32(0.5) * pixel_mm - inset_mm
            continue
        for w in range(words):
            part, low = line[64 * w : 64 * w + 64], FAR
            squared = squares[reach + 64 * w : reach + 64 * w + 64]
            for x in range(64):
                squared[x] = part[x] * part[x]
                low = min(low, squared[x])
            lowest[w] = low
        for w in range(words):
            part = line[64 * w : 64 * w + 64]
            word = rows[y, w]
            if word == U0:
                part[:] = -np.float32(0.5) * pixel_mm - inset_mm
                continue
            low = FAR
            for k in range(max(w - beside, 0), min(w + beside + 1, words)):
                low = min(low, lowest[k])
            if low >= deep:
                part[:] = (np.float32(reach) - np.float32(0.5)) * pixel_mm - inset_mm
                continue
            begin = reach + 64 * w
            farthest = np.float32(0)
            for x in range(64):
                least[x] = squares[begin + x]
                farthest = max(farthest, least[x])
            for step in range(1, reach + 1):
                more = np.float32(step * step)
                if more >= farthest:
                    break
                left, right = squares[begin - step : begin - step + 64], squares[begin + step : begin + step + 64]
                for x in range(64):
                    least[x] = min(least[x], min(left[x], right[x]) + more)
                if step & 3 == 0:
                    farthest = np.float32(0)
                    for x in range(64):
                        farthest = max(farthest, least[x])
            for x in range(64):
                edge = (np.sqrt(least[x]) - np.float32(0.5)) * pixel_mm - inset_mm
                bit = (word >> np.uint64(x)) & U1
                part[x] = max(edge, LEAST_MM) if bit else edge
    return away


@njit(types.float32[:, ::1](ROWS, types.int64), cache=True, nogil=True)
def share_of_cells(rows, size):  # type: ignore[no-untyped-def]  # numba types it
    """(H / size, W / size) float32, rounded up: which share of each cell of size × size pixels is set; size ≤ 64."""
    height, words = rows.shape
    out = np.zeros((-(-height // size), -(-64 * words // size)), np.float32)
    mask = ~U0 >> np.uint64(64 - size)
    for y in range(height):
        line = out[y // size]
        for i in range(out.shape[1]):
            w, shift = (i * size) >> 6, np.uint64((i * size) & 63)
            bits = rows[y, w] >> shift
            if shift + np.uint64(size) > np.uint64(64) and w + 1 < words:
                bits |= rows[y, w + 1] << (np.uint64(64) - shift)
            line[i] += np.float32(popcount(bits & mask))
    out /= np.float32(size * size)
    return out
