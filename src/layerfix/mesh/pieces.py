"""Pieces of a cross-section, told apart by their contours where pixels join them.

Two pieces less than a pixel apart hang together in the raster, and a small one may then pass for a bump of its
neighbour, which the method need not keep: the middle pixel of each small one, a compact closed contour no larger than
a tool, is noted. Where pieces may be joined, contours and runs of pixels are kept for `layerfix.mesh.joined`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.bits import WORK
from layerfix.kernels import njit
from layerfix.layers.components import edges_of_rows, joined_runs
from layerfix.layers.neighbours import bit_at
from layerfix.mesh.fill import (
    BITS,
    LEAST_AREA,
    MAYBE,
    NONZERO,
    NOT,
    ONE,
    POSITIVE,
    SEGMENTS,
    SURELY,
    fill_and_look,
    sort,
    winding_is_inside,
)

COMPACT = 0.45  # share of its box that a piece fills: a triangle half
CRUMB_PX = 2.0
LARGEST_PX = 64  # of a small piece, along x and along y
PLACES = types.Array(types.int64, 2, "C")
NUMBERS = types.Array(types.int64, 1, "C")
CONTOURS = types.Tuple((NUMBERS, NUMBERS, types.Array(types.float64, 2, "C"), NUMBERS, NUMBERS))
NONE = -1
NEAR_PX, MANY = 4.0, 64  # pieces are joined within; contours whose boxes are compared


@njit
def _slot(x, y, mask):  # type: ignore[no-untyped-def]  # numba types it
    """Where a point is looked for first in a table of mask + 1 places. Points of neighbouring segments are equal."""
    value = np.int64(x * 1048576.0) * np.int64(0x2545F491) ^ np.int64(y * 1048576.0) * np.int64(0x5851F42D)
    value ^= value >> np.int64(23)
    value *= np.int64(0x2127599B)
    value ^= value >> np.int64(19)
    return value & mask


@njit
def contours_of(segments):  # type: ignore[no-untyped-def]  # numba types it
    """(of, starts, measures): the contour of each segment; of each contour its first segment, NONE if it does not
    close; and x0, y0, x1, y1, twice its area, and the sums that its centroid is made of.

    The area is below 0 if the solid is inside: it is on the left with y up, and rows run down.
    """
    n = segments.shape[0]
    size = 4
    while size < 2 * n:
        size *= 2
    table = np.full(size, NONE, np.int64)
    for s in range(n):
        at = _slot(segments[s, 0], segments[s, 1], np.int64(size - 1))
        while table[at] != NONE:
            at = (at + 1) & (size - 1)
        table[at] = s
    of, starts, measures, count = np.full(n, NONE, np.int64), np.empty(16, np.int64), np.empty((16, 7)), 0
    for first in range(n):
        if of[first] != NONE:
            continue
        x0 = x1 = segments[first, 0]
        y0 = y1 = segments[first, 1]
        double_area, mx, my, s, closed = 0.0, 0.0, 0.0, int(first), False
        while s != NONE and of[s] == NONE:
            of[s] = count
            ax, ay, bx, by = segments[s]
            x0, x1, y0, y1 = min(x0, bx), max(x1, bx), min(y0, by), max(y1, by)
            px, py = ax - segments[first, 0], ay - segments[first, 1]
            qx, qy = bx - segments[first, 0], by - segments[first, 1]
            part = px * qy - qx * py
            double_area += part
            mx += part * (px + qx)
            my += part * (py + qy)
            if bx == segments[first, 0] and by == segments[first, 1]:
                closed = True
                break
            at = _slot(bx, by, np.int64(size - 1))
            s = NONE
            while table[at] != NONE:
                other = table[at]
                if of[other] == NONE and segments[other, 0] == bx and segments[other, 1] == by:
                    s = int(other)
                    break
                at = (at + 1) & (size - 1)
        if count == starts.shape[0]:
            more_starts, more = np.empty(2 * count, np.int64), np.empty((2 * count, 7))
            more_starts[:count], more[:count] = starts, measures
            starts, measures = more_starts, more
        starts[count] = first if closed else NONE
        measures[count] = (x0, y0, x1, y1, double_area, mx, my)
        count += 1
    return of, starts[:count], measures[:count]


@njit
def _small(segments, starts, measures, rows):  # type: ignore[no-untyped-def]  # numba types it
    out, found = np.empty((16, 2), np.int64), 0
    for c in range(starts.shape[0]):
        x0, y0, x1, y1, double_area, mx, my = measures[c]
        wide, high, first = x1 - x0, y1 - y0, starts[c]
        if (
            first == NONE
            or double_area >= 0
            or max(wide, high) > LARGEST_PX
            or -double_area < 2 * COMPACT * wide * high
        ):
            continue
        y = np.int64(math.floor(segments[first, 1] + my / (3 * double_area) + 0.5))
        x = np.int64(math.floor(segments[first, 0] + mx / (3 * double_area) + 0.5))
        if not bit_at(rows, y, x) and max(wide, high) > CRUMB_PX:
            continue
        if found == out.shape[0]:
            longer = np.empty((2 * found, 2), np.int64)
            longer[:found] = out
            out = longer
        out[found, 0], out[found, 1] = y, x
        found += 1
    return out[:found].copy()


@njit(PLACES(SEGMENTS, WORK), cache=True, nogil=True)
def small_pieces(segments, rows):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 2) row and column of the centroid of each closed contour that has the solid inside, is small and compact.

    segments  (n, 4) x, y of start and end, solid on the left (of x right, y up; rows run down)
    rows      packed: what they fill. A centroid is solid (that of a ring or a bow is not), but for crumbs, which may
              hold no pixel
    """
    _, starts, measures = contours_of(segments)
    return _small(segments, starts, measures, rows)


