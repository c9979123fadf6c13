"""Segments of a cut → pixels: those whose centres are inside, and of what is thinner than a pixel a line of pixels.

Plain fill P sees the solid at pixel centres only: of a wall thinner than a pixel it keeps crumbs, or nothing. Grid
edges join the centres of 4-neighbouring pixels. The rule:
  1. A grid edge that meets solid while neither of its ends is in P gets one end, the nearer to the solid's middle.
  2. A curve that stays inside a cell of four centres and meets no edge gets the pixel nearest to one of its points.
  3. Marks that touch P and are simple points (solid 8-connected, void 4-connected) are taken back.
Why it holds: a connected piece of the cross-section that reaches from one cell into the next crosses an edge, of
which an end is set; the corners of a cell are 8-neighbours of one another; so each piece is one 8-connected line. Two
4-neighbours that stay empty have an edge without solid between them: no two voids join. Pieces may join only where
they are within two pixels of one another. Parts without such places do not change by a pixel.

Positions on edges are counted in 1 / 2^20 px. Everything is half-open as in the cut: a row belongs to an edge if
y0 ≤ row < y1; a line through a pixel's centre passes as if the centre lay a little to the right and, far less, below.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.bits import ALL, U1, WORK
from layerfix.kernels import njit
from layerfix.layers.neighbours import around, bit_at, is_simple

SEGMENTS = types.Array(types.float64, 2, "C")
EVEN_ODD, NONZERO, POSITIVE = 0, 1, 2
BITS = 20
ONE = 1 << BITS  # of an edge
NOT, MAYBE, SURELY = 0, 1, 2  # whether components are counted
LEAST_AREA = 1e-9  # px², of a piece within a cell: a sheet drawn on both sides has none


@njit
def below(values, bound):  # type: ignore[no-untyped-def]  # numba types it
    """How many of the sorted values are below the bound: np.searchsorted, which would load half of numba (0.1 s)."""
    first, stop = 0, values.shape[0]
    while first < stop:
        middle = (first + stop) // 2
        if values[middle] < bound:
            first = middle + 1
        else:
            stop = middle
    return first


@njit
def not_above(values, bound):  # type: ignore[no-untyped-def]  # numba types it
    """How many of the sorted values are at most the bound."""
    first, stop = 0, values.shape[0]
    while first < stop:
        middle = (first + stop) // 2
        if values[middle] <= bound:
            first = middle + 1
        else:
            stop = middle
    return first


@njit
def sort(values):  # type: ignore[no-untyped-def]  # numba types it
    """Shell sort. Most rows have few crossings, nearly in order: for them it is one insertion pass."""
    n = values.shape[0]
    gap = 701
    while 9 * gap // 4 * 4 < n:
        gap = 9 * gap // 4
    while gap > 0:
        if gap == 1 or n >= 4 * gap:
            for i in range(gap, n):
                v = values[i]
                k = i - gap
                while k >= 0 and values[k] > v:
                    values[k + gap] = values[k]
                    k -= gap
                values[k + gap] = v
        gap = 0 if gap == 1 else (max(4 * gap // 9, 1) if gap > 4 else 1)


@njit
def _fill_span(line, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """Set bits first … stop - 1; stop > first."""
    w0, w1 = first >> 6, (stop - 1) >> 6
    head = ALL << np.uint64(first & 63)
    tail = ALL >> np.uint64(63 - ((stop - 1) & 63))
    if w0 == w1:
        line[w0] |= head & tail
    else:
        line[w0] |= head
        for w in range(w0 + 1, w1):
            line[w] = ALL
        line[w1] |= tail


@njit
def row_crossings(segments, width, height):  # type: ignore[no-untyped-def]  # numba types it
    """(starts, crossings): where segments cross each row of centres, 2 · position + 1 where the solid begins."""
    starts = np.zeros(height + 1, np.int64)
    for s in range(segments.shape[0]):
        low, high = min(segments[s, 1], segments[s, 3]), max(segments[s, 1], segments[s, 3])
        for j in range(max(math.ceil(low), 0), min(math.ceil(high), height)):
            starts[j + 1] += 1
    for j in range(height):
        starts[j + 1] += starts[j]
    crossings = np.empty(starts[height], np.int64)
    where = starts.copy()
    most = width << BITS
    for s in range(segments.shape[0]):
        x0, y0, x1, y1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        begins = 1 if y1 > y0 else 0  # rows run downwards: up the page has the solid on its left
        if y1 < y0:
            x0, y0, x1, y1 = x1, y1, x0, y0
        first, stop = max(math.ceil(y0), 0), min(math.ceil(y1), height)
        if first >= stop:
            continue
        slope = (x1 - x0) / (y1 - y0)
        for j in range(first, stop):
            place = np.int64(math.ceil((x0 + (j - y0) * slope) * ONE))  # its column is that of the exact crossing
            crossings[where[j]] = min(max(place, 0), most) << 1 | begins
            where[j] += 1
    return starts, crossings


@njit
def winding_is_inside(winding, crossed, rule):  # type: ignore[no-untyped-def]  # numba types it
    """Whether it is solid where the winding number is that, after so many crossings."""
    if rule == NONZERO:
        return winding != 0
    return winding > 0 if rule == POSITIVE else crossed & 1 == 1


@njit
def _touches_above(rows, j, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """Whether a span touches a pixel of the row above at a corner only."""
    return (bit_at(rows, j - 1, first - 1) and not bit_at(rows, j - 1, first)) or (
        bit_at(rows, j - 1, stop) and not bit_at(rows, j - 1, stop - 1)
    )


@njit
def _fill_rows(starts, crossings, rule, look, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Plain fill. Returns the solid on edges along rows that have no pixel of it: (n, 3) row, column of the edge's
    right end, and twice the middle of the solid, counted from the left end.

    With `look` also whether pixels are side by side with void between their centres, or touch at a corner only, or
    solid without a pixel is beside one.
    """
    spans = np.empty((64, 3), np.int64)
    n, close = 0, False
    for j in range(rows.shape[0]):
        if starts[j] == starts[j + 1]:
            continue
        row = crossings[starts[j] : starts[j + 1]]
        sort(row)
        winding, was_inside, start, of_row, latest = 0, False, np.int64(0), n, np.int64(-1)
        for i in range(row.shape[0]):
            winding += 1 if row[i] & 1 else -1
            inside = winding_is_inside(winding, i + 1, rule)
            here = row[i] >> 1
            if inside == was_inside:
                continue
            was_inside = inside
            if inside:
                start = here
                continue
            first, stop = (start + ONE - 1) >> BITS, (here + ONE - 1) >> BITS
            if stop > first:
                _fill_span(rows[j], first, stop)
                if look != NOT and not close:
                    close = first == latest or _touches_above(rows, j, first, stop)
                    latest = stop
            elif here > start:
                if n == spans.shape[0]:
                    longer = np.empty((2 * n, 3), np.int64)
                    for k in range(n):
                        longer[k, 0], longer[k, 1], longer[k, 2] = spans[k, 0], spans[k, 1], spans[k, 2]
                    spans = longer
                spans[n, 0], spans[n, 1], spans[n, 2] = j, first, start + here - ((first - 1) << (BITS + 1))
                n += 1
        kept = of_row
        for k in range(of_row, n):
            if not (bit_at(rows, j, spans[k, 1]) or bit_at(rows, j, spans[k, 1] - 1)):
                spans[kept, 0], spans[kept, 1], spans[kept, 2] = spans[k, 0], spans[k, 1], spans[k, 2]
                kept += 1
        close |= look != NOT and kept < n
        n = kept
    return spans[:n], close


