"""Strips and fans of triangles, as PLY and glTF store them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def strips_to_triangles(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) vertices of strips, -1 between them → (m, 3): each vertex makes a triangle with the two before it.

    Every second triangle of a strip is turned over, so that all face the same way; those with a vertex twice, which
    join strips, are left out.
    """
    if len(corners) < 3:
        return np.empty((0, 3), np.int64)
    place = np.arange(len(corners))
    started = np.maximum.accumulate(np.where(corners < 0, place + 1, 0))  # where each corner's strip began
    a, b, c = corners[:-2], corners[1:-1], corners[2:]
    odd = ((place - started)[:-2] & 1).astype(np.bool_)
    triangles = np.stack([np.where(odd, b, a), np.where(odd, a, b), c], axis=1)
    whole = (triangles >= 0).all(axis=1) & (a != b) & (b != c) & (a != c)
    chosen: NDArray[np.int64] = triangles[whole]
    return chosen


def fan_to_triangles(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) vertices of a fan → (n - 2, 3)."""
    if len(corners) < 3:
        return np.empty((0, 3), np.int64)
    return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)
