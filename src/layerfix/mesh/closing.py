"""Meshes that do not close or do not agree which side is out: find out, orient, close what is left."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

POINTS = types.Array(types.float64, 2, "C", readonly=True)
TRIANGLES = types.Array(types.int32, 2, "C", readonly=True)
IDS = types.Array(types.int64, 1, "C", readonly=True)
KEYS = types.Array(types.uint64, 1, "C")
EDGES = types.Array(types.int64, 2, "C", readonly=True)

KEYS_PER_PX = 1024  # ends of segments closer than this are one point


@njit
def mix(x):  # type: ignore[no-untyped-def]  # numba types it
    """A 64-bit finaliser (splitmix64): every input bit changes about half of the output."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@njit(KEYS(POINTS), cache=True, nogil=True)
def vertex_keys(points):  # type: ignore[no-untyped-def]  # numba types it
    """(n,) a hash of each vertex's place in steps of 1/1024, the same for vertices in the same place."""
    keys = np.empty(points.shape[0], np.uint64)
    for v in range(points.shape[0]):
        h = np.uint64(0x9E3779B97F4A7C15)
        for k in range(3):
            h = mix(h ^ np.uint64(np.int64(np.rint(points[v, k] * 1024.0)))) + np.uint64(k)
        keys[v] = h
    return keys


@njit(types.boolean(KEYS, TRIANGLES), cache=True, nogil=True)
def keys_balance(keys, faces):  # type: ignore[no-untyped-def]  # numba types it
    """`edges_balance` of vertices known by their keys."""
    total = np.uint64(0)
    for t in range(faces.shape[0]):
        for e in range(3):
            a, b = keys[faces[t, e]], keys[faces[t, 0 if e == 2 else e + 1]]
            total += mix(a + (b << np.uint64(1))) - mix(b + (a << np.uint64(1)))
    return total == np.uint64(0)


def edges_balance(points: NDArray[np.float64], faces: NDArray[np.int32]) -> bool:
    """True if every directed edge is matched by its reverse, that is, if the mesh is closed and oriented.

    Sums a hash of each directed edge minus the hash of its reverse, so that only unmatched edges remain;
    an open mesh passes with probability 2⁻⁶⁴. One pass, no sorting, no merging of vertices.
    """
    return bool(keys_balance(vertex_keys(points), faces))


@njit
def join(parent, a, b):  # type: ignore[no-untyped-def]  # numba types it
    """Put the groups of a and b together (union–find): the root of a group is its smallest member."""
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    while parent[b] != b:
        parent[b] = parent[parent[b]]
        b = parent[b]
    parent[max(a, b)] = min(a, b)


@njit
def _root(parent, parity, f):  # type: ignore[no-untyped-def]  # numba types it
    """(root of f, whether f is turned against it); halves the path on the way."""
    turned = False
    while parent[f] != f:
        up = parent[f]
        if parent[up] != up:
            parity[f] ^= parity[up]
            parent[f] = parent[up]
        turned ^= parity[f]
        f = parent[f]
    return f, turned


@njit(types.Array(types.boolean, 1, "C")(EDGES, types.int64), cache=True, nogil=True)
def _faces_to_flip(pairs, faces):  # type: ignore[no-untyped-def]  # numba types it
    """Union–find by size, with parity, over (face, face, same direction) rows; True for each patch's minority."""
    parent = np.arange(faces)
    parity = np.zeros(faces, np.bool_)
    size = np.ones(faces, np.int64)
    for p in range(pairs.shape[0]):
        a, a_turned = _root(parent, parity, pairs[p, 0])
        b, b_turned = _root(parent, parity, pairs[p, 1])
        if a == b:
            continue
        if size[a] > size[b]:
            a, b = b, a
        parent[a] = b
        parity[a] = a_turned ^ b_turned ^ (pairs[p, 2] == 1)
        size[b] += size[a]
    flip = np.zeros(faces, np.bool_)
    count = np.zeros(faces, np.int64)
    for f in range(faces):
        root, flip[f] = _root(parent, parity, f)
        count[root] += -1 if flip[f] else 1
    for f in range(faces):
        if count[_root(parent, parity, f)[0]] < 0:
            flip[f] = not flip[f]
    return flip


