"""Triangles that are there twice: which of them are surface, and which are inner walls.

Programs export every face once each way ("two-sided"), or a few of them again the other way round. Bodies that touch
also have faces twice, once each way: inner walls, which cancel as they should. What tells them apart is their rim:
round an inner wall the remaining triangles are closed, round a doubled piece of surface they are open without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.kernels import njit
from layerfix.mesh.closing import KEYS, TRIANGLES, join, mix, orient, vertex_keys, vertex_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray


@njit
def _face_key(keys, faces, t):  # type: ignore[no-untyped-def]  # numba types it
    """The same for the same three corners in any order."""
    return mix(keys[faces[t, 0]]) + mix(keys[faces[t, 1]]) + mix(keys[faces[t, 2]])


@njit(types.boolean(KEYS, TRIANGLES), cache=True, nogil=True)
def any_doubles(keys, faces):  # type: ignore[no-untyped-def]  # numba types it
    """Whether two triangles that have a size have the same corners, by their vertices' keys. One pass, one table."""
    size = 16
    while size < 2 * faces.shape[0]:
        size *= 2
    table = np.empty(size, np.int32)
    for k in range(size):  # np.full would load half of numba, 0.1 s
        table[k] = -1
    mask = np.uint64(size - 1)
    for t in range(faces.shape[0]):
        a, b, c = keys[faces[t, 0]], keys[faces[t, 1]], keys[faces[t, 2]]
        if a == b or b == c or a == c:  # noqa: SIM109  # a tuple is slower here
            continue
        key = _face_key(keys, faces, t)
        at = key & mask
        while table[at] >= 0:
            if _face_key(keys, faces, table[at]) == key:
                return True
            at = (at + np.uint64(1)) & mask
        table[at] = t
    return False


@njit(
    types.Array(types.int64, 1, "C")(types.Array(types.int64, 2, "C", readonly=True), types.int64),
    cache=True,
    nogil=True,
)
def joined_labels(pairs, count):  # type: ignore[no-untyped-def]  # numba types it
    """(count,) the smallest member of each one's group, where `pairs` (k, 2) are in one group."""
    parent = np.arange(count)
    for p in range(pairs.shape[0]):
        join(parent, pairs[p, 0], pairs[p, 1])
    for f in range(count):
        parent[f] = parent[parent[f]]
    return parent


def without_doubles(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """The faces, with doubled pieces of surface there once and facing outwards; `faces` itself if there are none."""
    keys = vertex_keys(points)
    if not any_doubles(keys, faces):
        return faces
    corners = vertex_numbers(points)[faces]
    sound = (corners != np.roll(corners, -1, axis=1)).all(axis=1)
    groups, copies = _groups(corners)
    doubled = sound & (copies % 2 == 0)
    first = np.zeros(len(faces), np.bool_)
    first[np.unique(groups, return_index=True)[1]] = True
    one_of_each = np.flatnonzero(doubled & first)
    if not len(one_of_each):
        return faces
    both_ways = np.bincount(groups, _ways(corners))[groups[one_of_each]] == 0
    taken, alone = _taken(corners, one_of_each, ~doubled & sound, both_ways)
    if not taken.any():
        return faces
    keep = np.flatnonzero(~np.isin(groups, groups[one_of_each[taken]]) | first)
    result = orient(points, faces[keep])
    places = np.searchsorted(keep, one_of_each)
    free = alone >= 0
    _turn_outwards(points, result, places[free], alone[free])
    return result


def _groups(corners: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(m,) which triangles have the same corners, by number, and how many do."""
    low_to_high = np.sort(corners, axis=1)
    order = np.lexsort(low_to_high.T)
    rows = low_to_high[order]
    new = np.concatenate([[True], (rows[1:] != rows[:-1]).any(axis=1)])
    groups = np.empty(len(corners), np.int64)
    groups[order] = np.cumsum(new) - 1
    return groups, np.bincount(groups)[groups]


def _ways(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m,) 1 for triangles whose corners rise as they are walked, from the lowest on; -1 for the others."""
    first = corners.argmin(axis=1)
    k = np.arange(len(corners))
    return np.where(corners[k, (first + 1) % 3] < corners[k, (first + 2) % 3], 1, -1)


def _taken(
    corners: NDArray[np.int64], doubled: NDArray[np.int64], rest: NDArray[np.bool_], both_ways: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Of each doubled triangle: whether it is surface, and the number of its piece if nothing else touches that.

    Pieces end where triangles of the rest begin. A piece is surface if more edges of its rim are open without it than
    are closed; one without a rim if it is there once each way (else it is two bodies in one place, which is fine).
    """
    count = int(corners.max()) + 1
    others, uses = np.unique(_edges(corners[rest], count), return_counts=True)
    edges = _edges(corners[doubled], count)
    at = np.searchsorted(others, edges)
    found = (at < len(others)) & (others[np.minimum(at, len(others) - 1)] == edges) if len(others) else edges < 0
    around = np.where(found, uses[np.minimum(at, len(uses) - 1)], 0) if len(others) else np.zeros_like(edges)
    owner = np.repeat(np.arange(len(doubled)), 3).reshape(-1, 3)
    inner, owners = edges[around == 0], owner[around == 0]
    order = np.argsort(inner, kind="stable")
    same = inner[order][1:] == inner[order][:-1]
    pairs = np.stack([owners[order][:-1][same], owners[order][1:][same]], axis=1)
    labels = joined_labels(pairs, len(doubled))
    votes = np.where(around == 0, 0, np.where(around % 2 == 1, 1, -1)).sum(axis=1)
    score = np.bincount(labels, votes, len(doubled))[labels]
    touched = np.bincount(labels, (around > 0).sum(axis=1), len(doubled))[labels] > 0
    alone = (
        ~touched
        & (np.bincount(labels, both_ways, len(doubled)) == np.bincount(labels, minlength=len(doubled)))[labels]
    )
    return (score > 0) | alone, np.where(alone, labels, -1)


def _edges(corners: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(m, 3) one number for each edge, whichever way it runs."""
    after = np.roll(corners, -1, axis=1)
    return np.minimum(corners, after) * count + np.maximum(corners, after)


def _turn_outwards(
    points: NDArray[np.float64], faces: NDArray[np.int32], places: NDArray[np.int64], labels: NDArray[np.int64]
) -> None:
    """Turn over, in place, each piece (triangles of one label) whose volume is negative on a right-handed grid.

    `points` are columns and rows, where y points down: what faces outwards has a negative volume there.
    """
    if not len(places):
        return
    a, b, c = (points[faces[places, k]] for k in range(3))
    middle = points.mean(axis=0)
    volume = np.einsum("ij,ij->i", a - middle, np.cross(b - middle, c - middle))
    inwards = np.bincount(labels, volume, int(labels.max()) + 1)[labels] > 0
    faces[places[inwards]] = faces[places[inwards]][:, ::-1]
