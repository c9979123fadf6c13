"""Where facets cross columns through pixels' centres, between two heights: what `layerfix.mesh.sheets` walks.

A slab of some layers is looked through at once, row by row. Its heights are cut into intervals, at most 64; each
layer's window is some of them. A pixel counts in a window with a facet that faces up and one that faces down there.
Most have not: blocks of BLOCK pixels that a row's facets cross in no such way are left out first.
"""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import U0, U1, lowest_bit
from layerfix.kernels import njit
from layerfix.mesh.facet_runs import HEIGHTS, RUNS, SLOPES, run_z
from layerfix.mesh.fill import below

BLOCK = 8  # px
Z_BITS = 30
KEYS = types.Array(types.int64, 1, "C")
MASKS = types.Array(types.uint64, 1, "C")
SCALES = types.Array(types.float64, 2, "C")


@njit
def longer(keys):  # type: ignore[no-untyped-def]  # numba types it
    """The same list with room for as many more."""
    longer = np.empty(2 * keys.shape[0], np.int64)
    for i in range(keys.shape[0]):
        longer[i] = keys[i]
    return longer


@njit
def _longer(numbers):  # type: ignore[no-untyped-def]  # numba types it
    """The same of bytes."""
    longer = np.empty(2 * numbers.shape[0], np.uint8)
    longer[: numbers.shape[0]] = numbers
    return longer


@njit
def _in_rows(runs, height):  # type: ignore[no-untyped-def]  # numba types it
    """(starts, order): numbers of the runs of each row."""
    starts = np.zeros(height + 1, np.int64)
    for r in range(runs.shape[0]):
        starts[runs[r, 0] + 1] += 1
    for j in range(height):
        starts[j + 1] += starts[j]
    order, where = np.empty(runs.shape[0], np.int32), starts.copy()
    for r in range(runs.shape[0]):
        order[where[runs[r, 0]]] = r
        where[runs[r, 0]] += 1
    return starts, order


@njit
def _interval(edges, z, q):  # type: ignore[no-untyped-def]  # numba types it
    """The interval edges[q] < z ≤ edges[q + 1], looked for from the given one on; the ends take what lies beyond."""
    while q + 2 < edges.shape[0] and z > edges[q + 1]:
        q += 1
    while q > 0 and z <= edges[q]:
        q -= 1
    return q


@njit
def _add(lines, i, side, windows, anyway, alike):  # type: ignore[no-untyped-def]  # numba types it
    """Note a facet in these windows, in some of which that is enough."""
    if alike:
        lines[1, i] |= (lines[0, i] & windows) | anyway
        lines[0, i] |= windows
    else:
        lines[side, i] |= windows


@njit
def _counting(lines, i, alike):  # type: ignore[no-untyped-def]  # numba types it
    """The windows in which a pixel, or one of a block, counts by what was noted."""
    return lines[1, i] if alike else lines[0, i] & lines[1, i]


@njit
def _mark_blocks(mine, runs, slopes, edges, windows, anyway, alike, blocks, marked, touched):  # type: ignore[no-untyped-def]  # numba types it
    """Mark those blocks of a row in which pixels may count, and write them to `touched`. Returns how many there are.

    blocks  (2, n), 0, and will be again
    """
    n = 0
    for r in mine:
        first, stop, side = runs[r, 1], runs[r, 2], np.int64(runs[r, 3])
        begin, end = first // BLOCK, (stop - 1) // BLOCK + 1
        z = run_z(slopes, r, first)
        q = _interval(edges, z, max(below(edges, z) - 1, 0))
        for u in range(begin, end):
            p = _interval(edges, run_z(slopes, r, min(stop, (u + 1) * BLOCK) - 1), q)
            mine_here, enough = U0, U0
            for e in range(min(p, q), max(p, q) + 1):
                mine_here |= windows[e]
                enough |= anyway[e]
            if mine_here != U0:
                if blocks[0, u] | blocks[1, u] == U0:
                    touched[n] = u
                    n += 1
                _add(blocks, u, side, mine_here, enough, alike)
            q = _interval(edges, run_z(slopes, r, (u + 1) * BLOCK), p) if u + 1 < end else p
    return _still_marked(touched[:n], blocks, 1, alike, marked)


@njit
def _still_marked(touched, noted, each, alike, marked):  # type: ignore[no-untyped-def]  # numba types it
    """Mark those of some blocks in which something counts, put them first, and return how many there are.

    noted  (2, n) what was noted of each of a block's `each` places; then the windows in which it counts, and 0
    """
    kept = 0
    for k in range(touched.shape[0]):
        u = touched[k]
        marked[u] = False
        for i in range(u * each, (u + 1) * each):
            noted[0, i] = _counting(noted, i, alike)
            noted[1, i] = U0
            marked[u] |= noted[0, i] != U0
            if each == 1:
                noted[0, i] = U0
        if marked[u]:
            touched[kept] = u
            kept += 1
    return kept