@njit
def _grown(numbers, count):  # type: ignore[no-untyped-def]  # numba types it
    """The same list, with room for one more."""
    if count < numbers.shape[0]:
        return numbers
    longer = np.empty(2 * count, np.int64)
    for k in range(count):
        longer[k] = numbers[k]
    return longer


@njit
def _column_keys(segments, width, look, rows):  # type: ignore[no-untyped-def]  # numba types it
    """(keys of crossings of edges along columns whose ends are empty; keys of segments in cells with empty corners;
    with `look`, whether an edge with two set ends is crossed, or one at that end where the solid is not).

    An edge or cell is counted by its lower (right) end, row · (width + 1) + column. A crossing's key is (edge,
    position on it, whether the solid begins there), a segment's (cell, its number); both are sorted.
    """
    height, stride = rows.shape[0], np.int64(width + 1)
    keys, k = np.empty(64, np.int64), 0
    inner, cells, close = np.empty(64, np.int64), 0, False
    for s in range(segments.shape[0]):
        x0, y0, x1, y1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        c0, c1 = math.ceil(x0), math.ceil(x1)
        # The cell around the segment: one on a border is the cell's to the right and below.
        c, r = math.floor((x0 + x1) / 2) + 1, math.floor((y0 + y1) / 2) + 1
        if (max(x0, x1) <= c and max(y0, y1) <= r and min(x0, x1) >= c - 1 and min(y0, y1) >= r - 1) and not (
            bit_at(rows, r, c) | bit_at(rows, r - 1, c) | bit_at(rows, r, c - 1) | bit_at(rows, r - 1, c - 1)
        ):
            inner = _grown(inner, cells)
            inner[cells] = (r * stride + c) * segments.shape[0] + s
            cells += 1
        if c0 == c1:
            continue
        begins = np.int64(c1 < c0)
        if begins:
            x0, y0, x1, y1, c0, c1 = x1, y1, x0, y0, c1, c0
        slope = (y1 - y0) / (x1 - x0)
        for c in range(max(c0, 0), min(c1, width)):
            y = y0 + (c - x0) * slope
            r = math.floor(y) + 1 if slope > 0 else math.ceil(y)
            r = min(max(r, 0), height)
            if bit_at(rows, r - 1 + begins, c):  # where the solid should be
                close |= look != NOT and bit_at(rows, r - begins, c) == 1
                continue
            if bit_at(rows, r - begins, c):
                close |= look != NOT
                continue
            keys = _grown(keys, k)
            part = min(max(np.int64((y - (r - 1)) * ONE), 0), ONE - 1)
            keys[k] = ((r * stride + c) * ONE + part) * 2 + begins
            k += 1
    sort(keys[:k])
    sort(inner[:cells])
    return keys[:k], inner[:cells], close


