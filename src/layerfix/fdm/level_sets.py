"""Level sets of distance fields as closed loops: marching squares on packed bits.

Points are (x, y) in px, pixel (row j, column i) has its centre at (i, j), and y points down. The border pixels of a
field are low.
"""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, U63, lowest_bit, popcount
from layerfix.fdm.fields import FIELD, NO_LEVEL, POINTS, STARTS
from layerfix.kernels import njit

# Marching squares. A cell's corners are bits: 1 north-west, 2 north-east, 4 south-east, 8 south-west. By which side
# the level set comes in and by which it goes out, with what is higher on its left; sides: 0 north, 1 west, 2 south,
# 3 east. Cases 5 and 10 are saddles, here with the high corners apart; joined they are the other two pairs.
COMES_IN = np.array([-1, 1, 0, 1, 3, 1, 0, 1, 2, 2, 0, 2, 3, 3, 0, -1])
GOES_OUT = np.array([-1, 0, 3, 3, 2, 0, 2, 2, 1, 0, 3, 3, 1, 0, 1, -1])


@njit
def _mixed_cells(high, y, w):  # type: ignore[no-untyped-def]  # numba types it
    """Of the 64 cells that begin at word w of row y, those whose four corners are not all high or all low."""
    upper, lower = high[y, w], high[y + 1, w]
    right_upper, right_lower = upper >> U1, lower >> U1
    if w + 1 < high.shape[1]:
        right_upper |= high[y, w + 1] << U63
        right_lower |= high[y + 1, w + 1] << U63
        return (upper ^ lower) | (upper ^ right_upper) | (lower ^ right_lower)
    return ((upper ^ lower) | (upper ^ right_upper) | (lower ^ right_lower)) & ~(U1 << U63)


@njit
def _high(high, y, x):  # type: ignore[no-untyped-def]  # numba types it
    return np.int64((high[y, x >> 6] >> np.uint64(x & 63)) & U1)


@njit
def _saddle_joins(field, level, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Whether the middle of a cell is high."""
    above = field[y, x] + field[y, x + 1] + field[y + 1, x] + field[y + 1, x + 1]
    return above > level[y, x] + level[y, x + 1] + level[y + 1, x] + level[y + 1, x + 1]


@njit
def _segments(field, level, high):  # type: ignore[no-untyped-def]  # numba types it
    """The level set as segments across cells: ((n, 3) y, x of the cell and the side it comes in by, (n,) the segment
    that goes on where each ends).

    Two segments meet on the side between two cells; whoever comes second finds the first in `beside` or `above`.
    """
    width = 64 * high.shape[1]
    count = 0
    for y in range(high.shape[0] - 1):
        for w in range(high.shape[1]):
            cells = _mixed_cells(high, y, w)
            if cells != U0:
                count += popcount(cells)
    segments, following = np.empty((2 * count, 3), np.int32), np.empty(2 * count, np.int64)
    # On a side between two cells, the segment k that ends there, or -1 - k for one that begins there.
    above, beside = np.empty(width, np.int64), 0
    comes, goes = np.empty(2, np.int64), np.empty(2, np.int64)
    n = 0
    for y in range(high.shape[0] - 1):
        for w in range(high.shape[1]):
            cells = _mixed_cells(high, y, w)
            while cells != U0:
                x = w * 64 + lowest_bit(cells)
                cells &= cells - U1
                case = _high(high, y, x) | (_high(high, y, x + 1) << 1)
                case |= (_high(high, y + 1, x + 1) << 2) | (_high(high, y + 1, x) << 3)
                pieces = 1
                if case == 5 or case == 10:  # saddles: west and east, or north and south come in
                    pieces = 2
                    comes[0], comes[1] = (1, 3) if case == 5 else (0, 2)
                    turned = _saddle_joins(field, level, y, x) != (case == 10)
                    goes[0], goes[1] = (2, 0) if turned else (0, 2)
                    if case == 10:
                        goes[0], goes[1] = (3, 1) if turned else (1, 3)
                else:
                    comes[0], goes[0] = COMES_IN[case], GOES_OUT[case]
                for piece in range(pieces):
                    k, first, last = n + piece, comes[piece], goes[piece]
                    segments[k, 0], segments[k, 1], segments[k, 2] = y, x, first
                    if first < 2:
                        following[above[x] if first == 0 else beside] = k
                    if last < 2:
                        following[k] = -1 - (above[x] if last == 0 else beside)
                for piece in range(pieces):
                    k = n + piece
                    for side, mark in ((comes[piece], -1 - k), (goes[piece], k)):
                        if side == 2:
                            above[x] = mark
                        elif side == 3:
                            beside = mark
                n += pieces
    return segments[:n], following[:n]


@njit(types.Tuple((POINTS, STARTS))(FIELD, FIELD, ROWS), cache=True, nogil=True)
def level_loops(field, level, high):  # type: ignore[no-untyped-def]  # numba types it
    """Where a field is as high as `level`, itself a field, as closed loops round what is higher: (n, 3) x, y and the
    level there, and the starts of the loops in it. Seen with y down, what is higher lies to the left of the way.

    high: `bits_higher` of the two.
    """
    segments, following = _segments(field, level, high)
    count = segments.shape[0]
    points, starts = np.empty((count, 3)), np.zeros(count + 1, np.int64)
    n, loops = 0, 0
    for begin in range(count):
        k = begin
        if following[k] < 0:
            continue
        while following[k] >= 0:
            y, x, side = segments[k, 0], segments[k, 1], segments[k, 2]
            y0, x0 = (y + 1, x) if side == 2 else (y, x + 1) if side == 3 else (y, x)
            y1, x1 = (y + 1, x) if side == 1 else (y, x + 1) if side == 0 else (y + 1, x + 1)
            a, b = field[y0, x0] - level[y0, x0], field[y1, x1] - level[y1, x1]
            t = a / (a - b)
            points[n, 0] = x0 + t * (x1 - x0)
            points[n, 1] = y0 + t * (y1 - y0)
            one, other = level[y0, x0], level[y1, x1]  # a level that no field reaches is no width of a bead
            points[n, 2] = min(one, other) if max(one, other) > NO_LEVEL / 2 else one + t * (other - one)
            n += 1
            onwards = following[k]
            following[k] = -1
            k = onwards
        loops += 1
        starts[loops] = n
    return points[:n], starts[: loops + 1].copy()
