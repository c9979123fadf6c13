"""Ways of the nozzle between two beads that never leave the solid of the layer: they need no retraction.

What oozes meanwhile stays inside the part, and nothing is crossed that the nozzle could pull at. Most ways are
straight. Where that would cross a hole or the outside, a way round is sought on a grid of cells one nozzle wide (A*,
with octile distances), and pulled tight. Ways round that are much longer than straight ones are not worth it: there
the filament is drawn back instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.fdm.beads import Path
    from layerfix.stack import LayerStack

    Floats = NDArray[np.float64]
    Way = Floats | None

CELL = 8  # px: the usual raster has eight pixels a nozzle, and what is printable is wider than that
CORE = 2  # px at each side of a cell that need not be solid, so that a wall of 11 px always has free cells
CLEAR_PX = 1.5  # a way round keeps so far from the edge
# A retraction with its lift takes 0.1 to 0.3 s, in which a nozzle travels 15 to 40 mm.
LONGER, MORE_MM, MOST_MORE_MM = 2.0, 10.0, 40.0
POINTS = types.Array(types.float64, 2, "C")
ENDS = types.Array(types.float64, 2, "C", readonly=True)
FOUND = types.Tuple((types.int64[::1], POINTS))


@njit
def _solid(rows, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """Whether the pixel at (x, y), from the frame's corner, is solid."""
    i, j = math.floor(x), math.floor(y)
    if i < 0 or j < 0 or j >= rows.shape[0] or i >> 6 >= rows.shape[1]:
        return False
    return (rows[j, i >> 6] >> np.uint64(i & 63)) & U1 != U0


@njit
def _straight(rows, x0, y0, x1, y1, clear):  # type: ignore[no-untyped-def]  # numba types it
    """Whether the way from one point to the other is solid, looked at every pixel and `clear` px beside it."""
    dx, dy = x1 - x0, y1 - y0
    length = math.hypot(dx, dy)
    steps = int(length) + 1
    nx, ny = (-dy / length * clear, dx / length * clear) if length > 0 else (0.0, 0.0)
    sides = 1 if clear > 0 else 0
    for k in range(steps + 1):
        t = k / steps
        for side in range(-sides, sides + 1):
            if not _solid(rows, x0 + t * dx + side * nx, y0 + t * dy + side * ny):
                return False
    return True


@njit
def _free_cells(rows):  # type: ignore[no-untyped-def]  # numba types it
    """Cells whose core is solid."""
    height, width = rows.shape[0] // CELL, rows.shape[1] * 64 // CELL
    free = np.zeros((height, width), np.bool_)
    core = np.uint64((1 << (CELL - 2 * CORE)) - 1)
    for j in range(height):
        for i in range(width):
            x = i * CELL + CORE
            whole = True
            for y in range(j * CELL + CORE, (j + 1) * CELL - CORE):
                if (rows[y, x >> 6] >> np.uint64(x & 63)) & core != core:  # 64 is a multiple of CELL
                    whole = False
                    break
            free[j, i] = whole
    return free


@njit
def _octile(a, b):  # type: ignore[no-untyped-def]  # numba types it
    return max(a, b) + (math.sqrt(2.0) - 1) * min(a, b)


@njit
def _push(heap, keys, n, key, value):  # type: ignore[no-untyped-def]  # numba types it
    k = n
    while k > 0 and keys[(k - 1) >> 1] > key:
        heap[k], keys[k] = heap[(k - 1) >> 1], keys[(k - 1) >> 1]
        k = (k - 1) >> 1
    heap[k], keys[k] = value, key
    return n + 1


@njit
def _pop(heap, keys, n):  # type: ignore[no-untyped-def]  # numba types it
    """(value, how many are left); the smallest key is at 0."""
    value = heap[0]
    n -= 1
    last, key, k = heap[n], keys[n], 0
    while True:
        child = 2 * k + 1
        if child >= n:
            break
        if child + 1 < n and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        heap[k], keys[k] = heap[child], keys[child]
        k = child
    heap[k], keys[k] = last, key
    return value, n


