"""Binary records of varying length, found one after the other."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.kernels import njit

BYTES = types.Array(types.uint8, 1, "C", readonly=True)
SHAPES = types.Array(types.int64, 2, "C")
PLACES = types.Array(types.int64, 2, "C")


@njit(
    types.Tuple((PLACES, PLACES, types.int64))(BYTES, types.int64, types.int64, SHAPES, types.boolean),
    cache=True,
    nogil=True,
)
def walk(data, at, count, shape, big_endian):  # type: ignore[no-untyped-def]  # numba types it
    """Where `count` records have their values: (starts, lengths) of (count, properties), and where they end.

    shape  (properties, 2): bytes of the number that counts a list (0: one value, not a list), bytes of a value
    The end is -1 if the data ends before the records do, or a list's count is impossible.
    """
    starts = np.empty((count, shape.shape[0]), np.int64)
    lengths = np.ones((count, shape.shape[0]), np.int64)
    size = data.shape[0]
    for r in range(count):
        for p in range(shape.shape[0]):
            width = shape[p, 0]
            if at + width > size:
                return starts, lengths, -1
            if width:
                n = np.int64(0)
                for k in range(width):
                    n += np.int64(data[at + (width - 1 - k if big_endian else k)]) << (8 * k)
                at += width
                if n > size:
                    return starts, lengths, -1
                lengths[r, p] = n
            starts[r, p] = at
            at += lengths[r, p] * shape[p, 1]
            if at > size:
                return starts, lengths, -1
    return starts, lengths, at
