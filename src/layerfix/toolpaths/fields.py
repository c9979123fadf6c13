"""Kernels on distance fields: level sets as loops, balls, one-pixel lines as chains, simplification.

A field is (H, W) float32, its border pixels negative. Points are (x, y) in px, pixel (row j, column i) has its
centre at (i, j), and y points down. The kernels check nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types

from layerfix.bits import ROWS, U0, U1, lowest_bit, popcount

FIELD = types.Array(types.float32, 2, "C", readonly=True)
MUTABLE_FIELD = types.Array(types.float32, 2, "C")
MASK = types.Array(types.uint8, 2, "C")
POINTS = types.Array(types.float64, 2, "C")
STARTS = types.Array(types.int64, 1, "C")
INDICES = types.Array(types.int64, 1, "A")
ROWS_OUT = types.Array(types.uint64, 2, "C")
INDEX_LIST = types.Array(types.int64, 1, "C")
NO_LEVEL = np.float32(1e9)  # higher than any distance: where no loop is wanted
VALUES = types.Array(types.float32, 1, "C")


@njit(ROWS_OUT(FIELD, types.float32), cache=True, nogil=True)
def bits_above(field, level):  # type: ignore[no-untyped-def]
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


@njit(types.Tuple((INDEX_LIST, INDEX_LIST))(ROWS), cache=True, nogil=True)
def pixels_of(rows):  # type: ignore[no-untyped-def]
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


@njit
def _more_room(pairs):  # type: ignore[no-untyped-def]
    wider = np.empty((2 * pairs.shape[0], 2), np.int64)
    wider[: pairs.shape[0]] = pairs
    return wider


@njit
def _crossings(field, shift):  # type: ignore[no-untyped-def]
    """Marching squares: (n, 2) pixel edges by which the level set enters a cell, and by which it leaves it.

    Edge 2 (y W + x) lies between pixel (y, x) and the one to its right, the next number below it. What is above 0
    lies to the left of the way. Saddles join what is above 0 if their middle is.
    """
    height, width = field.shape
    pairs, n = np.empty((4096, 2), np.int64), 0
    for y in range(height - 1):
        upper, lower, shift_upper, shift_lower = field[y], field[y + 1], shift[y], shift[y + 1]
        nw, sw = upper[0] > shift_upper[0], lower[0] > shift_lower[0]
        for x in range(width - 1):
            ne, se = upper[x + 1] > shift_upper[x + 1], lower[x + 1] > shift_lower[x + 1]
            case = nw | (ne << 1) | (se << 2) | (sw << 3)
            nw, sw = ne, se
            if case == 0 or case == 15:
                continue
            if n + 2 > pairs.shape[0]:
                pairs = _more_room(pairs)
            top = 2 * (y * width + x)
            left, bottom, right = top + 1, top + 2 * width, top + 3
            if case == 5 or case == 10:
                middle = upper[x] + upper[x + 1] + lower[x] + lower[x + 1]
                joined = middle > shift_upper[x] + shift_upper[x + 1] + shift_lower[x] + shift_lower[x + 1]
                if case == 5:
                    pairs[n, 0], pairs[n, 1] = left, bottom if joined else top
                    pairs[n + 1, 0], pairs[n + 1, 1] = right, top if joined else bottom
                else:
                    pairs[n, 0], pairs[n, 1] = top, left if joined else right
                    pairs[n + 1, 0], pairs[n + 1, 1] = bottom, right if joined else left
                n += 2
                continue
            if case == 1 or case == 3 or case == 7:
                pairs[n, 0] = left
            elif case == 2 or case == 6 or case == 14:
                pairs[n, 0] = top
            elif case == 4 or case == 12 or case == 13:
                pairs[n, 0] = right
            else:
                pairs[n, 0] = bottom
            if case == 1 or case == 9 or case == 13:
                pairs[n, 1] = top
            elif case == 2 or case == 3 or case == 11:
                pairs[n, 1] = right
            elif case == 4 or case == 6 or case == 7:
                pairs[n, 1] = bottom
            else:
                pairs[n, 1] = left
            n += 1
    return pairs[:n]


@njit(types.Tuple((POINTS, STARTS))(FIELD, FIELD), cache=True, nogil=True)
def level_loops(field, level):  # type: ignore[no-untyped-def]
    """Where a field is as high as `level`, itself a field, as closed loops round what is higher: (n, 3) x, y and the
    level there, and the starts of the loops in it. Seen with y down, what is higher lies to the left of the way."""
    width = field.shape[1]
    pairs = _crossings(field, level)
    count = pairs.shape[0]
    order = np.argsort(pairs[:, 0])
    entered = pairs[order, 0]
    following = np.searchsorted(entered, pairs[order, 1])
    points, starts = np.empty((count, 3)), np.zeros(count + 1, np.int64)
    n, loops = 0, 0
    for first in range(count):
        k = first
        if following[k] < 0:
            continue
        while following[k] >= 0:
            pixel = entered[k] >> 1
            y, x = pixel // width, pixel % width
            y2, x2 = (y + 1, x) if entered[k] & 1 else (y, x + 1)
            a, b = field[y, x] - level[y, x], field[y2, x2] - level[y2, x2]
            t = a / (a - b)
            points[n, 0] = x + t * (x2 - x)
            points[n, 1] = y + t * (y2 - y)
            low, high = level[y, x], level[y2, x2]  # a level no field reaches is no width of a bead
            points[n, 2] = min(low, high) if max(low, high) > NO_LEVEL / 2 else low + t * (high - low)
            n += 1
            onwards = following[k]
            following[k] = -1
            k = onwards
        loops += 1
        starts[loops] = n
    return points[:n], starts[: loops + 1].copy()


@njit(
    types.void(MUTABLE_FIELD, FIELD, ROWS, types.float32, types.float32, types.float32, types.float32),
    cache=True,
    nogil=True,
)
def half_spacings(half, local, thick, usual, one, two, elsewhere):  # type: ignore[no-untyped-def]
    """half = half the spacing of the ring's bead: `elsewhere` where it is thick or nothing is known; where the
    thickness `local` is under `one` no loop fits; up to `two` it holds two beads, else three."""
    for y in range(half.shape[0]):
        for x in range(half.shape[1]):
            value = local[y, x]
            if value == 0 or (thick[y, x >> 6] >> np.uint64(x & 63)) & U1:
                half[y, x] = elsewhere
            elif value < one:
                half[y, x] = NO_LEVEL
            else:
                half[y, x] = value / 4 if value <= two else value / 6


@njit(types.void(MUTABLE_FIELD, FIELD, ROWS), cache=True, nogil=True)
def take_off(remaining, half, keep):  # type: ignore[no-untyped-def]
    """remaining -= 2 · half, but for the pixels of `keep` (packed)."""
    for y in range(half.shape[0]):
        for x in range(half.shape[1]):
            if not (keep[y, x >> 6] >> np.uint64(x & 63)) & U1:
                remaining[y, x] -= 2 * half[y, x]


@njit(MUTABLE_FIELD(FIELD, ROWS, types.float32), cache=True, nogil=True)
def field_within(field, where, level):  # type: ignore[no-untyped-def]
    """The field less `level` on the pixels of `where` (packed), -1 elsewhere."""
    out = np.empty(field.shape, np.float32)
    for y in range(field.shape[0]):
        for x in range(field.shape[1]):
            inside = (where[y, x >> 6] >> np.uint64(x & 63)) & U1
            out[y, x] = field[y, x] - level if inside else np.float32(-1)
    return out


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


@njit(VALUES(FIELD, ROWS, INDEX_LIST, INDEX_LIST, types.float32), cache=True, nogil=True)
def thickness_mm(remaining, skeleton, rows, columns, pixel_mm):  # type: ignore[no-untyped-def]
    """(n,) thickness at pixels of the skeleton (packed), from the distance to the edge.

    Twice the distance, but where the middle lies between two pixels: then the two distances and the step between
    them. Only neighbours off the skeleton can be across, those on it are along.
    """
    out = np.empty(rows.shape[0], np.float32)
    for k in range(rows.shape[0]):
        y, x = rows[k], columns[k]
        here = remaining[y, x]
        best = 2 * here
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                beside = remaining[y + dy, x + dx]
                on_it = (skeleton[y + dy, (x + dx) >> 6] >> np.uint64((x + dx) & 63)) & U1
                if beside > 0 and not on_it:
                    best = max(best, here + beside + np.float32(np.sqrt(dx * dx + dy * dy)) * pixel_mm)
        out[k] = best
    return out


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


@njit(types.Tuple((POINTS, STARTS))(MASK, INDEX_LIST, INDEX_LIST), cache=True, nogil=True)
def trace_lines(mask, rows, columns):  # type: ignore[no-untyped-def]
    """One-pixel lines as chains of pixels between ends and junctions: (n, 2) x, y and the starts of the chains.

    A lone pixel is a chain of one; a ring ends where it begins. mask: (H, W) uint8, 0 everywhere; it is written to.
    rows, columns: the pixels of the lines.
    """
    solid = rows.shape[0]
    for k in range(solid):
        mask[rows[k], columns[k]] = 1
    points, starts = np.empty((9 * solid + 2, 2)), np.zeros(4 * solid + 2, np.int64)
    n, chains = 0, 0
    for rings in range(2):  # first from ends and junctions; what is left then are rings
        for k in range(solid):
            y, x = rows[k], columns[k]
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
