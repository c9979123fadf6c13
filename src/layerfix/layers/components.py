"""Components of a layer: labelled run by run, on `layerfix.layers.columns`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ALL, ROWS, U0, U1, U63, WORK, lowest_bit, popcount
from layerfix.kernels import njit
from layerfix.layers.columns import bounding_box, to_columns, with_border

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

NUMBERS = types.Array(types.int64, 1, "C")
RUNS = types.Array(types.int64, 2, "C")
AREA, LEFT, TOP, RIGHT, BOTTOM = range(5)  # columns of `measured_parts`


@njit
def _longer(places, bits, count):  # type: ignore[no-untyped-def]  # numba types it
    """The same two lists with room for twice as many."""
    more_places, more_bits = np.empty((2 * bits.shape[0], 2), np.int32), np.empty(2 * bits.shape[0], np.uint64)
    for k in range(count):
        more_places[k, 0], more_places[k, 1], more_bits[k] = places[k, 0], places[k, 1], bits[k]
    return more_places, more_bits


@njit(types.UniTuple(NUMBERS, 2)(WORK), cache=True, nogil=True)
def row_edges(columns):  # type: ignore[no-untyped-def]  # numba types it
    """(starts, edges): edges[starts[y] : starts[y + 1]] are the x at which row y turns solid, void, solid …"""
    words, height = columns.shape
    starts, line = np.zeros(height + 1, np.int64), np.empty(height, np.uint64)
    places, bits, n = np.empty((height, 2), np.int32), np.empty(height, np.uint64), 0
    for w in range(words + 1):
        if w == 0:
            here = columns[w]
            for y in range(height):
                line[y] = here[y] ^ (here[y] << U1)
        elif w == words:
            here = columns[w - 1]
            for y in range(height):
                line[y] = here[y] >> U63
        else:
            west, here = columns[w - 1], columns[w]
            for y in range(height):
                line[y] = here[y] ^ (here[y] << U1) ^ (west[y] >> U63)
        if n + height > bits.shape[0]:
            places, bits = _longer(places, bits, n)
        for y in range(height):
            if line[y] != U0:
                places[n, 0], places[n, 1], bits[n] = y, w, line[y]
                starts[y + 1] += popcount(line[y])
                n += 1
    for y in range(height):
        starts[y + 1] += starts[y]
    edges, where = np.empty(starts[height], np.int64), starts.copy()
    for k in range(n):  # from the left, as each row's edges are to be
        y, left, turns = places[k, 0], 64 * np.int64(places[k, 1]), bits[k]
        while turns != U0:
            edges[where[y]] = left + lowest_bit(turns)
            where[y] += 1
            turns &= turns - U1
    return starts, edges


@njit
def edges_of_rows(rows):  # type: ignore[no-untyped-def]  # numba types it
    """`row_edges` of packed rows."""
    height, words = rows.shape
    starts, edges, n = np.zeros(height + 1, np.int64), np.empty(4 * height + 64, np.int64), 0
    for y in range(height):
        line, goes_on = rows[y], U0  # all bits, if the pixel before is solid
        if n + 64 * words + 1 > edges.shape[0]:
            longer = np.empty(2 * n + 64 * words + 1, np.int64)
            longer[:n] = edges[:n]
            edges = longer
        for w in range(words):
            here = line[w]
            if here == goes_on:
                continue
            turns = here ^ (here << U1) ^ (goes_on & U1)
            while turns != U0:
                edges[n] = 64 * w + lowest_bit(turns)
                n += 1
                turns &= turns - U1
            goes_on = ALL if here >> U63 != U0 else U0
        if goes_on != U0:
            edges[n] = 64 * words
            n += 1
        starts[y + 1] = n
    return starts, edges[:n]


@njit
def _runs_between(starts, edges, width, of_void):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 3) row, first, past the last of the runs of solid (or void) in rows with these edges."""
    height = starts.shape[0] - 1
    runs, n = np.empty((edges.shape[0] // 2 + (height if of_void else 0), 3), np.int64), 0
    for y in range(height):
        first = 0 if of_void else width
        for k in range(starts[y], starts[y + 1]):
            begins = (k - starts[y]) & 1 == (1 if of_void else 0)
            if begins:
                first = edges[k]
            elif edges[k] > first:
                runs[n, 0], runs[n, 1], runs[n, 2] = y, first, edges[k]
                n += 1
            if not begins:
                first = width
        if of_void and first < width:
            runs[n, 0], runs[n, 1], runs[n, 2] = y, first, width
            n += 1
    return runs[:n]


@njit
def root_of(parent, k):  # type: ignore[no-untyped-def]  # numba types it
    """The run that stands for the component of run k."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@njit
def joined_runs(starts, edges, width, of_void):  # type: ignore[no-untyped-def]  # numba types it
    """`label_runs` of rows with these edges."""
    runs = _runs_between(starts, edges, width, of_void)
    parent = np.empty(runs.shape[0], np.int64)
    reach = 0 if of_void else 1
    first, above, above_stop, count = 0, 0, 0, 0
    while first < runs.shape[0]:
        y, stop, k = runs[first, 0], first, above
        if above_stop and runs[above_stop - 1, 0] != y - 1:
            k = above_stop  # there is a row without runs between
        while stop < runs.shape[0] and runs[stop, 0] == y:
            parent[stop] = stop
            count += 1
            while k < above_stop and runs[k, 2] + reach <= runs[stop, 1]:
                k += 1
            j = k
            while j < above_stop and runs[j, 1] < runs[stop, 2] + reach:
                a, b = root_of(parent, stop), root_of(parent, j)
                if a != b:
                    parent[max(a, b)] = min(a, b)
                    count -= 1
                j += 1
            stop += 1
        above, above_stop, first = first, stop, stop
    return runs, parent, count


@njit(types.Tuple((RUNS, NUMBERS, types.int64))(WORK, types.boolean), cache=True, nogil=True)
def label_runs(columns, of_void):  # type: ignore[no-untyped-def]  # numba types it
    """Components of the solid (8-connected) or of the void (4-connected, with the border round the layer).

    Returns (runs (n, 3): row, first, past the last; for each run one of its component, that of the component's first
    run being itself; number of components).
    """
    starts, edges = row_edges(columns)
    return joined_runs(starts, edges, 64 * columns.shape[0], of_void)


@njit(types.Tuple((NUMBERS, RUNS))(RUNS, NUMBERS), cache=True, nogil=True)
def measured_parts(runs, parent):  # type: ignore[no-untyped-def]  # numba types it
    """What `label_runs` found, measured: ((n,) the number of each run's component; (components, 5): area, then left,
    top, right and bottom, the last two past the end)."""
    number = np.zeros(parent.shape[0], np.int64)
    count = 0
    for k in range(parent.shape[0]):
        if parent[k] == k:
            count += 1
    parts = np.zeros((count, 5), np.int64)
    count = 0
    for k in range(parent.shape[0]):
        y, first, stop = runs[k]
        if parent[k] == k:  # a component's first run comes before its others
            number[k] = count
            parts[count, LEFT], parts[count, TOP] = first, y
            count += 1
        i = number[root_of(parent, k)]
        number[k] = i
        parts[i, LEFT] = min(parts[i, LEFT], first)
        parts[i, RIGHT] = max(parts[i, RIGHT], stop)
        parts[i, BOTTOM] = y + 1
        parts[i, AREA] += stop - first
    return number, parts


@njit
def has_bit(columns, of_void, y, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """Whether row y has a set (or clear) bit in first … stop - 1."""
    w0, w1 = first >> 6, (stop - 1) >> 6
    for w in range(w0, w1 + 1):
        word = ~columns[w, y] if of_void else columns[w, y]
        if w == w0:
            word &= ~U0 << np.uint64(first & 63)
        if w == w1:
            word &= ~U0 >> np.uint64(63 - ((stop - 1) & 63))
        if word != U0:
            return True
    return False


@njit
def _each_holds(outer, inner, of_void):  # type: ignore[no-untyped-def]  # numba types it
    """Whether every component of the solid (or void) of `outer` has a pixel of that of `inner`."""
    runs, parent, _ = label_runs(outer, of_void)
    alive = np.zeros(parent.shape[0], np.bool_)
    for i in range(parent.shape[0]):
        root = root_of(parent, i)
        if not alive[root]:
            alive[root] = has_bit(inner, of_void, runs[i, 0], runs[i, 1], runs[i, 2])
    dead = 0
    for i in range(parent.shape[0]):
        dead += parent[i] == i and not alive[i]
    return dead == 0


@njit
def same_topology(solid, kept, parts, voids):  # type: ignore[no-untyped-def]  # numba types it
    """Whether kept ⊆ solid has one component in each of the solid's, and one void round each of its voids.

    parts, voids: how many components and voids the solid has.
    """
    return (
        label_runs(kept, False)[2] == parts
        and label_runs(kept, True)[2] == voids
        and _each_holds(solid, kept, False)
        and _each_holds(kept, solid, True)
    )


@njit(WORK(ROWS, types.int64), cache=True, nogil=True)
def _smaller_than(rows, area_px):  # type: ignore[no-untyped-def]  # numba types it
    out = np.zeros(rows.shape, np.uint64)
    outer = with_border(bounding_box(rows), 0, 0)
    runs, parent, _ = label_runs(to_columns(rows, outer), False)
    areas = np.zeros(parent.shape[0], np.int64)
    for k in range(parent.shape[0]):
        areas[root_of(parent, k)] += runs[k, 2] - runs[k, 1]
    for k in range(parent.shape[0]):
        if areas[root_of(parent, k)] < area_px:
            y, shift = runs[k, 0] + outer[0], 64 * outer[2]
            for x in range(runs[k, 1] + shift, runs[k, 2] + shift):
                out[y, x >> 6] |= U1 << np.uint64(x & 63)
    return out


def smaller_than(rows: Rows, area_px: float) -> Rows:
    """(H, words): the components (8-connected) of a packed layer that have fewer pixels than that."""
    if not rows.any():
        return np.zeros_like(rows)
    small: Rows = _smaller_than(rows, int(np.ceil(area_px)))
    return small


@njit
def _touches(rows, y, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """Whether packed rows have a bit in columns first - 1 … stop of rows y - 1 … y + 1."""
    width = 64 * rows.shape[1]
    a, b = max(first - 1, 0), min(stop, width - 1)
    for v in range(max(y - 1, 0), min(y + 2, rows.shape[0])):
        for w in range(a >> 6, (b >> 6) + 1):
            word = rows[v, w]
            if w == a >> 6:
                word &= ALL << np.uint64(a & 63)
            if w == b >> 6:
                word &= ALL >> np.uint64(63 - (b & 63))
            if word != U0:
                return True
    return False


@njit(RUNS(ROWS, ROWS), cache=True, nogil=True)
def _parts_apart(rows, other):  # type: ignore[no-untyped-def]  # numba types it
    """Parts of a layer that touch nothing of another: area and box, in the frame's pixels."""
    outer = with_border(bounding_box(rows), 0, 0)
    runs, parent, _ = label_runs(to_columns(rows, outer), False)
    number, parts = measured_parts(runs, parent)
    y0, x0 = outer[0], 64 * outer[2]
    touched = np.zeros(parts.shape[0], np.bool_)
    for k in range(runs.shape[0]):
        if not touched[number[k]]:
            touched[number[k]] = _touches(other, runs[k, 0] + y0, runs[k, 1] + x0, runs[k, 2] + x0)
    parts[:, LEFT] += x0
    parts[:, RIGHT] += x0
    parts[:, TOP] += y0
    parts[:, BOTTOM] += y0
    return parts[~touched]


def parts_apart(rows: Rows, other: Rows) -> NDArray[np.int64]:
    """(n, 5): area and box of the components (8-connected) of a packed layer that touch nothing of another."""
    found: NDArray[np.int64] = _parts_apart(rows, other)
    return found


@njit(types.UniTuple(NUMBERS, 2)(ROWS, NUMBERS, NUMBERS), cache=True, nogil=True)
def _components_at(rows, xs, ys):  # type: ignore[no-untyped-def]  # numba types it
    outer = with_border(bounding_box(rows), 0, 0)
    columns = to_columns(rows, outer)
    runs, parent, _ = label_runs(columns, False)
    areas = np.zeros(parent.shape[0], np.int64)
    first = np.zeros(columns.shape[1] + 1, np.int64)  # of each row's runs
    for k in range(parent.shape[0]):
        areas[root_of(parent, k)] += runs[k, 2] - runs[k, 1]
        first[runs[k, 0] + 1] = k + 1
    for y in range(columns.shape[1]):
        first[y + 1] = max(first[y + 1], first[y])
    found = np.zeros(xs.shape[0], np.int64)
    for i in range(xs.shape[0]):
        y, x = min(max(ys[i] - outer[0], 0), columns.shape[1] - 1), xs[i] - 64 * outer[2]
        nearest = np.int64(1) << 62
        for k in range(first[y], first[y + 1]):
            away = max(runs[k, 1] - x, x - runs[k, 2] + 1, 0)
            if away < nearest:
                nearest, found[i] = away, root_of(parent, k)
    return found, areas[areas > 0]


def components_at(
    rows: Rows, xs: NDArray[np.int64], ys: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which component (8-connected) of a packed layer some pixels belong to, and how large all of them are.

    xs, ys   (n,) columns and rows; a pixel that is not solid belongs to the nearest solid one of its row
    returns  ((n,) a number for each pixel, alike where the component is; (components,) pixels in each)
    """
    if not rows.any():
        return np.zeros(len(xs), np.int64), np.zeros(0, np.int64)
    found: tuple[NDArray[np.int64], NDArray[np.int64]] = _components_at(
        rows, np.ascontiguousarray(xs, np.int64), np.ascontiguousarray(ys, np.int64)
    )
    return found
