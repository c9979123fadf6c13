"""Kernels on distance fields: thresholds to packed bits, balls, thicknesses, the half spacings of a ring.

A field is (H, W) float32, its border pixels negative. Points are (x, y) in px, pixel (row j, column i) has its
centre at (i, j), and y points down. The kernels check nothing.
"""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, lowest_bit, popcount
from layerfix.kernels import njit

FIELD = types.Array(types.float32, 2, "C", readonly=True)
MUTABLE_FIELD = types.Array(types.float32, 2, "C")
POINTS = types.Array(types.float64, 2, "C")
STARTS = types.Array(types.int64, 1, "C")
INDICES = types.Array(types.int64, 1, "A")
ROWS_OUT = types.Array(types.uint64, 2, "C")
INDEX_LIST = types.Array(types.int64, 1, "C")
LEAST_MM = np.float32(1e-3)
BESIDE_MM = np.float32(-0.05)
NO_LEVEL = np.float32(1e9)  # higher than any distance: where no loop is wanted
VALUES = types.Array(types.float32, 1, "C")


@njit(ROWS_OUT(FIELD, types.float32), cache=True, nogil=True)
def bits_above(field, level):  # type: ignore[no-untyped-def]  # numba types it
    """Packed rows of the pixels where the field is above a level; the width is a multiple of 64."""
    height, words = field.shape[0], field.shape[1] // 64
    out = np.zeros((height, words), np.uint64)
    for y in range(height):
        for w in range(words):
            word = U0
            line = field[y, 64 * w : 64 * w + 64]
            for x in range(64):
                word |= np.uint64(line[x] > level) << np.uint64(x)
            out[y, w] = word
    return out


@njit(ROWS_OUT(FIELD, FIELD, ROWS, types.float32, types.float32), cache=True, nogil=True)
def bits_unexplained(remaining, local, thick, least, slack):  # type: ignore[no-untyped-def]  # numba types it
    """Packed rows of the pixels that are deeper than `least` and than the thickness known there allows, by `slack`,
    and not thick (packed)."""
    height, words = remaining.shape[0], remaining.shape[1] // 64
    out = np.zeros((height, words), np.uint64)
    for y in range(height):
        for w in range(words):
            word = U0
            line, known = remaining[y, 64 * w : 64 * w + 64], local[y, 64 * w : 64 * w + 64]
            for x in range(64):
                word |= np.uint64(line[x] > least and 2 * line[x] > known[x] + slack) << np.uint64(x)
            out[y, w] = word & ~thick[y, w]
    return out


@njit(types.Tuple((INDEX_LIST, INDEX_LIST))(ROWS), cache=True, nogil=True)
def pixels_of(rows):  # type: ignore[no-untyped-def]  # numba types it
    """(rows, columns) of all set bits."""
    count = 0
    for y in range(rows.shape[0]):
        for w in range(rows.shape[1]):
            if rows[y, w] != U0:
                count += popcount(rows[y, w])
    ys, xs = np.empty(count, np.int64), np.empty(count, np.int64)
    n = 0
    for y in range(rows.shape[0]):
        for w in range(rows.shape[1]):
            word = rows[y, w]
            while word != U0:
                ys[n], xs[n] = y, w * 64 + lowest_bit(word)
                word &= word - U1
                n += 1
    return ys, xs


@njit(ROWS_OUT(FIELD, FIELD), cache=True, nogil=True)
def bits_higher(field, level):  # type: ignore[no-untyped-def]  # numba types it
    """Packed rows of the pixels where a field is above another; the width is a multiple of 64."""
    height, words = field.shape[0], field.shape[1] // 64
    out = np.zeros((height, words), np.uint64)
    for y in range(height):
        for w in range(words):
            word = U0
            line, limit = field[y, 64 * w : 64 * w + 64], level[y, 64 * w : 64 * w + 64]
            for x in range(64):
                word |= np.uint64(line[x] > limit[x]) << np.uint64(x)
            out[y, w] = word
    return out


@njit(
    types.void(MUTABLE_FIELD, FIELD, ROWS, types.float32, types.float32, types.float32),
    cache=True,
    nogil=True,
)
def half_spacings(half, local, thick, one, two, elsewhere):  # type: ignore[no-untyped-def]  # numba types it
    """half = half the spacing of the ring's bead: `elsewhere` where it is thick or nothing is known; where the
    thickness `local` is under `one` no loop fits; up to `two` it holds two beads, else three."""
    for y in range(half.shape[0]):
        for w in range(thick.shape[1]):
            word, line, known = thick[y, w], half[y, 64 * w : 64 * w + 64], local[y, 64 * w : 64 * w + 64]
            if word == ~U0:
                line[:] = elsewhere
                continue
            for x in range(64):
                value = known[x]
                fitting = value / 4 if value <= two else value / 6
                fitting = NO_LEVEL if value < one else fitting
                line[x] = elsewhere if value == 0 else fitting
            if word != U0:
                for x in range(64):
                    if (word >> np.uint64(x)) & U1:
                        line[x] = elsewhere


@njit(types.void(MUTABLE_FIELD, FIELD, ROWS), cache=True, nogil=True)
def take_off(remaining, half, keep):  # type: ignore[no-untyped-def]  # numba types it
    """remaining -= 2 · half, but for the pixels of `keep` (packed)."""
    for y in range(half.shape[0]):
        for w in range(keep.shape[1]):
            word, line, less = keep[y, w], remaining[y, 64 * w : 64 * w + 64], half[y, 64 * w : 64 * w + 64]
            if word == U0:
                for x in range(64):
                    line[x] -= 2 * less[x]
            elif word != ~U0:
                for x in range(64):
                    if not (word >> np.uint64(x)) & U1:
                        line[x] -= 2 * less[x]


