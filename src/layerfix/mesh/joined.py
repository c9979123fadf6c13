"""Pieces of a cross-section that the raster joins, since they are within two pixels of one another: which, exactly.

A piece is what its contours say, by the winding rule: contours that cross or touch bound one piece, one that lies in
the solid of others bounds none. Each piece is in the raster and in one component of it (`layerfix.mesh.fill`), so of
the pieces of a component all but one were joined to another.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.bits import WORK
from layerfix.kernels import njit
from layerfix.layers.components import edges_of_rows, joined_runs, root_of
from layerfix.layers.neighbours import bit_at
from layerfix.mesh.fill import SEGMENTS, winding_is_inside
from layerfix.mesh.pieces import NONE, contours_of, is_outer, within

TOUCH = 1e-6  # px: what is nearer is the same place
FOUND = types.Array(types.float64, 2, "C")


@njit
def _components(segments, of, measures, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Of each contour a run of the component that it is in; NONE for what is outside the frame.

    The corners of a cell are 8-neighbours, and a piece that enters a cell sets one of them, but for ends of a line
    that were taken back. If all of it was taken back, it touched what is there.
    """
    part, y_first, x_first = within(rows, measures)
    turns, edges = edges_of_rows(part)
    runs, parent, _ = joined_runs(turns, edges, 64 * part.shape[1], False)
    found = np.full(of.max() + 1, NONE, np.int64)
    first_of = np.zeros(part.shape[0] + 1, np.int64)
    for k in range(runs.shape[0]):
        first_of[runs[k, 0] + 1] += 1
    for y in range(part.shape[0]):
        first_of[y + 1] += first_of[y]
    for reach in range(2):
        side = 2 + 2 * reach
        for s in range(segments.shape[0]):
            x0, y0, x1, y1 = segments[s]
            steps = 1 + math.floor(max(abs(x1 - x0), abs(y1 - y0)))
            for k in range(steps * side * side):
                if found[of[s]] != NONE:
                    break
                along, corner = k // (side * side) / steps, k % (side * side)
                x = math.floor(x0 + along * (x1 - x0)) - reach + corner % side - x_first
                y = math.floor(y0 + along * (y1 - y0)) - reach + corner // side - y_first
                if bit_at(part, y, x):
                    run = first_of[y]
                    while runs[run, 2] <= x:
                        run += 1
                    found[of[s]] = root_of(parent, run)
    return found


