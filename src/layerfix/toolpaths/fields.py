"""Kernels on distance fields: level sets as loops, balls, one-pixel lines as chains, simplification.

A field is (H, W) float32, its border pixels negative. Points are (x, y) in px, pixel (row j, column i) has its
centre at (i, j), and y points down. The kernels check nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types

FIELD = types.Array(types.float32, 2, "C", readonly=True)
MUTABLE_FIELD = types.Array(types.float32, 2, "C")
MASK = types.Array(types.uint8, 2, "C")
POINTS = types.Array(types.float64, 2, "C")
STARTS = types.Array(types.int64, 1, "C")
INDICES = types.Array(types.int64, 1, "A")
VALUES = types.Array(types.float32, 1, "C")


@njit
def _link(after, starts, count, first, second):  # type: ignore[no-untyped-def]
    """Note that the level set goes from one pixel edge to another; returns the list of edges, grown."""
    if count == starts.shape[0]:
        more = np.empty(2 * count, np.int64)
        more[:count] = starts
        starts = more
    after[first] = second
    starts[count] = first
    return starts, count + 1


@njit
def _crossings(field, after):  # type: ignore[no-untyped-def]
    """Marching squares: for each pixel edge the level set enters a cell by, the edge it leaves by.

    Edge 2 (y W + x) lies between pixel (y, x) and the one to its right, the next number below it. What is above 0
    lies to the left of the way. Saddles join what is above 0 if their middle is.
    """
    height, width = field.shape
    starts, count = np.empty(4096, np.int64), 0
    for y in range(height - 1):
        nw, sw = field[y, 0] > 0, field[y + 1, 0] > 0
        for x in range(width - 1):
            ne, se = field[y, x + 1] > 0, field[y + 1, x + 1] > 0
            case = nw | (ne << 1) | (se << 2) | (sw << 3)
            nw, sw = ne, se
            if case == 0 or case == 15:
                continue
            top = 2 * (y * width + x)
            left, bottom, right = top + 1, top + 2 * width, top + 3
            if case == 5 or case == 10:
                middle = field[y, x] + field[y, x + 1] + field[y + 1, x] + field[y + 1, x + 1] > 0
                if case == 5 and middle:
                    starts, count = _link(after, starts, count, left, bottom)
                    starts, count = _link(after, starts, count, right, top)
                elif case == 5:
                    starts, count = _link(after, starts, count, left, top)
                    starts, count = _link(after, starts, count, right, bottom)
                elif middle:
                    starts, count = _link(after, starts, count, top, left)
                    starts, count = _link(after, starts, count, bottom, right)
                else:
                    starts, count = _link(after, starts, count, top, right)
                    starts, count = _link(after, starts, count, bottom, left)
                continue
            if case == 1 or case == 3 or case == 7:
                first = left
            elif case == 2 or case == 6 or case == 14:
                first = top
            elif case == 4 or case == 12 or case == 13:
                first = right
            else:
                first = bottom
            if case == 1 or case == 9 or case == 13:
                second = top
            elif case == 2 or case == 3 or case == 11:
                second = right
            elif case == 4 or case == 6 or case == 7:
                second = bottom
            else:
                second = left
            starts, count = _link(after, starts, count, first, second)
    return starts[:count]


@njit(types.Tuple((POINTS, STARTS))(FIELD, FIELD), cache=True, nogil=True)
def level_loops(field, values):  # type: ignore[no-untyped-def]
    """Where `field` is 0, as closed loops round what is above 0: (n, 3) x, y and `values` there, and the starts
    of the loops in it. Seen with y down, what is above 0 lies to the left of the way."""
    height, width = field.shape
    after = np.full(2 * height * width, np.int32(-1), np.int32)
    edges = _crossings(field, after)
    points, starts = np.empty((edges.shape[0], 3)), np.zeros(edges.shape[0] + 1, np.int64)
    n, loops = 0, 0
    for first in edges:
        edge = np.int64(first)
        if after[edge] < 0:
            continue
        while after[edge] >= 0:
            pixel = edge >> 1
            y, x = pixel // width, pixel % width
            y2, x2 = (y + 1, x) if edge & 1 else (y, x + 1)
            a, b = field[y, x], field[y2, x2]
            t = a / (a - b)
            points[n, 0] = x + t * (x2 - x)
            points[n, 1] = y + t * (y2 - y)
            points[n, 2] = values[y, x] + t * (values[y2, x2] - values[y, x])
            n += 1
            following = np.int64(after[edge])
            after[edge] = np.int32(-1)
            edge = following
        loops += 1
        starts[loops] = n
    return points[:n], starts[: loops + 1].copy()


@njit(types.void(MUTABLE_FIELD, INDICES, INDICES, VALUES, VALUES), cache=True, nogil=True)
def paint_balls(field, rows, columns, radii_px, values):  # type: ignore[no-untyped-def]
    """field = max(field, value) in the disc of each radius (plus a pixel) round each pixel."""
    height, width = field.shape
    for k in range(rows.shape[0]):
        radius = radii_px[k] + 1
        reach = int(radius)
        for y in range(max(rows[k] - reach, 0), min(rows[k] + reach + 1, height)):
            half = int(np.sqrt(max(radius * radius - (y - rows[k]) ** 2, 0.0)))
            for x in range(max(columns[k] - half, 0), min(columns[k] + half + 1, width)):
                if field[y, x] < values[k]:
                    field[y, x] = values[k]


@njit
def _degree(mask, y, x):  # type: ignore[no-untyped-def]
    count = -1 if mask[y, x] else 0
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            count += mask[y + dy, x + dx] != 0
    return count


@njit
def _follow(mask, y, x, y2, x2, points, n):  # type: ignore[no-untyped-def]
    """Walk from (y, x) to (y2, x2) and on to the next pixel without exactly two neighbours, marking what lies
    between with 2; returns how many points there are then."""
    points[n, 0], points[n, 1] = x, y
    n += 1
    while True:
        points[n, 0], points[n, 1] = x2, y2
        n += 1
        if _degree(mask, y2, x2) != 2 or mask[y2, x2] == 2:
            return n
        mask[y2, x2] = 2
        found = False
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                ny, nx = y2 + dy, x2 + dx
                if not found and (dy != 0 or dx != 0) and mask[ny, nx] and not (ny == y and nx == x):
                    next_y, next_x, found = ny, nx, True
        if not found:
            return n
        y, x, y2, x2 = y2, x2, next_y, next_x


@njit(types.Tuple((POINTS, STARTS))(MASK), cache=True, nogil=True)
def trace_lines(mask):  # type: ignore[no-untyped-def]
    """One-pixel lines as chains of pixels between ends and junctions: (n, 2) x, y and the starts of the chains.

    A lone pixel is a chain of one; a ring ends where it begins. mask: (H, W) uint8, 1 on the lines, 0 on the
    border; it is written to.
    """
    height, width = mask.shape
    solid = 0
    for y in range(height):
        for x in range(width):
            solid += mask[y, x]
    points, starts = np.empty((9 * solid + 2, 2)), np.zeros(4 * solid + 2, np.int64)
    n, chains = 0, 0
    for rings in range(2):  # first from ends and junctions; what is left then are rings
        for y in range(1, height - 1):
            for x in range(1, width - 1):
                if mask[y, x] != 1:
                    continue
                degree = _degree(mask, y, x)
                if degree == 0 and not rings:
                    points[n, 0], points[n, 1] = x, y
                    n += 1
                    chains += 1
                    starts[chains] = n
                if (degree == 2) != (rings == 1) or degree == 0:
                    continue
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        if (dy == 0 and dx == 0) or not mask[y + dy, x + dx]:
                            continue
                        if rings == 1:
                            if mask[y, x] != 1:
                                continue
                            mask[y, x] = 2
                            n = _follow(mask, y, x, y + dy, x + dx, points, n)
                        else:
                            other = _degree(mask, y + dy, x + dx)
                            later = dy > 0 or (dy == 0 and dx > 0)
                            if other == 2 and mask[y + dy, x + dx] == 2:
                                continue  # walked from its other end
                            if other != 2 and (not later or (other > 2 and degree > 2)):
                                continue  # junction pixels side by side are one junction
                            n = _follow(mask, y, x, y + dy, x + dx, points, n)
                        chains += 1
                        starts[chains] = n
    return points[:n].copy(), starts[: chains + 1].copy()


@njit(types.boolean[::1](POINTS, types.float64), cache=True, nogil=True)
def needed_points(points, tolerance):  # type: ignore[no-untyped-def]
    """Which points of an open (n, 3) polyline x, y, width Douglas and Peucker keep: no point that is left out is
    farther than `tolerance` from the piece that replaces it, in place or in width."""
    n = points.shape[0]
    keep = np.zeros(n, np.bool_)
    keep[0] = keep[n - 1] = True
    todo = np.empty((n, 2), np.int64)
    todo[0, 0], todo[0, 1] = 0, n - 1
    left = 1
    while left:
        left -= 1
        a, b = todo[left, 0], todo[left, 1]
        ux, uy, uw = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        length2 = ux * ux + uy * uy
        farthest, which = tolerance * tolerance, -1
        for k in range(a + 1, b):
            vx, vy, vw = points[k, 0] - points[a, 0], points[k, 1] - points[a, 1], points[k, 2] - points[a, 2]
            t = min(max((vx * ux + vy * uy) / length2, 0.0), 1.0) if length2 > 0 else 0.0
            away = max((vx - t * ux) ** 2 + (vy - t * uy) ** 2, (vw - t * uw) ** 2)
            if away > farthest:
                farthest, which = away, k
        if which >= 0:
            keep[which] = True
            todo[left, 0], todo[left, 1] = a, which
            todo[left + 1, 0], todo[left + 1, 1] = which, b
            left += 2
    return keep
