"""Where facets cross columns through pixels' centres, between two heights: what `layerfix.mesh.sheets` walks along.

Coordinates are the cutter's: column, row, z quanta. A facet covers the centres that `fill` would give it: half-open
along the row and across it, so neighbours never both claim a centre and never leave one out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.bits import ALL, U0, U1, lowest_bit
from layerfix.kernels import njit
from layerfix.mesh.near_facets import INDICES, MASKS, POINTS, TRIANGLES, area_of, longer_table, rows_of

Z_BITS = 30
KEYS = types.Array(types.int64, 1, "C")
SPAN = types.UniTuple(types.float64, 2)
SEEN = types.Array(types.uint64, 3, "C")
RUNS = types.Array(types.int32, 2, "C")


@njit
def _slope(points, p, q):  # type: ignore[no-untyped-def]
    dy = points[q, 1] - points[p, 1]
    return (points[q, 0] - points[p, 0]) / dy if dy != 0 else 0.0


@njit
def _by_rows(points, a, b, c):  # type: ignore[no-untyped-def]
    """The corners of a facet, from the first row to the last."""
    if points[b, 1] < points[a, 1]:
        a, b = b, a
    if points[c, 1] < points[b, 1]:
        b, c = c, b
        if points[b, 1] < points[a, 1]:
            a, b = b, a
    return a, b, c


@njit
def _within(at_row, gx, per_z, z0, z1, low, high, first, stop):  # type: ignore[no-untyped-def]
    """Of a facet's centres first … stop - 1 in a row those in low < z ≤ high; z is at_row + gx · column, and per_z is
    1 / gx, or 0 if that is not to be used."""
    if per_z != 0 and stop - first > 2:
        one, other = (low - at_row) * per_z, (high - at_row) * per_z
        first = max(first, math.ceil(min(max(min(one, other), -1.0), stop) - 0.01))
        stop = min(stop, math.floor(max(min(max(one, other), stop), -1.0) + 0.01) + 1)
    while first < stop and not low < min(max(at_row + gx * first, z0), z1) <= high:
        first += 1
    while first < stop and not low < min(max(at_row + gx * (stop - 1), z0), z1) <= high:
        stop -= 1
    return first, stop


@njit
def _bits(w, first, stop):  # type: ignore[no-untyped-def]
    """Those of word w that are among first … stop - 1, of which it holds some."""
    bits = ALL
    if w == first >> 6:
        bits &= ALL << np.uint64(first & 63)
    if w == (stop - 1) >> 6:
        bits &= ALL >> np.uint64(63 - ((stop - 1) & 63))
    return bits


@njit
def longer(keys):  # type: ignore[no-untyped-def]
    """The same list with room for as many more."""
    longer = np.empty(2 * keys.shape[0], np.int64)
    for i in range(keys.shape[0]):
        longer[i] = keys[i]
    return longer


@njit
def _plane(points, a, b, c):  # type: ignore[no-untyped-def]
    """(gx, gy): how z changes along x and y."""
    xa, ya, za, area = points[a, 0], points[a, 1], points[a, 2], area_of(points, a, b, c)
    ux, uy, uz = points[b, 0] - xa, points[b, 1] - ya, points[b, 2] - za
    vx, vy, vz = points[c, 0] - xa, points[c, 1] - ya, points[c, 2] - za
    return (uz * vy - vz * uy) / area, (ux * vz - vx * uz) / area


@njit
def _keys_of(points, faces, chosen, runs, low, high, width, seen):  # type: ignore[no-untyped-def]
    """The crossings of runs over the pixels that both images of `seen` hold."""
    keys, k = np.empty(256, np.int64), 0
    scale = ((1 << Z_BITS) - 2) / (high - low)
    for r in range(runs.shape[0]):
        p, j, first, stop = runs[r]
        for w in range(first >> 6, ((stop - 1) >> 6) + 1):
            bits = _bits(w, first, stop) & seen[w, j, 0] & seen[w, j, 1]
            if bits == U0:
                continue
            a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
            za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
            z0, z1 = min(za, zb, zc), max(za, zb, zc)
            begins = np.int64(area_of(points, a, b, c) > 0)
            gx, gy = _plane(points, a, b, c)
            at_row = za + gy * (j - points[a, 1]) - gx * points[a, 0]
            while bits != U0:
                i = np.int64(w) * 64 + lowest_bit(bits)
                bits &= bits - U1
                z = min(max(at_row + gx * i, z0), z1)
                place = np.int64((z - low) * scale) + 1
                place = min(max(place, np.int64(1)), np.int64((1 << Z_BITS) - 1))
                if k == keys.shape[0]:
                    keys = longer(keys)
                keys[k] = ((np.int64(j) * width + i) << (Z_BITS + 1)) | (place << 1) | begins
                k += 1
    return keys[:k].copy()


@njit(
    types.Tuple((KEYS, RUNS))(
        POINTS, TRIANGLES, INDICES, MASKS, types.int64, SPAN, SPAN, SPAN, types.boolean, types.int64, SEEN, RUNS,
    ),
    cache=True,
    nogil=True,
)  # fmt: skip
def crossings(points, faces, chosen, intervals, mine, scale, within, always, alike, width, seen, runs):  # type: ignore[no-untyped-def]
    """Where facets cross columns through centres `within` low < z ≤ high: pixel · 2^31 + place · 2 + (1 if the solid
    begins, upwards), where places are counted along the `scale`, which holds `within`.

    Only of pixels with a facet that faces up and one that faces down there (`alike`: with two of any kind), and of
    those with one between the heights `always`.

    intervals  of each facet, a mask; only those count that hold one of `mine` and are paired in it. 0: all do
    seen       (words, height, 2): two empty images, which will be empty again
    runs       a table to work in, which is returned, too: longer, if it was too short
    """
    height, n, (low, high) = seen.shape[1], 0, within
    for p in range(chosen.shape[0]):
        if mine and intervals[p] & mine == 0:
            continue
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        xa, ya, za = points[a, 0], points[a, 1], points[a, 2]
        z0, z1 = min(za, points[b, 2], points[c, 2]), max(za, points[b, 2], points[c, 2])
        if z0 > high or z1 <= low:
            continue
        top, middle, bottom = _by_rows(points, a, b, c)
        x_top, y_top, x_middle, y_middle = points[top, 0], points[top, 1], points[middle, 0], points[middle, 1]
        j_middle = math.ceil(y_middle)
        whole = z0 > low and z1 <= high
        j0, j1 = max(math.ceil(y_top), 0), min(math.ceil(points[bottom, 1]), height)
        if not whole:
            j0, j1 = rows_of(points, a, b, c, low, high, j0, j1)
        if j0 >= j1:
            continue
        gx, gy = _plane(points, a, b, c)
        per_z = 1 / gx if abs(gx) > 1e-9 else 0.0
        down = np.int64(0 if alike else area_of(points, a, b, c) > 0)
        near = z1 > always[0] and z0 <= always[1]
        long, upper, lower = _slope(points, top, bottom), _slope(points, top, middle), _slope(points, middle, bottom)
        for j in range(j0, j1):
            one = math.ceil(x_top + (j - y_top) * long)
            other = math.ceil(x_top + (j - y_top) * upper if j < j_middle else x_middle + (j - y_middle) * lower)
            first, stop = max(min(one, other), 0), min(max(one, other), width)
            if stop <= first:
                continue
            at_row = za + gy * (j - ya) - gx * xa
            if not whole:
                first, stop = _within(at_row, gx, per_z, z0, z1, low, high, first, stop)
                if stop <= first:
                    continue
            if n == runs.shape[0]:
                runs = longer_table(runs)
            runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3] = p, j, first, stop
            n += 1
            for w in range(first >> 6, ((stop - 1) >> 6) + 1):
                bits = _bits(w, first, stop)
                if alike:
                    seen[w, j, 1] |= seen[w, j, 0] & bits
                seen[w, j, down] |= bits
            if near:
                first, stop = _within(at_row, gx, per_z, z0, z1, always[0], always[1], first, stop)
                if stop > first:
                    for w in range(first >> 6, ((stop - 1) >> 6) + 1):
                        seen[w, j, 1] |= _bits(w, first, stop)
    keys = _keys_of(points, faces, chosen, runs[:n], scale[0], scale[1], width, seen)
    for r in range(n):
        for w in range(runs[r, 2] >> 6, ((runs[r, 3] - 1) >> 6) + 1):
            seen[w, runs[r, 1], 0] = U0
            seen[w, runs[r, 1], 1] = U0
    return keys, runs