@njit(
    MUTABLE_FIELD(FIELD, FIELD, ROWS, VALUES, types.float32),
    cache=True,
    nogil=True,
    fastmath={"nnan", "nsz", "reassoc", "contract"},
)
def smoothed(field, level, where, weights, reach):  # type: ignore[no-untyped-def]  # numba types it
    """The field, blurred in the pixels of `where` (packed) that lie within `reach` of the level: elsewhere blurring
    cannot tell on which side of it they are.

    weights: (n,) of the pixel itself and those ever farther away, along both axes; n ≤ 64. The border words of
    `where` are empty
    """
    out, height, taps = field.copy(), field.shape[0], weights.shape[0]
    strip, blurred = np.empty(62 + 2 * taps, np.float32), np.empty(64, np.float32)
    for y in range(height):
        for w in range(where.shape[1]):
            word = where[y, w]
            if word == U0:
                continue
            line, limit = field[y, 64 * w : 64 * w + 64], level[y, 64 * w : 64 * w + 64]
            new, nearest = out[y, 64 * w : 64 * w + 64], reach
            for x in range(64):
                nearest = min(nearest, abs(line[x] - limit[x]))
            if nearest >= reach:
                continue
            first, stop = 64 * w + 1 - taps, 64 * w + 63 + taps
            here = field[y, first:stop]
            for x in range(strip.shape[0]):
                strip[x] = weights[0] * here[x]
            for k in range(1, taps):
                above, under, weight = (
                    field[max(y - k, 0), first:stop],
                    field[min(y + k, height - 1), first:stop],
                    weights[k],
                )
                for x in range(strip.shape[0]):
                    strip[x] += weight * (above[x] + under[x])
            middle = strip[taps - 1 : taps + 63]
            for x in range(64):
                blurred[x] = weights[0] * middle[x]
            for k in range(1, taps):
                left, right = strip[taps - 1 - k : taps + 63 - k], strip[taps - 1 + k : taps + 63 + k]
                weight = weights[k]
                for x in range(64):
                    blurred[x] += weight * (left[x] + right[x])
            for x in range(64):
                new[x] = blurred[x] if (word >> np.uint64(x)) & U1 else line[x]
    return out


@njit(MUTABLE_FIELD(FIELD, ROWS, types.float32), cache=True, nogil=True)
def field_within(field, where, level):  # type: ignore[no-untyped-def]  # numba types it
    """The field less `level` on the pixels of `where` (packed), elsewhere -1, but BESIDE_MM where the field is above
    `level`: there is another region, which short ways may cross, and not the edge."""
    out = np.empty(field.shape, np.float32)
    for y in range(field.shape[0]):
        for x in range(field.shape[1]):
            if (where[y, x >> 6] >> np.uint64(x & 63)) & U1:
                out[y, x] = field[y, x] - level
            else:
                out[y, x] = BESIDE_MM if field[y, x] > level else np.float32(-1)
    return out


@njit(types.void(MUTABLE_FIELD, INDICES, INDICES, VALUES, VALUES), cache=True, nogil=True)
def paint_balls(field, rows, columns, radii_px, values):  # type: ignore[no-untyped-def]  # numba types it
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


@njit(types.void(MUTABLE_FIELD, ROWS, INDEX_LIST, INDEX_LIST, VALUES, types.float64), cache=True, nogil=True)
def paint_ends(field, skeleton, rows, columns, values, radius_px):  # type: ignore[no-untyped-def]  # numba types it
    """field = the value at each end of the skeleton (packed) round it, where it is still 0.

    The skeleton ends that far from the tip of the place, because its ends were shortened.
    """
    height, width = field.shape
    reach = int(radius_px) + 1
    for k in range(rows.shape[0]):
        y, x = rows[k], columns[k]
        neighbours = 0
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if (skeleton[y + dy, (x + dx) >> 6] >> np.uint64((x + dx) & 63)) & U1:
                    neighbours += 1
        if neighbours > 2:  # itself, too
            continue
        for j in range(max(y - reach, 0), min(y + reach + 1, height)):
            half = int(np.sqrt(max(reach * reach - (j - y) ** 2, 0.0)))
            for i in range(max(x - half, 0), min(x + half + 1, width)):
                if field[j, i] == 0:
                    field[j, i] = values[k]


@njit(MUTABLE_FIELD(FIELD, ROWS, INDEX_LIST, INDEX_LIST), cache=True, nogil=True)
def middles(remaining, skeleton, rows, columns):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 3): thickness at pixels of the skeleton (packed), and how far the middle lies beside them, x and y, all in
    the unit of `remaining`, the distance to the edge.

    The thickness is twice the distance at the middle. A pixel that is t beside the middle has t less; across the
    place one neighbour is then 2 t higher than the one opposite, along any other axis less. Neighbours on the
    skeleton are not across.
    """
    out = np.zeros((rows.shape[0], 3), np.float32)
    for k in range(rows.shape[0]):
        y, x = rows[k], columns[k]
        beside = np.float32(0)
        for dx, dy in ((1, 0), (1, 1), (0, 1), (-1, 1)):
            on = (skeleton[y + dy, (x + dx) >> 6] >> np.uint64((x + dx) & 63)) & U1
            on |= (skeleton[y - dy, (x - dx) >> 6] >> np.uint64((x - dx) & 63)) & U1
            higher = (remaining[y + dy, x + dx] - remaining[y - dy, x - dx]) / 2
            if not on and abs(higher) > beside:
                beside = abs(higher)
                length = np.float32(np.sqrt(dx * dx + dy * dy))
                out[k, 1], out[k, 2] = higher * dx / length, higher * dy / length
        out[k, 0] = 2 * (remaining[y, x] + beside)
    return out