@njit
def _note_pixels(mine, runs, slopes, edges, windows, anyway, alike, marked, lines):  # type: ignore[no-untyped-def]  # numba types it
    """Note in which windows facets are over each pixel of the marked blocks of a row."""
    for r in mine:
        first, stop, side, q = runs[r, 1], runs[r, 2], np.int64(runs[r, 3]), 0
        for u in range(first // BLOCK, (stop - 1) // BLOCK + 1):
            if not marked[u]:
                continue
            for i in range(max(first, u * BLOCK), min(stop, (u + 1) * BLOCK)):
                q = _interval(edges, run_z(slopes, r, i), q)
                _add(lines, i, side, windows[q], anyway[q], alike)


@njit
def _place(z, low, factor):  # type: ignore[no-untyped-def]  # numba types it
    return min(max(np.int64((z - low) * factor) + 1, np.int64(1)), np.int64((1 << Z_BITS) - 1))


@njit
def _by_intervals(masks, count):  # type: ignore[no-untyped-def]  # numba types it
    """Of each of `count` intervals a mask of the windows that hold it; masks: of each window, of intervals."""
    out = np.zeros(count, np.uint64)
    for k in range(masks.shape[0]):
        for q in range(count):
            out[q] |= ((masks[k] >> np.uint64(q)) & U1) << np.uint64(k)
    return out


@njit(
    types.Tuple((types.Array(types.int64, 1, "C"), KEYS))(
        RUNS, SLOPES, HEIGHTS, MASKS, MASKS, SCALES, types.boolean, types.int64, types.int64
    ),
    cache=True,
    nogil=True,
)
def crossings(runs, slopes, edges, within, always, scales, alike, width, height):  # type: ignore[no-untyped-def]  # numba types it
    """(starts, keys) of n windows: keys[starts[k] : starts[k + 1]] say where facets cross columns in the k-th, row by
    row: pixel · 2^31 + place · 2 + (1 if the solid begins, upwards), places counted along the window's scale.

    Only of pixels with a facet that faces up and one that faces down in the window; alike: with two of any kind, or
    with one in the intervals that `always` has of the window.

    edges   of intervals edges[q] < z ≤ edges[q + 1], at most 64, with all that the runs hold
    within  masks of the intervals of each window, of at most 64
    scales  (n, 2) of each window: its least and greatest height
    """
    windows = _by_intervals(within, edges.shape[0] - 1)
    anyway = _by_intervals(always, edges.shape[0] - 1)
    blocks_of_row = (width + BLOCK - 1) // BLOCK
    blocks, marked = np.zeros((2, blocks_of_row), np.uint64), np.zeros(blocks_of_row, np.bool_)
    lines, touched = np.zeros((2, blocks_of_row * BLOCK), np.uint64), np.empty(blocks_of_row, np.int64)
    starts, order = _in_rows(runs, height)
    keys, of_window, n = np.empty(256, np.int64), np.empty(256, np.uint8), 0
    counts, factors = np.zeros(within.shape[0] + 1, np.int64), ((1 << Z_BITS) - 2) / (scales[:, 1] - scales[:, 0])
    for j in range(height):
        mine = order[starts[j] : starts[j + 1]]
        if mine.shape[0] == 0:
            continue
        count = _mark_blocks(mine, runs, slopes, edges, windows, anyway, alike, blocks, marked, touched)
        if count > 0:
            _note_pixels(mine, runs, slopes, edges, windows, anyway, alike, marked, lines)
            count = _still_marked(touched[:count], lines, BLOCK, alike, marked)
        if count == 0:
            continue
        for r in mine:
            q = 0
            for u in range(runs[r, 1] // BLOCK, (runs[r, 2] - 1) // BLOCK + 1):
                if not marked[u]:
                    continue
                for i in range(max(runs[r, 1], u * BLOCK), min(runs[r, 2], (u + 1) * BLOCK)):
                    if lines[0, i] == U0:
                        continue
                    z = run_z(slopes, r, i)
                    q = _interval(edges, z, q)
                    found = lines[0, i] & windows[q]
                    while found != U0:
                        k = lowest_bit(found)
                        found &= found - U1
                        if n == keys.shape[0]:
                            keys, of_window = longer(keys), _longer(of_window)
                        place = _place(z, scales[k, 0], factors[k])
                        keys[n] = ((j * width + i) << (Z_BITS + 1)) | (place << 1) | np.int64(runs[r, 3])
                        of_window[n] = k
                        counts[k + 1] += 1
                        n += 1
        for u in touched[:count]:
            marked[u] = False
            lines[0, u * BLOCK : (u + 1) * BLOCK] = U0
    for k in range(within.shape[0]):
        counts[k + 1] += counts[k]
    if within.shape[0] == 1:
        return counts, keys[:n]
    out, where = np.empty(n, np.int64), counts.copy()
    for i in range(n):
        out[where[of_window[i]]] = keys[i]
        where[of_window[i]] += 1
    return counts, out