@njit
def outer_contours(starts, measures, rule):  # type: ignore[no-untyped-def]  # numba types it
    """Which contours may go round a piece: they close, and have the solid inside. By the even-odd rule all may; by
    the nonzero rule those that turn the other way may, too, if they are in no other one's box."""
    outer = np.zeros(starts.shape[0], np.bool_)
    for c in range(starts.shape[0]):
        if starts[c] == NONE or abs(measures[c, 4]) <= 2 * LEAST_AREA:
            continue
        outer[c] = measures[c, 4] < 0 or rule != POSITIVE
        other = 0
        while measures[c, 4] > 0 and rule == NONZERO and outer[c] and other < starts.shape[0]:
            x0, y0, x1, y1, double_area = measures[other, :5]
            inside = x0 <= measures[c, 0] and y0 <= measures[c, 1] and x1 >= measures[c, 2] and y1 >= measures[c, 3]
            outer[c] = not (inside and double_area < 0)
            other += 1
    return outer


@njit
def _look(outer, measures):  # type: ignore[no-untyped-def]  # numba types it
    """MAYBE if the boxes of two outer contours are within NEAR_PX, or there are too many to compare; SURELY if, then,
    one may be inside a cell of four pixel centres; else NOT."""
    boxes, n, look, crumb = np.empty((MANY, 4)), 0, NOT, False
    for c in range(outer.shape[0]):
        if not outer[c]:
            continue
        x0, y0, x1, y1 = measures[c, :4]
        crumb |= max(x1 - x0, y1 - y0) <= 1
        if n == MANY:
            look = MAYBE
        k = 0
        while look == NOT and k < n:
            if max(x0 - boxes[k, 2], boxes[k, 0] - x1, y0 - boxes[k, 3], boxes[k, 1] - y1) <= NEAR_PX:
                look = MAYBE
            k += 1
        if n < MANY:
            boxes[n] = (x0, y0, x1, y1)
            n += 1
    return SURELY if crumb and look == MAYBE else look