@njit
def _mark_rows(spans, width, marks):  # type: ignore[no-untyped-def]  # numba types it
    for k in range(spans.shape[0]):
        left = 1 if spans[k, 2] < ONE else 0
        marks[k, 0], marks[k, 1] = spans[k, 0], min(max(spans[k, 1] - left, 0), width - 1)
    return spans.shape[0]


@njit
def _mark_columns(keys, stride, height, rule, marks, m, met):  # type: ignore[no-untyped-def]  # numba types it
    """An end of every edge along a column that solid crosses from one side to the other. Returns how many marks there
    are then, and how many edges are `met`, in order: crossed at two places. At one a curve only touches them."""
    i, edges = 0, 0
    while i < keys.shape[0]:
        edge = keys[i] // (2 * ONE)
        first, part = (keys[i] >> 1) % ONE, np.int64(0)
        winding, thick, total, count = 0, False, np.int64(0), 0
        while i < keys.shape[0] and keys[i] // (2 * ONE) == edge:
            part = (keys[i] >> 1) % ONE
            winding += 1 if keys[i] & 1 else -1
            total += part
            count += 1
            i += 1
            if i < keys.shape[0] and keys[i] // (2 * ONE) == edge and (keys[i] >> 1) % ONE > part:
                thick |= winding_is_inside(winding, count, rule)
        if part > first or count & 1:
            met[edges] = edge
            edges += 1
        if thick and count & 1 == 0 and not (rule == NONZERO and winding != 0):
            up = 1 if 2 * total < count * ONE else 0
            marks[m, 0], marks[m, 1] = min(max(edge // stride - up, 0), height - 1), edge % stride
            m += 1
    return m, edges


@njit
def _mark_cells(segments, inner, met, spans, rule, stride, height, width, marks, m):  # type: ignore[no-untyped-def]  # numba types it
    """A pixel for every curve round some solid that stays within a cell, its border too. Returns how many marks.
    met: edges along columns that are crossed."""
    p = 0
    while p < inner.shape[0]:
        cell, area, within = inner[p] // segments.shape[0], 0.0, -1
        while p < inner.shape[0] and inner[p] // segments.shape[0] == cell:
            x0, y0, x1, y1 = segments[inner[p] % segments.shape[0]]
            area += ((cell % stride) - (x0 + x1) / 2) * (y1 - y0)  # right of the curve there is none
            if within < 0 and (x0 != x1 or x0 > cell % stride - 1) and (y0 != y1 or y0 > cell // stride - 1):
                within = inner[p] % segments.shape[0]
            p += 1
        if within < 0 or (area if rule == POSITIVE else abs(area)) < LEAST_AREA:
            continue
        crossed = False
        for edge in (cell, cell - 1):  # along columns: right and left
            at = below(met, edge)
            crossed |= at < met.shape[0] and met[at] == edge
        for row in (cell // stride - 1, cell // stride):  # along rows: above and below
            at = below(spans[:, 0], row)
            while at < spans.shape[0] and spans[at, 0] == row:
                crossed |= spans[at, 1] == cell % stride
                at += 1
        if not crossed:
            marks[m, 0] = min(max(math.floor(segments[within, 1] + 0.5), 0), height - 1)
            marks[m, 1] = min(max(math.floor(segments[within, 0] + 0.5), 0), width - 1)
            m += 1
    return m


@njit
def fill_and_look(segments, width, rule, thin, look, rows):  # type: ignore[no-untyped-def]  # numba types it
    """(pixels as `fill` says; whether something that is apart may be one in `rows`; `row_crossings`; pixels that were
    marked, some of which were taken back).

    With look = MAYBE something may be one only if void may pass between pixels that touch, or solid has no pixel of
    its own.
    """
    height, stride = rows.shape[0], np.int64(width + 1)
    starts, crossings = row_crossings(segments, width, height)
    spans, close = _fill_rows(starts, crossings, rule, look, rows)
    if not thin:
        return 0, False, starts, crossings, np.empty((0, 2), np.int64)
    keys, inner, also_close = _column_keys(segments, width, look, rows)
    marks = np.empty((spans.shape[0] + keys.shape[0] + inner.shape[0], 2), np.int64)
    m = _mark_rows(spans, width, marks)
    met = np.empty(keys.shape[0], np.int64)
    m, edges = _mark_columns(keys, stride, height, rule, marks, m, met)
    m = _mark_cells(segments, inner, met[:edges], spans, rule, stride, height, width, marks, m)
    added = _draw_marks(marks[:m], rows)
    close = look == SURELY or (look == MAYBE and (close or also_close or m > 0))
    return added, close, starts, crossings, marks[:m]


@njit
def _draw_marks(marks, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Set what is marked, take back what is not needed. Returns how many pixels are set then."""
    m = marks.shape[0]
    near = np.empty(m, np.bool_)
    for k in range(m):
        near[k] = around(rows, marks[k, 0], marks[k, 1]) != 0
    added = 0
    for k in range(m):
        y, x = marks[k]
        if bit_at(rows, y, x):
            near[k] = False  # it is there twice
        else:
            rows[y, x >> 6] |= U1 << np.uint64(x & 63)
            added += 1
    again = True
    while again:
        again = False
        for k in range(m):
            y, x = marks[k]
            if near[k] and is_simple(around(rows, y, x)):
                rows[y, x >> 6] &= ~(U1 << np.uint64(x & 63))
                near[k] = False
                added -= 1
                again = True
    return added


@njit(types.int64(SEGMENTS, types.int64, types.int64, types.boolean, WORK), cache=True, nogil=True)
def fill(segments, width, rule, thin, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Set the pixels of `rows` (zeroed packed rows) whose centre is inside by the winding rule, and, if `thin`, the
    ones that stand for what is thinner than a pixel. Returns how many of these there are.

    segments  (n, 4) x, y of start and end in px, solid on the left (of x right, y up)
    """
    return fill_and_look(segments, width, rule, thin, NOT, rows)[0]
