"""How wide the solid is where a skeletal path runs through it."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ALL, U0, U1, WORK, lowest_bit
from layerfix.kernels import njit

SIGHT_PX = 31  # how far a look at one word sees to either side


@njit
def _solid(columns, y, x):  # type: ignore[no-untyped-def]
    """Pixel (y, x) of `layerfix.layers.columns`, x counted from the first bit; anything outside is void."""
    if y < 0 or x < 0 or y >= columns.shape[1] or x >= columns.shape[0] * 64:
        return False
    return (columns[x >> 6, y] >> np.uint64(x & 63)) & U1 != U0


@njit
def _void_around(columns, y, x):  # type: ignore[no-untyped-def]
    """The void pixels x - 32 … x + 31 of row y as bits 0 … 63; all of them outside the array."""
    if y < 0 or y >= columns.shape[1]:
        return ALL
    first = x - 32
    w, shift = first >> 6, np.uint64(first & 63)
    low = columns[w, y] if 0 <= w < columns.shape[0] else U0
    if shift == U0:
        return ~low
    high = columns[w + 1, y] if 0 <= w + 1 < columns.shape[0] else U0
    return ~((low >> shift) | (high << (np.uint64(64) - shift)))


@njit
def _nearest_step(void, within):  # type: ignore[no-untyped-def]
    """Signed steps from bit 32 to the nearest set bit at most `within` away; `within` + 1 if there is none."""
    for step in range(within + 1):
        if (void >> np.uint64(32 - step)) & U1:
            return -step
        if (void >> np.uint64(32 + step)) & U1:
            return step
    return within + 1


@njit
def _nearest_far(columns, y, x, within):  # type: ignore[no-untyped-def]
    """The same over several words, for features wider than a look sees."""
    for step in range(within + 1):
        if not _solid(columns, y, x - step):
            return -step
        if not _solid(columns, y, x + step):
            return step
    return within + 1


@njit
def _width_mm(columns, y, x, best, px_mm, py_mm):  # type: ignore[no-untyped-def]
    """Width of the solid across pixel (y, x), or `best` if it is not below it."""
    near = (best + max(px_mm, py_mm)) / 2  # the width is at least 2 · near − 1 px
    dx_mm, dy_mm = 0.0, 0.0
    found = False
    dy = 0
    while dy * py_mm < near:
        within = int(np.sqrt(near**2 - (dy * py_mm) ** 2) / px_mm)
        for sign in (-1, 1):
            if within > SIGHT_PX:
                step = _nearest_far(columns, y + sign * dy, x, within)
            else:
                sight = (ALL >> np.uint64(63 - 2 * within)) << np.uint64(32 - within)
                void = _void_around(columns, y + sign * dy, x) & sight
                if void == U0:
                    continue
                step = _nearest_step(void, within)
            distance = np.hypot(step * px_mm, dy * py_mm)
            if distance < near:
                near, dx_mm, dy_mm, found = distance, step * px_mm, sign * dy * py_mm, True
        dy += 1
    if not found:
        return best
    ux, uy = -dx_mm / near, -dy_mm / near
    stride = 0.5 * min(px_mm, py_mm)
    across = stride
    while across < best and _solid(columns, y + round(uy * across / py_mm), x + round(ux * across / px_mm)):
        across += stride
    if across >= best:
        return best
    # Snap to the centre of that void pixel, as the near side was measured to a centre.
    far = np.hypot(round(uy * across / py_mm) * py_mm, round(ux * across / px_mm) * px_mm)
    return min(best, max(near + far - np.hypot(ux * px_mm, uy * py_mm), min(px_mm, py_mm)))


@njit(types.float64(WORK, WORK, types.float64, types.float64, types.float64), cache=True, nogil=True)
def narrowest(columns, paths, limit_mm, px_mm, py_mm):  # type: ignore[no-untyped-def]
    """Width in mm of S at the narrowest pixel of the skeletal paths; `limit_mm` if none is below.

    The width at a pixel is the distance to the nearest void pixel plus that to the void straight across,
    less one pixel. A pixel whose nearest void is too far to beat the best so far costs a few words, and
    nothing is narrower than a pixel.
    """
    best = limit_mm
    for w in range(1, columns.shape[0] - 1):
        for y in range(1, columns.shape[1] - 1):
            path = paths[w, y]
            while path != U0:
                x = w * 64 + lowest_bit(path)
                path &= path - U1
                best = min(best, _width_mm(columns, y, x, best, px_mm, py_mm))
                if best <= min(px_mm, py_mm):
                    return best
    return best
