"""Ends set right: where F ends a pixel or more before S does, or after it, its path grows or goes by some pixels.

Retreat stops where F just holds balls, whose centres and radii are right to half a pixel each, and F's own pixels are
none of a disc; strips came out up to 3.6 px too short, 2 % of them off by more than 2. Here F's pixels are compared
with S's, along the path's own direction: strips come out within 2 px, tips of what is longer than F within 1.5.

An end that lies further off than LIMIT_PX is meant so: a sharp tip is rounded. Pixels come and go one at a time, at
ends only, so what hangs together, and what does not, stays so.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.bits import U0, U1, U63, WORK, lowest_bit
from layerfix.kernels import njit
from layerfix.layers.metric.retreat import COUNT, DX, DY, _bit, _by_rows, _clear, _neighbourhood
from layerfix.layers.morphology import HALF_WIDTHS

LEAST_PX, LIMIT_PX = 0.75, 4.0  # off by less is good enough, off by more is meant
LONGEST_PX, SHORTEST_PX = 16, 2.0  # of the path that tells the direction
SHARE, NARROW_PX = 0.67, 1.5  # of the strip's half width: how far from the path S's end is looked for, and at least
SLIGHTLY_PX, WIDER = 1.5, 0.15  # further, for what leads there; and for each pixel ahead: directions may be off


@njit
def _solid(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    return 0 <= y < columns.shape[1] and 0 <= x < 64 * columns.shape[0] and _bit(columns, y, x)


@njit
def _end_pixels(columns, anchor, spots):  # type: ignore[no-untyped-def]  # numba types it
    """Fill spots (n, 2: y, x) with the pixels that have one neighbour and are not anchored, as many as fit.

    Returns how many there are.
    """
    words, height = columns.shape
    line, found = np.empty(height - 2, np.uint64), 0
    for w in range(1, words - 1):
        west, here, east, fixed = columns[w - 1], columns[w], columns[w + 1], anchor[w][1:]
        for i in range(height - 2):
            one, more = U0, U0
            for j in range(3):
                c = here[i + j]
                left, right = (c << U1) | (west[i + j] >> U63), (c >> U1) | (east[i + j] << U63)
                more |= (one & left) | ((one | left) & right)
                one |= left | right
                if j != 1:
                    more |= one & c
                    one |= c
            line[i] = here[i + 1] & one & ~more & ~fixed[i]
        for i in range(height - 2):
            word = line[i]
            while word != U0:
                if found < spots.shape[0]:
                    spots[found, 0], spots[found, 1] = i + 1, 64 * w + lowest_bit(word)
                found += 1
                word &= word - U1
    return found


@njit
def _walk_back(columns, anchor, y, x, path):  # type: ignore[no-untyped-def]  # numba types it
    """Write the path from an end on, as far as it is one, to path (n, 2: y, x). Returns how many pixels it has."""
    path[0, 0], path[0, 1] = y, x
    n = 1
    while n < path.shape[0] and not _bit(anchor, path[n - 1, 0], path[n - 1, 1]):
        code = _neighbourhood(columns, path[n - 1, 0], path[n - 1, 1])
        ways = 0
        for i in range(8):
            v, u = path[n - 1, 0] + DY[i], path[n - 1, 1] + DX[i]
            if (code >> i) & 1 and not (n > 1 and v == path[n - 2, 0] and u == path[n - 2, 1]):
                ways += 1
                path[n, 0], path[n, 1] = v, u
        if ways != 1:
            break
        n += 1
    return n


@njit
def _reach(half_widths, bx, by, ux, uy):  # type: ignore[no-untyped-def]  # numba types it
    """How far F's pixels reach along a direction from its own."""
    reach = 0.0
    for dy in range(half_widths.shape[0]):
        reach = max(reach, abs(uy) * dy + abs(ux) * half_widths[dy])
    return reach + max(bx * ux, 0.0) + max(by * uy, 0.0)


@njit
def _half_width(solid, y, x, ux, uy, most):  # type: ignore[no-untyped-def]  # numba types it
    """Pixels of S in a row from (y, x) along a direction."""
    n = 0
    while n < most and _solid(solid, math.floor(y + (n + 1) * uy + 0.5), math.floor(x + (n + 1) * ux + 0.5)):
        n += 1
    return n


@njit
def _solid_at(solid, y, x, steep, k, j):  # type: ignore[no-untyped-def]  # numba types it
    return _solid(solid, y + k, x + j) if steep else _solid(solid, y + j, x + k)