def vertex_numbers(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) numbers from 0, the same for vertices in the same place (in steps of 1/1024)."""
    numbers: NDArray[np.int64] = np.unique(vertex_keys(points), return_inverse=True)[1].reshape(-1)
    return numbers


def undirected_edges(corners: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(m, 3) numbers of vertices → (3 m,) of each triangle's edges: a number for both ways; whether it runs upwards.

    Edges from a vertex to itself are -1.
    """
    a, b = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    edges = np.minimum(a, b) * (int(a.max()) + 1) + np.maximum(a, b)
    edges[a == b] = -1
    return edges, a < b


def orient(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Make neighbouring triangles agree which side is out, flipping the fewer of each connected patch.

    Neighbours share an edge that exactly two triangles use. A patch that is inside out as a whole stays so:
    it may be a cavity.
    """
    edges, forward = undirected_edges(vertex_numbers(points)[faces])
    order = np.argsort(edges, kind="stable")
    edges, forward, face = edges[order], forward[order], order // 3
    first = np.flatnonzero(np.concatenate([[True], edges[1:] != edges[:-1]]))
    uses = np.diff(np.append(first, len(edges)))
    twice = first[(uses == 2) & (edges[first] >= 0)]
    pairs = np.stack([face[twice], face[twice + 1], forward[twice] == forward[twice + 1]], axis=1)
    flip = _faces_to_flip(np.ascontiguousarray(pairs, np.int64), len(faces))
    return np.where(flip[:, None], faces[:, ::-1], faces)


@njit(types.Array(types.int64, 1, "C")(POINTS, POINTS), cache=True, nogil=True)
def match_nearest(ends, starts):  # type: ignore[no-untyped-def]  # numba types it
    """Greedy matching, nearest pair first: entry e is the start joined to end e. Same number of both."""
    n = ends.shape[0]
    partner = np.full(n, -1, np.int64)
    taken = np.zeros(n, np.bool_)
    nearest = np.zeros(n, np.int64)
    distance = np.full(n, -1.0)
    for _ in range(n):
        best = -1
        for e in range(n):
            if partner[e] >= 0:
                continue
            if distance[e] < 0 or taken[nearest[e]]:
                distance[e] = np.inf
                for s in range(n):
                    if not taken[s]:
                        d = (ends[e, 0] - starts[s, 0]) ** 2 + (ends[e, 1] - starts[s, 1]) ** 2
                        if d < distance[e]:
                            distance[e], nearest[e] = d, s
            if best < 0 or distance[e] < distance[best]:
                best = e
        partner[best] = nearest[best]
        taken[nearest[best]] = True
    return partner


def close_gaps(
    segments: NDArray[np.float64], pitch: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Join the loose ends of one layer's directed segments, nearest first: (segments, gap lengths in mm).

    In closed, oriented contours as many segments arrive at each point as leave it. Missing, flipped or
    cracked triangles show up as surplus ends and surplus starts, always as many of both.
    """
    snapped = np.round(segments * KEYS_PER_PX) / KEYS_PER_PX
    points = np.concatenate([snapped[:, :2], snapped[:, 2:]])
    keys = np.round(points * KEYS_PER_PX).astype(np.int64)
    _, first, ids = np.unique((keys[:, 0] << 32) + keys[:, 1], return_index=True, return_inverse=True)
    balance = np.bincount(ids[len(segments) :], minlength=len(first)) - np.bincount(
        ids[: len(segments)], minlength=len(first)
    )
    if not balance.any():
        return snapped, np.empty(0)
    at = points[first]
    ends = np.repeat(at, np.maximum(balance, 0), axis=0)
    starts = np.repeat(at, np.maximum(-balance, 0), axis=0)
    scale = np.array(pitch)
    joined = starts[match_nearest(ends * scale, starts * scale)]
    lengths = np.hypot(*((joined - ends) * scale).T)
    return np.concatenate([snapped, np.concatenate([ends, joined], axis=1)]), lengths
