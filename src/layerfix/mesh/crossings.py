"""Where facets cross columns through pixels' centres, between two heights: what `layerfix.mesh.sheets` walks."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ALL, U0, lowest_bit
from layerfix.kernels import njit
from layerfix.mesh.facet_runs import MASKS, RUNS, SLOPES, run_within, run_z

Z_BITS = 30
KEYS = types.Array(types.int64, 1, "C")
SPAN = types.UniTuple(types.float64, 2)
SEEN = types.Array(types.uint64, 3, "C")


@njit
def _bits(w, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """Those of word w that are among first … stop - 1, of which it holds some."""
    bits = ALL
    if w == first >> 6:
        bits &= ALL << np.uint64(first & 63)
    if w == (stop - 1) >> 6:
        bits &= ALL >> np.uint64(63 - ((stop - 1) & 63))
    return bits


@njit
def longer(keys):  # type: ignore[no-untyped-def]  # numba types it
    """The same list with room for as many more."""
    longer = np.empty(2 * keys.shape[0], np.int64)
    for i in range(keys.shape[0]):
        longer[i] = keys[i]
    return longer


@njit(
    KEYS(RUNS, SLOPES, MASKS, types.int64, SPAN, SPAN, SPAN, types.boolean, types.int64, SEEN),
    cache=True,
    nogil=True,
)
def crossings(runs, slopes, masks, mine, scale, within, always, alike, width, seen):  # type: ignore[no-untyped-def]  # numba types it
    """Where runs of facets cross columns through centres `within` low < z ≤ high: pixel · 2^31 + place · 2 + (1 if
    the solid begins, upwards), where places are counted along the `scale`, which holds `within`.

    Only of pixels with a facet that faces up and one that faces down there (`alike`: with two of any kind), and of
    those with one between the heights `always`.

    masks  of each run; only those count that hold one of `mine`
    seen   (words, height, 2): two empty images, which will be empty again
    """
    (low, high), n = within, 0
    parts = np.empty((runs.shape[0], 3), np.int32)  # run, first column, past the last
    for r in range(runs.shape[0]):
        if masks[r] & mine == 0:
            continue
        j, down = runs[r, 0], np.int64(0 if alike else runs[r, 3])
        first, stop = run_within(slopes, r, low, high, runs[r, 1], runs[r, 2])
        if stop <= first:
            continue
        parts[n, 0], parts[n, 1], parts[n, 2] = r, first, stop
        n += 1
        for w in range(first >> 6, ((stop - 1) >> 6) + 1):
            bits = _bits(w, first, stop)
            if alike:
                seen[w, j, 1] |= seen[w, j, 0] & bits
            seen[w, j, down] |= bits
        if slopes[r, 3] > always[0] and slopes[r, 2] <= always[1]:
            first, stop = run_within(slopes, r, always[0], always[1], first, stop)
            if stop > first:
                for w in range(first >> 6, ((stop - 1) >> 6) + 1):
                    seen[w, j, 1] |= _bits(w, first, stop)
    keys, k = np.empty(256, np.int64), 0
    to_places = ((1 << Z_BITS) - 2) / (scale[1] - scale[0])
    for p in range(n):
        r, first, stop = parts[p]
        j = np.int64(runs[r, 0])
        for w in range(first >> 6, ((stop - 1) >> 6) + 1):
            bits = _bits(w, first, stop) & seen[w, j, 0] & seen[w, j, 1]
            while bits != U0:
                i = np.int64(w) * 64 + lowest_bit(bits)
                bits &= bits - np.uint64(1)
                place = np.int64((run_z(slopes, r, i) - scale[0]) * to_places) + 1
                place = min(max(place, np.int64(1)), np.int64((1 << Z_BITS) - 1))
                if k == keys.shape[0]:
                    keys = longer(keys)
                keys[k] = ((j * width + i) << (Z_BITS + 1)) | (place << 1) | np.int64(runs[r, 3])
                k += 1
    for p in range(n):
        r, first, stop = parts[p]
        for w in range(first >> 6, ((stop - 1) >> 6) + 1):
            seen[w, runs[r, 0], 0] = U0
            seen[w, runs[r, 0], 1] = U0
    return keys[:k].copy()
