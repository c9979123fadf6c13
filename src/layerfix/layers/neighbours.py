"""Single pixels of packed rows, and what is around them. Columns (`layerfix.layers.columns`) are given as `.T`."""

from __future__ import annotations

import numpy as np

from layerfix.bits import U1
from layerfix.kernels import njit


@njit
def bit_at(rows, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Pixel (y, x) of packed rows, 0 outside them."""
    if y < 0 or x < 0 or y >= rows.shape[0] or (x >> 6) >= rows.shape[1]:
        return np.int64(0)
    return np.int64((rows[y, x >> 6] >> np.uint64(x & 63)) & U1)


@njit
def around(rows, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """The eight neighbours, bit 0 east, then clockwise."""
    return (
        bit_at(rows, y, x + 1)
        | bit_at(rows, y + 1, x + 1) << 1
        | bit_at(rows, y + 1, x) << 2
        | bit_at(rows, y + 1, x - 1) << 3
        | bit_at(rows, y, x - 1) << 4
        | bit_at(rows, y - 1, x - 1) << 5
        | bit_at(rows, y - 1, x) << 6
        | bit_at(rows, y - 1, x + 1) << 7
    )


@njit
def is_simple(neighbours):  # type: ignore[no-untyped-def]  # numba types it
    """Whether a pixel with these neighbours may come or go without joining or parting anything: exactly one of the
    4-neighbours is void with a solid one after it, going round by way of the corners (the crossing number)."""
    crossings = 0
    for k in range(0, 8, 2):
        void = (neighbours >> k) & 1 == 0
        crossings += void and ((neighbours >> (k + 1)) & 1 != 0 or (neighbours >> ((k + 2) & 7)) & 1 != 0)
    return crossings == 1