@njit
def _by_rows(segments, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """(starts, numbers): segments by the rows between first and stop that they reach into."""
    starts = np.zeros(stop - first + 1, np.int64)
    for s in range(segments.shape[0]):
        low, high = min(segments[s, 1], segments[s, 3]), max(segments[s, 1], segments[s, 3])
        for y in range(math.floor(low - TOUCH) - first, math.floor(high + TOUCH) - first + 1):
            starts[y + 1] += 1
    for y in range(stop - first):
        starts[y + 1] += starts[y]
    numbers, where = np.empty(starts[stop - first], np.int64), starts.copy()
    for s in range(segments.shape[0]):
        low, high = min(segments[s, 1], segments[s, 3]), max(segments[s, 1], segments[s, 3])
        for y in range(math.floor(low - TOUCH) - first, math.floor(high + TOUCH) - first + 1):
            numbers[where[y]] = s
            where[y] += 1
    return starts, numbers


@njit
def _side(ax, ay, bx, by, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """On which side of the line from a to b a point is: −1, 1, or 0 if nearer than TOUCH."""
    across = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
    near = TOUCH * (abs(bx - ax) + abs(by - ay))
    return 0 if abs(across) <= near else (1 if across > 0 else -1)


@njit
def _touch(one, other):  # type: ignore[no-untyped-def]  # numba types it
    """Whether two segments share a point."""
    for axis in range(2):
        low, high = min(one[axis], one[axis + 2]), max(one[axis], one[axis + 2])
        if max(other[axis], other[axis + 2]) < low - TOUCH or min(other[axis], other[axis + 2]) > high + TOUCH:
            return False
    a, b, c, d = one
    e, f, g, h = other
    if _side(a, b, c, d, e, f) * _side(a, b, c, d, g, h) > 0:
        return False
    return _side(e, f, g, h, a, b) * _side(e, f, g, h, c, d) <= 0


@njit
def _unite(parent, one, other):  # type: ignore[no-untyped-def]  # numba types it
    a, b = root_of(parent, one), root_of(parent, other)
    parent[max(a, b)] = min(a, b)


@njit
def _unite_touching(segments, of, measures, wanted, starts, numbers, parent):  # type: ignore[no-untyped-def]  # numba types it
    """Unite contours that touch a wanted one with it."""
    near = np.zeros(wanted.shape[0], np.bool_)  # the boxes of most touch none
    for c in range(wanted.shape[0]):
        for other in range(wanted.shape[0] if wanted[c] else 0):
            apart = max(
                measures[c, 0] - measures[other, 2], measures[other, 0] - measures[c, 2],
                measures[c, 1] - measures[other, 3], measures[other, 1] - measures[c, 3],
            )  # fmt: skip
            if other != c and apart <= TOUCH:
                near[c] = near[other] = True
    for y in range(starts.shape[0] - 1):
        for i in range(starts[y], starts[y + 1]):
            s = numbers[i]
            if not (wanted[of[s]] and near[of[s]]):
                continue
            for j in range(starts[y], starts[y + 1]):
                t = numbers[j]
                if not near[of[t]] or of[t] == of[s] or (t > s and wanted[of[t]]):
                    continue
                if root_of(parent, of[s]) != root_of(parent, of[t]) and _touch(segments[s], segments[t]):
                    _unite(parent, of[s], of[t])


@njit
def _passes_left(segment, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """1 or −1 if a segment crosses the line from a point to the left, up or down the page, else 0."""
    ax, ay, bx, by = segment
    if (ay <= y) == (by <= y) or ax + (y - ay) * (bx - ax) / (by - ay) >= x:
        return 0
    return 1 if by > ay else -1


@njit
def _contours_touch(segments, of, one, other):  # type: ignore[no-untyped-def]  # numba types it
    for s in range(segments.shape[0]):
        if of[s] == one:
            for t in range(segments.shape[0]):
                if of[t] == other and _touch(segments[s], segments[t]):
                    return True
    return False


@njit
def _unite_hole(hole, point, segments, of, outer, areas, here, parent):  # type: ignore[no-untyped-def]  # numba types it
    """Unite a hole with what it is a hole of: the smallest outer contour round its point that does not touch it.

    here  segments of the point's row
    """
    turns = np.zeros(outer.shape[0], np.int64)
    for s in here:
        turns[of[s]] += _passes_left(segments[s], point[0], point[1])
    while True:
        best = NONE
        for c in range(outer.shape[0]):
            if outer[c] and turns[c] != 0 and (best == NONE or abs(areas[c]) < abs(areas[best])):
                best = c
        if best == NONE:
            return
        if not _contours_touch(segments, of, hole, best):
            _unite(parent, hole, best)
            return
        turns[best] = 0


@njit
def _in_solid(point, group, segments, of, roots, here, rule):  # type: ignore[no-untyped-def]  # numba types it
    """Whether a point is in the solid of the contours of other groups. here: segments of its row"""
    winding, crossed = 0, 0
    for s in here:
        if roots[of[s]] != group:
            passes = _passes_left(segments[s], point[0], point[1])
            winding += passes
            crossed += abs(passes)
    return winding_is_inside(winding, crossed, rule)


@njit(FOUND(SEGMENTS, WORK, types.int64), cache=True, nogil=True)
def joined_pieces(segments, rows, rule):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 6): of each component of the raster that is several pieces, how many; their area in px² and x0, y0, x1, y1
    of their box, both without the largest. Holes count as solid.

    segments  (n, 4) x, y of start and end in px, solid on the left (of x right, y up; rows run down)
    rows      packed: what `fill` made of them, with what is thinner than a pixel
    """
    of, begins, measures = contours_of(segments)
    component = _components(segments, of, measures, rows)
    count, areas = begins.shape[0], measures[:, 4]
    outer, wanted = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    several = np.zeros(component.max() + 2, np.int64)
    for c in range(count):
        outer[c] = component[c] != NONE and is_outer(begins[c], areas[c], rule)
        several[component[c]] += outer[c]
    for c in range(count):
        wanted[c] = outer[c] and several[component[c]] > 1
    first = math.floor(measures[:, 1].min() - TOUCH)
    starts, numbers = _by_rows(segments, first, math.floor(measures[:, 3].max() + TOUCH) + 1)
    parent, size = np.arange(count), np.zeros(count, np.int64)
    _unite_touching(segments, of, measures, wanted, starts, numbers, parent)
    for c in range(count):
        size[root_of(parent, c)] += 1
    for c in range(count):
        if size[root_of(parent, c)] > 1 and not outer[c] and begins[c] != NONE:
            row = math.floor(segments[begins[c], 1]) - first
            here = numbers[starts[row] : starts[row + 1]]
            _unite_hole(c, segments[begins[c]], segments, of, outer, areas, here, parent)
    roots, left = np.empty(count, np.int64), np.full(count, NONE, np.int64)
    for c in range(count):
        roots[c] = root_of(parent, c)
    for s in range(segments.shape[0]):  # the point of each group that is furthest left is on its outside
        best = left[roots[of[s]]]
        if best == NONE or segments[s, 0] < segments[best, 0]:
            left[roots[of[s]]] = s
    found = np.zeros((several.shape[0], 6))
    found[:, 2:4], found[:, 4:] = math.inf, -math.inf
    largest = np.full(several.shape[0], NONE, np.int64)
    for c in range(count):
        point = left[roots[c]]
        if not wanted[c] or point == NONE:
            continue
        left[roots[c]] = NONE  # each group counts once
        row = math.floor(segments[point, 1]) - first
        here = numbers[starts[row] : starts[row + 1]]
        if not _in_solid(segments[point], roots[c], segments, of, roots, here, rule):
            k = component[c]
            found[k, 0] += 1
            less = c
            if largest[k] == NONE or abs(areas[c]) > abs(areas[largest[k]]):
                less, largest[k] = largest[k], c
            if less != NONE:
                found[k, 1] += abs(areas[less]) / 2
                for axis in range(2):
                    found[k, 2 + axis] = min(found[k, 2 + axis], measures[less, axis])
                    found[k, 4 + axis] = max(found[k, 4 + axis], measures[less, 2 + axis])
    return found[found[:, 0] > 1]