@njit
def _entrance(rows, free, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """The free cell nearest to a point that can be reached straight from it; -1 if there is none near."""
    i0, j0 = int(x) // CELL, int(y) // CELL
    best, nearest = -1, np.inf
    for j in range(max(j0 - 2, 0), min(j0 + 3, free.shape[0])):
        for i in range(max(i0 - 2, 0), min(i0 + 3, free.shape[1])):
            cx, cy = (i + 0.5) * CELL, (j + 0.5) * CELL
            away = math.hypot(cx - x, cy - y)
            if free[j, i] and away < nearest and _straight(rows, x, y, cx, cy, 0.0):
                best, nearest = j * free.shape[1] + i, away
    return best


@njit
def _round(rows, free, x0, y0, x1, y1, longest, cost, came, seen, turn, heap, keys, out):  # type: ignore[no-untyped-def]  # numba types it
    """Points of a way of at most `longest` px into `out`, ends not among them; how many, -1 if there is none.

    cost, came, seen: scratch of the cells; seen holds the `turn` in which a cell was last reached.
    """
    width = free.shape[1]
    begin, goal = _entrance(rows, free, x0, y0), _entrance(rows, free, x1, y1)
    if begin < 0 or goal < 0:
        return -1
    gi, gj = goal % width, goal // width
    most = longest / CELL
    seen[begin], cost[begin], came[begin] = turn, 0.0, -1
    n = _push(heap, keys, 0, _octile(abs(begin % width - gi), abs(begin // width - gj)), begin)
    found = False
    while n:
        at, n = _pop(heap, keys, n)
        if at == goal:
            found = True
            break
        i0, j0 = at % width, at // width
        for dj in range(-1, 2):
            for di in range(-1, 2):
                i, j = i0 + di, j0 + dj
                if (di == 0 and dj == 0) or not (0 <= i < width and 0 <= j < free.shape[0]) or not free[j, i]:
                    continue
                way = cost[at] + (math.sqrt(2.0) if di and dj else 1.0)
                ahead = way + _octile(abs(i - gi), abs(j - gj))
                to = j * width + i
                if ahead > most or (seen[to] == turn and cost[to] <= way + 1e-9) or n == heap.shape[0]:
                    continue
                cx, cy = (i0 + 0.5) * CELL, (j0 + 0.5) * CELL
                if not _straight(rows, cx, cy, cx + di * CELL, cy + dj * CELL, 0.0):
                    continue
                seen[to], cost[to], came[to] = turn, way, at
                n = _push(heap, keys, n, ahead, to)
    if not found:
        return -1
    count, at = 0, goal
    while at >= 0:
        count += 1
        at = came[at]
    chain = np.empty((count + 2, 2))
    chain[0, 0], chain[0, 1], chain[count + 1, 0], chain[count + 1, 1] = x0, y0, x1, y1
    at = goal
    for k in range(count, 0, -1):
        chain[k, 0], chain[k, 1] = (at % width + 0.5) * CELL, (at // width + 0.5) * CELL
        at = came[at]
    made, here = 0, 0
    length = 0.0
    while here < count + 1:  # pulled tight: on to the farthest point that can be reached straight
        there = here
        while there < count + 1 and _straight(
            rows, chain[here, 0], chain[here, 1], chain[there + 1, 0], chain[there + 1, 1],
            CLEAR_PX if there > here else 0.0,
        ):  # fmt: skip
            there += 1
        if there == here:  # a slot between two free cells
            return -1
        length += math.hypot(chain[there, 0] - chain[here, 0], chain[there, 1] - chain[here, 1])
        if there < count + 1:
            if made == out.shape[0]:
                return -1
            out[made] = chain[there]
            made += 1
        here = there
    return made if length <= longest else -1


@njit(FOUND(ROWS, ENDS, types.boolean[::1], types.float64[::1]), cache=True, nogil=True)
def find_ways(rows, ends, may, longest):  # type: ignore[no-untyped-def]  # numba types it
    """(counts (n,), points (m, 2)): how many points each way has between its ends, -1 where it must leave the solid.

    rows     packed layer
    ends     (n, 4) x, y of start and end in px from the frame's corner
    may      (n,) whether a way is to be sought at all
    longest  (n,) px that a way round may be long
    """
    n = ends.shape[0]
    counts, points, m = np.full(n, -1, np.int64), np.empty((64, 2)), 0
    free = np.zeros((0, 0), np.bool_)
    cost, keys = np.empty(0), np.empty(0)
    came, heap, seen = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int64)
    found = np.empty((48, 2))
    for k in range(n):
        if not may[k]:
            continue
        x0, y0, x1, y1 = ends[k, 0], ends[k, 1], ends[k, 2], ends[k, 3]
        if _straight(rows, x0, y0, x1, y1, 0.0):
            counts[k] = 0
            continue
        if free.shape[0] == 0:
            free = _free_cells(rows)
            cells = free.shape[0] * free.shape[1]
            if cells == 0:
                continue
            cost, came, seen = np.empty(cells), np.empty(cells, np.int64), np.full(cells, -1, np.int64)
            heap, keys = np.empty(2 * cells + 8, np.int64), np.empty(2 * cells + 8)
        made = _round(rows, free, x0, y0, x1, y1, longest[k], cost, came, seen, k, heap, keys, found)
        if made < 0:
            continue
        counts[k] = made
        while m + made > points.shape[0]:
            more = np.empty((2 * points.shape[0], 2))
            more[:m] = points[:m]
            points = more
        points[m : m + made] = found[:made]
        m += made
    return counts, points[:m].copy()


def ways_inside(paths: Sequence[Path], part: Sequence[int], rows: Rows, stack: LayerStack) -> tuple[Way, ...]:
    """For each path after the first: (m, 2) points in mm between the end of the path before and its start, so that
    the way stays in the solid of the layer (none if the straight way does), or None if it has to leave it.

    part  a number of the separate part of the layer that each path belongs to
    rows  the layer, packed
    """
    if len(paths) < 2:
        return ()
    scale = np.array([1 / stack.pixel_mm[0], -1 / stack.pixel_mm[1]])
    ends = np.array([[*a.points_mm[-1], *b.points_mm[0]] for a, b in pairwise(paths)])
    ends = (ends.reshape(-1, 2) - np.array(stack.origin_mm)) * scale
    ends = np.ascontiguousarray(ends.reshape(-1, 4))
    straight = np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1])
    more, most = MORE_MM / stack.pixel_mm[0], MOST_MORE_MM / stack.pixel_mm[0]
    numbers = np.asarray(part)
    counts, points = find_ways(
        rows, ends, numbers[1:] == numbers[:-1], np.minimum(LONGER * straight + more, straight + most)
    )
    points = points / scale + np.array(stack.origin_mm)
    stops = np.cumsum(np.maximum(counts, 0)).tolist()
    return tuple(
        None if count < 0 else points[stop - count : stop] for count, stop in zip(counts.tolist(), stops, strict=True)
    )
