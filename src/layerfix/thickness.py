"""How wide the solid is where a skeletal path runs through it."""

from __future__ import annotations

import numpy as np
from numba import njit, types

from layerfix.bits import U0, U1, WORK, lowest_bit, popcount


@njit(inline="always")
def _solid(columns, y, x):  # type: ignore[no-untyped-def]
    """Pixel (y, x) of `layerfix.columns`, x counted from the first bit; anything outside is void."""
    if y < 0 or x < 0 or y >= columns.shape[1] or x >= columns.shape[0] * 64:
        return False
    return (columns[x >> 6, y] >> np.uint64(x & 63)) & U1 != U0


@njit(inline="always")
def _void_left(columns, y, x, limit):  # type: ignore[no-untyped-def]
    """Steps from x to the nearest void pixel at or left of it, at most `limit`."""
    w, shift = x >> 6, 63 - (x & 63)
    void = (~columns[w, y]) << np.uint64(shift)
    steps = 0
    while void == U0:
        steps += 64 - shift
        w -= 1
        if w < 0 or steps > limit:
            return min(steps, limit)
        void = ~columns[w, y]
        shift = 0
    # The highest set bit: isolate it by smearing downwards.
    for s in (1, 2, 4, 8, 16, 32):
        void |= void >> np.uint64(s)
    return min(steps + 64 - popcount(void), limit)


@njit(inline="always")
def _void_right(columns, y, x, limit):  # type: ignore[no-untyped-def]
    """Steps from x to the nearest void pixel at or right of it, at most `limit`."""
    w, shift = x >> 6, x & 63
    void = (~columns[w, y]) >> np.uint64(shift)
    steps = 0
    while void == U0:
        steps += 64 - shift
        w += 1
        if w >= columns.shape[0] or steps > limit:
            return min(steps, limit)
        void = ~columns[w, y]
        shift = 0
    return min(steps + lowest_bit(void), limit)


@njit(inline="always")
def _width_mm(columns, y, x, best, px_mm, py_mm):  # type: ignore[no-untyped-def]
    """Width of the solid across pixel (y, x), or `best` if it is not below it."""
    near = (best + max(px_mm, py_mm)) / 2  # the width is at least 2·near − 1 px
    dx_mm, dy_mm = 0.0, 0.0
    found = False
    dy = 0
    while dy * py_mm < near:
        for sign in (-1, 1):
            if dy == 0 and sign == 1:
                continue
            line_y = y + sign * dy
            limit = int(near / px_mm) + 1
            left, right = 0, 0
            if 0 <= line_y < columns.shape[1]:
                left = _void_left(columns, line_y, x, limit)
                right = _void_right(columns, line_y, x, limit)
            step = -left if left <= right else right
            distance = np.hypot(step * px_mm, dy * py_mm)
            if distance < near:
                near, dx_mm, dy_mm, found = distance, step * px_mm, sign * dy * py_mm, True
        dy += 1
    if not found:
        return best
    ux, uy = -dx_mm / near, -dy_mm / near
    stride = 0.5 * min(px_mm, py_mm)
    across = 0.0
    while across < best and _solid(columns, y + round(uy * across / py_mm), x + round(ux * across / px_mm)):
        across += stride
    if across >= best:
        return best
    # Snap to the centre of that void pixel, as the near side was measured to a centre.
    far = np.hypot(round(uy * across / py_mm) * py_mm, round(ux * across / px_mm) * px_mm)
    return min(best, max(near + far - np.hypot(ux * px_mm, uy * py_mm), min(px_mm, py_mm)))


@njit(types.float64(WORK, WORK, WORK, types.float64, types.float64, types.float64), cache=True, nogil=True)
def narrowest(columns, skeleton, anchor, limit_mm, px_mm, py_mm):  # type: ignore[no-untyped-def]
    """Width in mm of S at the narrowest pixel of the skeletal paths M̂ \\ M; `limit_mm` if none is below.

    The width at a pixel is the distance to the nearest void pixel plus that to the void straight across,
    less one pixel. A pixel whose nearest void is too far to beat the best so far costs a few words.
    """
    best = limit_mm
    for w in range(1, columns.shape[0] - 1):
        for y in range(1, columns.shape[1] - 1):
            path = skeleton[w, y] & ~anchor[w, y]
            while path != U0:
                x = w * 64 + lowest_bit(path)
                path &= path - U1
                best = min(best, _width_mm(columns, y, x, best, px_mm, py_mm))
    return best
