"""Pieces of a cross-section that the raster joins, since they are within two pixels of one another: which, exactly.

A piece is what its contours say, by the winding rule: contours that cross or touch bound one piece, one that lies in
the solid of others bounds none. Each piece is in the raster and in one component of it (`layerfix.mesh.fill`), so of
the pieces of a component all but one were joined to another.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.kernels import njit
from layerfix.layers.components import joined_runs, root_of
from layerfix.mesh.fill import SEGMENTS, winding_is_inside
from layerfix.mesh.pieces import CONTOURS, NONE, outer_contours

TOUCH = 1e-6  # px: what is nearer is the same place
FOUND = types.Array(types.float64, 2, "C")


@njit
def _components(segments, of, count, turns, edges):  # type: ignore[no-untyped-def]  # numba types it
    """Of each contour a run of the component that it is in; NONE for what is outside the frame.

    The corners of a cell are 8-neighbours, and a piece that enters a cell sets one of them, but for ends of a line
    that were taken back. If all of it was taken back, it touched what is there.
    """
    runs, parent, _ = joined_runs(turns, edges, np.int64(1) << 40, False)
    found, height = np.full(count, NONE, np.int64), turns.shape[0] - 1
    first_of = turns // 2
    for reach in range(2):
        side = 2 + 2 * reach
        for s in range(segments.shape[0]):
            x0, y0, x1, y1 = segments[s]
            steps = 1 + math.floor(max(abs(x1 - x0), abs(y1 - y0)))
            for k in range(steps * side * side):
                if found[of[s]] != NONE:
                    break
                along, corner = k // (side * side) / steps, k % (side * side)
                x = math.floor(x0 + along * (x1 - x0)) - reach + corner % side
                y = math.floor(y0 + along * (y1 - y0)) - reach + corner // side
                if not 0 <= y < height:
                    continue
                run = first_of[y]
                while run < first_of[y + 1] and runs[run, 2] <= x:
                    run += 1
                if run < first_of[y + 1] and runs[run, 1] <= x:
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
def _boxes_meet(one, other):  # type: ignore[no-untyped-def]  # numba types it
    """Whether two boxes (x0, y0, x1, y1, …) are no further apart than TOUCH."""
    return max(one[0] - other[2], other[0] - one[2], one[1] - other[3], other[1] - one[3]) <= TOUCH


@njit
def _near(measures, wanted):  # type: ignore[no-untyped-def]  # numba types it
    """Which contours may touch a wanted one, or are one that may be touched, by their boxes."""
    near = np.zeros(wanted.shape[0], np.bool_)
    for c in range(wanted.shape[0]):
        if not wanted[c]:
            continue
        for other in range(wanted.shape[0]):
            if other != c and not (near[c] and near[other]) and _boxes_meet(measures[c], measures[other]):
                near[c] = near[other] = True
    return near


@njit
def _unite_touching(segments, of, measures, wanted, component, starts, numbers, parent, too_many):  # type: ignore[no-untyped-def]  # numba types it
    """Unite contours that touch a wanted one with it, row by row, until as many wanted ones are united as there are
    too many. Returns how many then still are.
    """
    near = _near(measures, wanted)
    holds = np.full(wanted.shape[0], NONE, np.int64)  # the component of a group's wanted contours
    for c in range(wanted.shape[0]):
        if wanted[c]:
            holds[c] = component[c]
    here, left, right = np.empty(64, np.int64), np.empty(64), np.empty(64)
    for y in range(starts.shape[0] - 1):
        n = 0
        if here.shape[0] < starts[y + 1] - starts[y]:
            more = 2 * (starts[y + 1] - starts[y])
            here, left, right = np.empty(more, np.int64), np.empty(more), np.empty(more)
        for i in range(starts[y], starts[y + 1]):
            if near[of[numbers[i]]]:
                s, k = numbers[i], n
                x0, x1 = min(segments[s, 0], segments[s, 2]), max(segments[s, 0], segments[s, 2])
                while k > 0 and left[k - 1] > x0:
                    here[k], left[k], right[k] = here[k - 1], left[k - 1], right[k - 1]
                    k -= 1
                here[k], left[k], right[k] = s, x0, x1
                n += 1
        for i in range(n):
            j = i + 1
            while j < n and left[j] <= right[i] + TOUCH:
                one, other = of[here[i]], of[here[j]]
                if one != other and (wanted[one] or wanted[other]):
                    a, b = root_of(parent, one), root_of(parent, other)
                    if a != b and _touch(segments[here[i]], segments[here[j]]):
                        parent[max(a, b)] = min(a, b)
                        too_many -= holds[a] == holds[b] and holds[a] != NONE
                        holds[min(a, b)] = max(holds[a], holds[b])
                        if too_many == 0:
                            return 0
                j += 1
    return too_many


@njit
def _passes_left(segment, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """1 or −1 if a segment crosses the line from a point to the left, up or down the page, else 0."""
    ax, ay, bx, by = segment
    if (ay <= y) == (by <= y) or ax + (y - ay) * (bx - ax) / (by - ay) >= x:
        return 0
    return 1 if by > ay else -1


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


@njit(FOUND(SEGMENTS, CONTOURS, types.int64), cache=True, nogil=True)
def joined_pieces(segments, contours, rule):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 6): of each component of the raster that is several pieces, how many; their area in px² and x0, y0, x1, y1
    of their box, both without the largest. Holes count as solid.

    segments  (n, 4) x, y of start and end in px, solid on the left (of x right, y up; rows run down)
    contours  `layerfix.mesh.pieces.fill_pieces`
    """
    of, begins, measures, turns, edges = contours
    if of.shape[0] == 0:
        return np.empty((0, 6))
    count, areas = begins.shape[0], measures[:, 4]
    component = _components(segments, of, count, turns, edges)
    outer, last, low, high = outer_contours(begins, measures, rule), NONE, math.inf, -math.inf
    for c in range(count):
        outer[c] &= component[c] != NONE
        last, low, high = max(last, component[c]), min(low, measures[c, 1]), max(high, measures[c, 3])
    several, too_many = np.zeros(last + 2, np.int64), 0
    for c in range(count):
        too_many += outer[c] and several[component[c]] > 0
        several[component[c]] += outer[c]
    wanted = np.zeros(count, np.bool_)
    for c in range(count):
        wanted[c] = outer[c] and several[component[c]] > 1
    first = math.floor(low - TOUCH)
    starts, numbers = _by_rows(segments, first, math.floor(high + TOUCH) + 1)
    parent = np.arange(count)
    if _unite_touching(segments, of, measures, wanted, component, starts, numbers, parent, too_many) == 0:
        return np.empty((0, 6))
    roots, left = np.empty(count, np.int64), np.full(count, NONE, np.int64)
    for c in range(count):
        roots[c] = root_of(parent, c)
    # The point of each group that is furthest left is on its outside or, of a hole's, in the solid round that.
    for s in range(segments.shape[0]):
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
    kept = 0
    for k in range(found.shape[0]):
        if found[k, 0] > 1:
            for i in range(6):
                found[kept, i] = found[k, i]
            kept += 1
    return found[:kept]