@njit
def _with_run(edges, n, of_row, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """Append a run to a row's, which begin at of_row, or make the latest longer. Returns how many edges there are."""
    if n > of_row and edges[n - 1] >= first:
        edges[n - 1] = max(edges[n - 1], stop)
        return n
    edges[n], edges[n + 1] = first, stop
    return n + 2


@njit
def _edges_of_fill(starts, crossings, rule, marks, rows):  # type: ignore[no-untyped-def]  # numba types it
    """`layerfix.layers.components.edges_of_rows` of what was filled, without a look at all of its words."""
    height, stride = rows.shape[0], 64 * np.int64(rows.shape[1])
    keys, kept = np.empty(marks.shape[0], np.int64), 0
    for k in range(marks.shape[0]):
        if bit_at(rows, marks[k, 0], marks[k, 1]):  # not taken back
            keys[kept] = marks[k, 0] * stride + marks[k, 1]
            kept += 1
    keys = keys[:kept]
    sort(keys)
    turns, edges, n, k = (
        np.zeros(height + 1, np.int64),
        np.empty(crossings.shape[0] + 2 * keys.shape[0], np.int64),
        0,
        0,
    )
    for j in range(height):
        winding, was_inside, first = 0, False, np.int64(0)
        for i in range(starts[j], starts[j + 1]):
            winding += 1 if crossings[i] & 1 else -1
            inside = winding_is_inside(winding, i + 1 - starts[j], rule)
            if inside == was_inside:
                continue
            was_inside, column = inside, ((crossings[i] >> 1) + ONE - 1) >> BITS
            if inside:
                first = column
                continue
            while k < keys.shape[0] and keys[k] < j * stride + first:
                n = _with_run(edges, n, turns[j], keys[k] - j * stride, keys[k] - j * stride + 1)
                k += 1
            if column > first:
                n = _with_run(edges, n, turns[j], first, column)
        while k < keys.shape[0] and keys[k] < (j + 1) * stride:
            n = _with_run(edges, n, turns[j], keys[k] - j * stride, keys[k] - j * stride + 1)
            k += 1
        turns[j + 1] = n
    return turns, edges[:n]


@njit
def _may_be_joined(outer, measures, turns, edges, width, height, rule):  # type: ignore[no-untyped-def]  # numba types it
    """Whether pieces may be joined: there are more outer contours than components, or a contour may be in several."""
    pieces = 0
    for c in range(outer.shape[0]):
        x0, y0, x1, y1 = measures[c, :4]
        if rule == POSITIVE or min(x0, y0) < 0 or x1 > width or y1 > height:
            return True
        pieces += outer[c]
    return pieces > joined_runs(turns, edges, 64 * (width // 64 + 1), False)[2]


@njit(
    types.Tuple((types.int64, PLACES, types.boolean, CONTOURS))(SEGMENTS, types.int64, types.int64, WORK),
    cache=True,
    nogil=True,
)
def fill_pieces(segments, width, rule, rows):  # type: ignore[no-untyped-def]  # numba types it
    """`fill` with what is thinner than a pixel: (pixels that stand for it; `small_pieces`; whether pieces may have
    been joined; if so, what `layerfix.mesh.joined` needs to tell)."""
    of, starts, measures = contours_of(segments)
    outer = outer_contours(starts, measures, rule)
    added, close, row_starts, crossings, marks = fill_and_look(
        segments, width, rule, True, _look(outer, measures), rows
    )
    small = _small(segments, starts, measures, rows)
    if close:
        turns, edges = _edges_of_fill(row_starts, crossings, rule, marks, rows)
        if _may_be_joined(outer, measures, turns, edges, width, rows.shape[0], rule):
            return added, small, True, (of, starts, measures, turns, edges)
    return added, small, False, (of[:0], starts[:0], measures[:0], of[:0], of[:0])


@njit(CONTOURS(SEGMENTS, WORK), cache=True, nogil=True)
def contours_and_edges(segments, rows):  # type: ignore[no-untyped-def]  # numba types it
    """The same of any rows."""
    of, starts, measures = contours_of(segments)
    turns, edges = edges_of_rows(rows)
    return of, starts, measures, turns, edges
