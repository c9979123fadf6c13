"""Marching cubes on packed layers: the boundary of the voxels as a closed 2-manifold, whatever the voxels are.

A vertex is where the boundary crosses an edge of the grid of voxel centres, so there is at most one on each edge, and
its number is the count of crossings before it: a bit plane of crossings and running sums, no index volume.

The table is made here. On a face of a cell whose corners alternate, the solid ones stay apart: that depends on the
face's four corners alone, so both its cells agree. A loop of crossings is cut into triangles without a diagonal that
lies in a face of the cell, which is possible in all 256 cases: no edge has four triangles, not even on noise and
checkerboards.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, U63, lowest_bit, popcount
from layerfix.errors import InputError
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

    Indices = NDArray[np.int32]

MOST = 2**31 - 1  # vertices or triangles that 32-bit indices count
X, Z = 0, 2
MARKS = types.Array(types.uint64, 3, "C")
COUNTS = types.Array(types.int64, 3, "C")
EDGES = types.Array(types.int32, 2, "C")
FACES = types.Array(types.int32, 2, "C")
SHORT = types.Array(types.int8, 2, "C", readonly=True)


def _edges() -> list[tuple[int, int]]:
    """The 12 edges of a cell, along x, y, then z, as pairs of corners; corner n is at (n, n >> 1, n >> 2) & 1."""
    return [(n, n | 1 << axis) for axis in range(3) for n in range(8) if not n >> axis & 1]


def _cell_faces() -> list[list[int]]:
    """The 6 faces, each as its four corners in a round."""
    beside = ((1, 2), (0, 2), (0, 1))
    return [
        [side, side | 1 << u, side | 1 << u | 1 << v, side | 1 << v]
        for axis, (u, v) in enumerate(beside)
        for side in (0, 1 << axis)
    ]


def _loops(solid: list[int]) -> list[list[int]]:
    """The crossed edges of a cell, in loops round its solid corners."""
    number = {edge: i for i, edge in enumerate(_edges())}
    beside: dict[int, list[int]] = {}
    for face in _cell_faces():
        crossed = [number[min(a, b), max(a, b)] if solid[a] != solid[b] else -1
                   for a, b in zip(face, face[1:] + face[:1], strict=True)]  # fmt: skip
        if crossed.count(-1) == 0:  # the corners alternate: one line round each solid corner
            pairs = [(crossed[i - 1], crossed[i]) for i in range(4) if solid[face[i]]]
        else:
            pair = [edge for edge in crossed if edge >= 0]
            pairs = [(pair[0], pair[1])] if pair else []
        for a, b in pairs:
            beside.setdefault(a, []).append(b)
            beside.setdefault(b, []).append(a)
    loops: list[list[int]] = []
    for start in sorted(beside):
        if any(start in loop for loop in loops):
            continue
        loop, at = [start], beside[start][0]
        while at != start:
            loop.append(at)
            one, other = beside[at]
            at = other if one == loop[-2] else one
        loops.append(loop)
    return loops


def _outwards(loop: list[int], solid: list[int]) -> list[int]:
    """The loop, counter-clockwise as seen from outside the solid, in axes that are right-handed."""
    edges = _edges()
    corners = np.array([[n >> d & 1 for d in range(3)] for n in range(8)], float)
    middles = np.array([corners[list(edges[e])].mean(axis=0) for e in loop])
    normal = sum(np.cross(middles[i] - middles[0], middles[i + 1] - middles[0]) for i in range(1, len(loop) - 1))
    ends = [edges[e] if solid[edges[e][0]] else edges[e][::-1] for e in loop]
    out = sum(corners[b] - corners[a] for a, b in ends)
    return loop if np.dot(normal, out) > 0 else loop[::-1]


def _triangulated(loop: list[int]) -> list[tuple[int, int, int]]:
    """The loop as triangles; no diagonal has both its ends on one face of the cell."""
    edges, faces = _edges(), _cell_faces()
    on = [{i for i, face in enumerate(faces) if set(edges[e]) <= set(face)} for e in range(12)]

    def may(i: int, j: int) -> bool:
        return (j - i) % len(loop) in (1, len(loop) - 1) or not on[loop[i]] & on[loop[j]]

    def cut(i: int, j: int) -> list[tuple[int, int, int]] | None:
        if j - i < 2:
            return []
        for k in range(i + 1, j):
            if may(i, k) and may(k, j):
                left, right = cut(i, k), cut(k, j)
                if left is not None and right is not None:
                    return [*left, *right, (loop[i], loop[k], loop[j])]
        return None

    found = cut(0, len(loop) - 1)
    assert found is not None
    return found


@cache
def cell_table() -> NDArray[np.int8]:
    """(256, 16): of each pattern of solid corners (bit n is corner n) the number of triangles, and their edges."""
    table = np.zeros((256, 16), np.int8)
    for pattern in range(256):
        solid = [pattern >> n & 1 for n in range(8)]
        triangles = [t for loop in _loops(solid) for t in _triangulated(_outwards(loop, solid))]
        table[pattern, 0] = len(triangles)
        table[pattern, 1 : 1 + 3 * len(triangles)] = np.ravel(triangles)
    return table


@njit(types.int64(ROWS, ROWS, types.int64, MARKS, COUNTS), cache=True, nogil=True)
def _mark(rows, above, first, marks, counts):  # type: ignore[no-untyped-def]  # numba types it
    """Crossings on edges along x, y, and z up to `above`, of one layer; counts: crossings before each word."""
    height, words = rows.shape
    for axis in range(3):
        for j in range(height):
            for w in range(words):
                here = rows[j, w]
                if axis == 0:
                    there = here >> U1
                    if w + 1 < words:
                        there |= rows[j, w + 1] << U63
                elif axis == 1:
                    there = rows[j + 1, w] if j + 1 < height else U0
                else:
                    there = above[j, w]
                marks[axis, j, w] = here ^ there
                counts[axis, j, w] = first
                if here != there:
                    first += popcount(here ^ there)
    return first


@njit(types.void(MARKS, types.int32, EDGES), cache=True, nogil=True)
def _list_edges(marks, layer, out):  # type: ignore[no-untyped-def]  # numba types it
    """out[n] = (column, row, layer, axis) of the n-th crossing; the frame has a border of one."""
    n = 0
    for axis in range(3):
        for j in range(marks.shape[1]):
            for w in range(marks.shape[2]):
                left = marks[axis, j, w]
                while left != U0:
                    out[n, 0] = 64 * w + lowest_bit(left) - 1
                    out[n, 1] = j - 1
                    out[n, 2] = layer
                    out[n, 3] = axis
                    n += 1
                    left &= left - U1


@njit
def _number(marks, counts, axis, j, c):  # type: ignore[no-untyped-def]  # numba types it
    """Which vertex is on the edge that begins at column c of row j."""
    w, bit = c >> 6, np.uint64(c & 63)
    return counts[axis, j, w] + popcount(marks[axis, j, w] & ((U1 << bit) - U1))


@njit
def _shifted(rows, j, w):  # type: ignore[no-untyped-def]  # numba types it
    """A word of the columns one further east."""
    return (rows[j, w] >> U1) | (rows[j, w + 1] << U63 if w + 1 < rows.shape[1] else U0)


@njit(types.int64(ROWS, ROWS, MARKS, COUNTS, MARKS, COUNTS, SHORT, types.boolean, FACES), cache=True, nogil=True)
def _triangles(a, b, marks_a, counts_a, marks_b, counts_b, table, only_count, out):  # type: ignore[no-untyped-def]  # numba types it
    """Triangles of the cells between two layers; their number. Rows fall in y, which turns their sense round."""
    n = 0
    for j in range(a.shape[0] - 1):
        for w in range(a.shape[1]):
            a0, a1, b0, b1 = a[j, w], a[j + 1, w], b[j, w], b[j + 1, w]
            a0e, a1e, b0e, b1e = _shifted(a, j, w), _shifted(a, j + 1, w), _shifted(b, j, w), _shifted(b, j + 1, w)
            mixed = (a0 | a1 | b0 | b1 | a0e | a1e | b0e | b1e) & ~(a0 & a1 & b0 & b1 & a0e & a1e & b0e & b1e)
            while mixed != U0:
                low = lowest_bit(mixed)
                s = np.uint64(low)
                mixed &= mixed - U1
                pattern = np.int64(
                    ((a0 >> s) & U1) | ((a0e >> s) & U1) << U1 | ((a1 >> s) & U1) << np.uint64(2)
                    | ((a1e >> s) & U1) << np.uint64(3) | ((b0 >> s) & U1) << np.uint64(4)
                    | ((b0e >> s) & U1) << np.uint64(5) | ((b1 >> s) & U1) << np.uint64(6)
                    | ((b1e >> s) & U1) << np.uint64(7)
                )  # fmt: skip
                count = table[pattern, 0]
                if only_count:
                    n += count
                    continue
                column = 64 * w + low
                for corner in range(3 * count):
                    e = np.int64(table[pattern, 1 + corner])
                    axis, which = e >> 2, e & 3
                    # Along x: row, layer; along y: column, layer; along z: column, row.
                    row = j + (which & 1 if axis == X else which >> 1 if axis == Z else 0)
                    col = column + (0 if axis == X else which & 1)
                    if axis != Z and which > 1:
                        v = _number(marks_b, counts_b, axis, row, col)
                    else:
                        v = _number(marks_a, counts_a, axis, row, col)
                    out[n, 2 - corner % 3] = v
                    if corner % 3 == 2:
                        n += 1
    return n


class Patch(NamedTuple):
    """What one step adds: (n, 4) int32 edges, each (column, row, layer, axis) from its lower end, which the next n
    vertices lie on; and (m, 3) int32 faces of vertices so far, counter-clockwise from outside with y to the back."""

    edges: Indices
    faces: Indices


def march(layers: Iterable[Rows], shape: tuple[int, int], width: int) -> Iterator[Patch]:
    """The boundary of a stream of (height, words) packed layers, from the bottom up, a patch a layer and one more.

    Layer −1 is the empty one below the first. Memory: fourteen layers. Raises InputError for more than MOST vertices
    or triangles.
    """
    table = cell_table()
    height = shape[0]
    padded = (height + 2, (width + 2 + 63) // 64)
    rooms = [(np.empty((3, *padded), np.uint64), np.empty((3, *padded), np.int64)) for _ in range(2)]
    none = np.empty((0, 3), np.int32)
    vertices = triangles = 0
    below, below_marks = np.zeros(padded, np.uint64), rooms[0]
    here: Rows = below
    index = -2  # of `below`

    def upwards() -> Iterator[Rows]:
        yield from (_bordered(rows, padded) for rows in layers)
        yield np.zeros(padded, np.uint64)  # above the last
        yield np.zeros(padded, np.uint64)

    for above in upwards():
        marks = rooms[(index + 1) % 2]
        before = vertices
        vertices = _mark(here, above, vertices, *marks)
        edges = np.empty((vertices - before, 4), np.int32)
        _list_edges(marks[0], index + 1, edges)
        faces = none
        if index > -2:
            args = (below, here, *below_marks, *marks, table)
            faces = np.empty((_triangles(*args, True, none), 3), np.int32)
            _triangles(*args, False, faces)
        triangles += len(faces)
        if max(vertices, triangles) > MOST:
            raise InputError(f"a surface of more than {MOST} vertices or triangles; use larger pixels")
        yield Patch(edges, faces)
        below, below_marks, here = here, marks, above
        index += 1


def _bordered(rows: Rows, padded: tuple[int, int]) -> Rows:
    """The layer with a border of one empty pixel."""
    out = np.zeros(padded, np.uint64)
    words = rows.shape[1]
    out[1:-1, :words] = rows << U1
    carried = rows[:, : padded[1] - 1] >> U63
    out[1:-1, 1 : 1 + carried.shape[1]] |= carried
    return out