@njit
def _end_of_solid(solid, y, x, ux, uy, wide, long):  # type: ignore[no-untyped-def]  # numba types it
    """How far S reaches from (y, x) along a direction, as far as it hangs together ahead and beside the path.

    Row by row if the direction is steep, else column by column: in each from the first to the last solid pixel that
    touches those of the one before, in a window round the path's line that grows wider. wide, long: at most
    """
    steep = abs(uy) > abs(ux)
    main, side = (abs(uy), ux) if steep else (abs(ux), uy)
    step = (1 if uy > 0 else -1) if steep else (1 if ux > 0 else -1)
    right = max(NARROW_PX, SHARE * _half_width(solid, y, x, -uy, ux, wide))
    left = max(NARROW_PX, SHARE * _half_width(solid, y, x, uy, -ux, wide))
    below, above = (right, left) if (uy > 0 if steep else ux < 0) else (left, right)  # towards smaller j, larger j
    first, last, k, far = 0, 0, 0, 0.0
    while k <= long * main:
        line, wider = k * side / main, WIDER * k / main
        low = math.ceil(line - (below + wider + SLIGHTLY_PX) / main)
        high = math.floor(line + (above + wider + SLIGHTLY_PX) / main)
        begin, end = max(first - (k > 0), low), min(last + (k > 0), high)
        while begin <= end and not _solid_at(solid, y, x, steep, k * step, begin):
            begin += 1
        if begin > end:
            break
        while not _solid_at(solid, y, x, steep, k * step, end):
            end -= 1
        first, last = begin, end
        while first > low and _solid_at(solid, y, x, steep, k * step, first - 1):
            first -= 1
        while last < high and _solid_at(solid, y, x, steep, k * step, last + 1):
            last += 1
        least = max(first, math.ceil(line - (below + wider) / main))
        most = min(last, math.floor(line + (above + wider) / main))
        if least <= most:
            far = max(far, k * main + (most if side > 0 else least) * side)
        k += 1
    return far


@njit
def _grow(columns, solid, y, x, ux, uy, gap):  # type: ignore[no-untyped-def]  # numba types it
    """Let a path grow from its end at (y, x), as long as that brings it nearer to the gap's length."""
    done, k = 0.0, 0
    while True:
        k += 1
        if abs(ux) >= abs(uy):
            v, u = math.floor(y + k * uy / abs(ux) + 0.5), x + (k if ux > 0 else -k)
        else:
            v, u = y + (k if uy > 0 else -k), math.floor(x + k * ux / abs(uy) + 0.5)
        along = (u - x) * ux + (v - y) * uy
        if abs(gap - along) >= abs(gap - done) or not _solid(solid, v, u) or _bit(columns, v, u):
            return
        if COUNT[_neighbourhood(columns, v, u)] != 1:  # it would join something, or close a loop
            return
        columns[u >> 6, v] |= U1 << np.uint64(u & 63)
        done = along


@njit
def _shorten(columns, path, ux, uy, gap):  # type: ignore[no-untyped-def]  # numba types it
    """Take away the end of a path, as long as that brings it nearer to the gap's length, which is below 0."""
    done = 0.0
    for k in range(1, path.shape[0] - 1):
        y, x = path[k]
        along = (x - path[0, 1]) * ux + (y - path[0, 0]) * uy
        if abs(gap - along) >= abs(gap - done):
            return
        _clear(columns, path[k - 1, 0], path[k - 1, 1])
        done = along


@njit(types.void(WORK, WORK, WORK, HALF_WIDTHS, types.int64, types.int64), cache=True, nogil=True)
def set_ends(columns, solid, anchor, half_widths, bx, by):  # type: ignore[no-untyped-def]  # numba types it
    """Set the ends of the paths in `columns` right, in place, row by row.

    columns, solid, anchor  (words, height) with an empty border: M̂ after its retreat, S, and what stays
    half_widths, bx, by     F: `layerfix.layers.feature.Feature`
    """
    spots = np.empty((1024, 2), np.int64)
    count = _end_pixels(columns, anchor, spots)
    if count > spots.shape[0]:
        spots = np.empty((count, 2), np.int64)
        _end_pixels(columns, anchor, spots)
    if count == 0:
        return
    spots = _by_rows(spots, count, columns.shape[1])
    most = max(half_widths.shape[0] - 1 + by, half_widths[0] + bx) + 1
    path = np.empty((min(max(most, 3), LONGEST_PX) + 1, 2), np.int64)
    wide, long = most + 1, most + LIMIT_PX + 1
    for y, x in spots:
        n = _walk_back(columns, anchor, y, x, path)
        length = math.sqrt((x - path[n - 1, 1]) ** 2 + (y - path[n - 1, 0]) ** 2)
        if length < SHORTEST_PX:
            continue
        ux, uy = (x - path[n - 1, 1]) / length, (y - path[n - 1, 0]) / length
        gap = _end_of_solid(solid, y, x, ux, uy, wide, long) - _reach(half_widths, bx, by, ux, uy)
        if LEAST_PX < gap <= LIMIT_PX:
            _grow(columns, solid, y, x, ux, uy, gap)
        elif -LIMIT_PX <= gap < -LEAST_PX:
            _shorten(columns, path[:n], ux, uy, gap)
