"""Corners of a triangle soup to shared vertices, a chunk at a time: an STL repeats each of them six times.

Welded, a closed mesh of m triangles has m / 2 vertices, and takes 24 bytes a triangle instead of 84; everything
after it (grid, hashes, slabs) shrinks with it. Only corners of the very same bits are one, so nothing moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

CORNERS = types.Array(types.uint32, 2, "C", readonly=True)
VERTICES = types.Array(types.uint32, 2, "C")
TABLE = types.Array(types.int32, 1, "C")
FULLEST = 0.6  # of the table: above it, open addressing looks at more than two places on average


@njit
def _hash(x, y, z):  # type: ignore[no-untyped-def]  # numba types it
    h = np.uint64(x) | (np.uint64(y) << np.uint64(32))
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ np.uint64(z) ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


@njit
def _same(vertices, v, x, y, z):  # type: ignore[no-untyped-def]  # numba types it
    return vertices[v, 0] == x and vertices[v, 1] == y and vertices[v, 2] == z


@njit
def _place(h, x, y, z, vertices, table):  # type: ignore[no-untyped-def]  # numba types it
    """Where in the table the vertex with the hash h is, or would go. Linear probing."""
    mask = table.shape[0] - 1
    at = np.int64(h & np.uint64(mask))
    while table[at] >= 0 and not _same(vertices, table[at], x, y, z):
        at = (at + 1) & mask
    return at


@njit(
    types.UniTuple(types.int64, 2)(CORNERS, types.int64, VERTICES, types.int64, TABLE, TABLE, TABLE),
    cache=True,
    nogil=True,
)
def weld(corners, start, vertices, count, table, recent, out):  # type: ignore[no-untyped-def]  # numba types it
    """Give corners[start:] their vertices' numbers in `out`, adding those that are new; (corners done, vertices).

    Stops early where `vertices` or the table is too full for one more. Corners and vertices are the bits of 32-bit
    floats. `recent` remembers a vertex for some of its hash: neighbours in an STL share theirs, and the table of a
    large one is outside the processor's cache.
    """
    room = min(vertices.shape[0], np.int64(table.shape[0] * FULLEST))
    few = np.uint64(recent.shape[0] - 1)
    for c in range(start, corners.shape[0]):
        x, y, z = corners[c, 0], corners[c, 1], corners[c, 2]
        x = np.uint32(0) if x == np.uint32(0x80000000) else x  # -0.0 is 0.0
        y = np.uint32(0) if y == np.uint32(0x80000000) else y
        z = np.uint32(0) if z == np.uint32(0x80000000) else z
        h = _hash(x, y, z)
        slot = np.int64((h >> np.uint64(40)) & few)
        v = recent[slot]
        if v < 0 or not _same(vertices, v, x, y, z):
            at = _place(h, x, y, z, vertices, table)
            if table[at] < 0:
                if count >= room:
                    return c, count
                vertices[count, 0], vertices[count, 1], vertices[count, 2] = x, y, z
                table[at] = count
                count += 1
            v = table[at]
            recent[slot] = v
        out[c] = v
    return corners.shape[0], count


@njit(types.void(VERTICES, types.int64, TABLE), cache=True, nogil=True)
def enter(vertices, count, table):  # type: ignore[no-untyped-def]  # numba types it
    """Fill an empty table with the vertices there are."""
    for v in range(count):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        table[_place(_hash(x, y, z), x, y, z, vertices, table)] = v


class Welder:
    """Collects corners; `expected` triangles set the first sizes, which grow where they must."""

    def __init__(self, expected: int) -> None:
        self._vertices = np.empty((expected // 2 + 1024, 3), np.uint32)
        self._count = 0
        self._table = self._empty_table()
        self._recent = np.full(1 << 15, -1, np.int32)  # 128 KB

    def _empty_table(self) -> NDArray[np.int32]:
        size = 1 << int(np.ceil(np.log2(len(self._vertices) / FULLEST)))
        return np.full(size, -1, np.int32)

    def add(self, corners: NDArray[np.float32]) -> NDArray[np.int32]:
        """(n, 3) corners → (n,) numbers of their vertices."""
        bits = np.ascontiguousarray(corners).view(np.uint32)
        out = np.empty(len(bits), np.int32)
        done = 0
        while done < len(bits):
            done, self._count = weld(bits, done, self._vertices, self._count, self._table, self._recent, out)
            if done < len(bits):
                self._grow()
        return out

    def _grow(self) -> None:
        larger = np.empty((len(self._vertices) * 3 // 2, 3), np.uint32)
        larger[: self._count] = self._vertices[: self._count]
        self._vertices = larger
        if len(self._vertices) > len(self._table) * FULLEST:
            del self._table
            self._table = self._empty_table()
            enter(self._vertices, self._count, self._table)

    def vertices(self) -> NDArray[np.float64]:
        """(n, 3) of all that were added."""
        return self._vertices[: self._count].view(np.float32).astype(np.float64)
