"""Kernels on distance fields: level sets as loops, balls, one-pixel lines as chains, simplification.

A field is (H, W) float32, its border pixels negative. Points are (x, y) in px, pixel (row j, column i) has its
centre at (i, j), and y points down. The kernels check nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types

from layerfix.bits import ROWS, U0, U1, U63, lowest_bit, popcount

FIELD = types.Array(types.float32, 2, "C", readonly=True)
MUTABLE_FIELD = types.Array(types.float32, 2, "C")
MASK = types.Array(types.uint8, 2, "C")
POINTS = types.Array(types.float64, 2, "C")
STARTS = types.Array(types.int64, 1, "C")
INDICES = types.Array(types.int64, 1, "A")
ROWS_OUT = types.Array(types.uint64, 2, "C")
INDEX_LIST = types.Array(types.int64, 1, "C")
LEAST_MM = np.float32(1e-3)
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


@njit(types.void(MUTABLE_FIELD, types.float32, types.float32), cache=True, nogil=True)
def to_edge_mm(distance, pixel_mm, inset_mm):  # type: ignore[no-untyped-def]
    """Distances to the middle of the nearest void pixel, in px, made distances to the edge less `inset_mm`, in mm.

    Solid pixels keep at least LEAST_MM: nothing is too thin to be laid.
    """
    for y in range(distance.shape[0]):
        for x in range(distance.shape[1]):
            away = (distance[y, x] - np.float32(0.5)) * pixel_mm - inset_mm
            distance[y, x] = max(away, LEAST_MM) if distance[y, x] > 0 else away


@njit(ROWS_OUT(FIELD, FIELD, ROWS, types.float32, types.float32), cache=True, nogil=True)
def bits_unexplained(remaining, local, thick, least, slack):  # type: ignore[no-untyped-def]
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


# Marching squares. A cell's corners are bits: 1 north-west, 2 north-east, 4 south-east, 8 south-west. By which side
# the level set comes in and by which it goes out, with what is higher on its left; sides: 0 north, 1 west, 2 south,
# 3 east. Cases 5 and 10 are saddles, here with the high corners apart; joined they are the other two pairs.
COMES_IN = np.array([-1, 1, 0, 1, 3, 1, 0, 1, 2, 2, 0, 2, 3, 3, 0, -1])
GOES_OUT = np.array([-1, 0, 3, 3, 2, 0, 2, 2, 1, 0, 3, 3, 1, 0, 1, -1])


@njit
def _mixed_cells(high, y, w):  # type: ignore[no-untyped-def]
    """Of the 64 cells that begin at word w of row y, those whose four corners are not all high or all low."""
    upper, lower = high[y, w], high[y + 1, w]
    right_upper, right_lower = upper >> U1, lower >> U1
    if w + 1 < high.shape[1]:
        right_upper |= high[y, w + 1] << U63
        right_lower |= high[y + 1, w + 1] << U63
        return (upper ^ lower) | (upper ^ right_upper) | (lower ^ right_lower)
    return ((upper ^ lower) | (upper ^ right_upper) | (lower ^ right_lower)) & ~(U1 << U63)


@njit
def _high(high, y, x):  # type: ignore[no-untyped-def]
    return np.int64((high[y, x >> 6] >> np.uint64(x & 63)) & U1)


@njit
def _saddle_joins(field, level, y, x):  # type: ignore[no-untyped-def]
    """Whether the middle of a cell is high."""
    above = field[y, x] + field[y, x + 1] + field[y + 1, x] + field[y + 1, x + 1]
    return above > level[y, x] + level[y, x + 1] + level[y + 1, x] + level[y + 1, x + 1]


@njit
def _segments(field, level, high):  # type: ignore[no-untyped-def]
    """The level set as segments across cells: ((n, 3) y, x of the cell and the side it comes in by, (n,) the segment
    that goes on where each ends).

    Two segments meet on the side between two cells; whoever comes second finds the first in `beside` or `above`.
    """
    width = 64 * high.shape[1]
    count = 0
    for y in range(high.shape[0] - 1):
        for w in range(high.shape[1]):
            cells = _mixed_cells(high, y, w)
            if cells != U0:
                count += popcount(cells)
    segments, following = np.empty((2 * count, 3), np.int32), np.empty(2 * count, np.int64)
    # On a side between two cells, the segment k that ends there, or -1 - k for one that begins there.
    above, beside = np.empty(width, np.int64), 0
    comes, goes = np.empty(2, np.int64), np.empty(2, np.int64)
    n = 0
    for y in range(high.shape[0] - 1):
        for w in range(high.shape[1]):
            cells = _mixed_cells(high, y, w)
            while cells != U0:
                x = w * 64 + lowest_bit(cells)
                cells &= cells - U1
                case = _high(high, y, x) | (_high(high, y, x + 1) << 1)
                case |= (_high(high, y + 1, x + 1) << 2) | (_high(high, y + 1, x) << 3)
                pieces = 1
                if case == 5 or case == 10:  # saddles: west and east, or north and south come in
                    pieces = 2
                    comes[0], comes[1] = (1, 3) if case == 5 else (0, 2)
                    turned = _saddle_joins(field, level, y, x) != (case == 10)
                    goes[0], goes[1] = (2, 0) if turned else (0, 2)
                    if case == 10:
                        goes[0], goes[1] = (3, 1) if turned else (1, 3)
                else:
                    comes[0], goes[0] = COMES_IN[case], GOES_OUT[case]
                for piece in range(pieces):
                    k, first, last = n + piece, comes[piece], goes[piece]
                    segments[k, 0], segments[k, 1], segments[k, 2] = y, x, first
                    if first < 2:
                        following[above[x] if first == 0 else beside] = k
                    if last < 2:
                        following[k] = -1 - (above[x] if last == 0 else beside)
                for piece in range(pieces):
                    k = n + piece
                    for side, mark in ((comes[piece], -1 - k), (goes[piece], k)):
                        if side == 2:
                            above[x] = mark
                        elif side == 3:
                            beside = mark
                n += pieces
    return segments[:n], following[:n]


@njit(ROWS_OUT(FIELD, FIELD), cache=True, nogil=True)
def bits_higher(field, level):  # type: ignore[no-untyped-def]
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


@njit(types.Tuple((POINTS, STARTS))(FIELD, FIELD, ROWS), cache=True, nogil=True)
def level_loops(field, level, high):  # type: ignore[no-untyped-def]
    """Where a field is as high as `level`, itself a field, as closed loops round what is higher: (n, 3) x, y and the
    level there, and the starts of the loops in it. Seen with y down, what is higher lies to the left of the way.

    high: `bits_higher` of the two.
    """
    segments, following = _segments(field, level, high)
    count = segments.shape[0]
    points, starts = np.empty((count, 3)), np.zeros(count + 1, np.int64)
    n, loops = 0, 0
    for begin in range(count):
        k = begin
        if following[k] < 0:
            continue
        while following[k] >= 0:
            y, x, side = segments[k, 0], segments[k, 1], segments[k, 2]
            y0, x0 = (y + 1, x) if side == 2 else (y, x + 1) if side == 3 else (y, x)
            y1, x1 = (y + 1, x) if side == 1 else (y, x + 1) if side == 0 else (y + 1, x + 1)
            a, b = field[y0, x0] - level[y0, x0], field[y1, x1] - level[y1, x1]
            t = a / (a - b)
            points[n, 0] = x0 + t * (x1 - x0)
            points[n, 1] = y0 + t * (y1 - y0)
            one, other = level[y0, x0], level[y1, x1]  # a level that no field reaches is no width of a bead
            points[n, 2] = min(one, other) if max(one, other) > NO_LEVEL / 2 else one + t * (other - one)
            n += 1
            onwards = following[k]
            following[k] = -1
            k = onwards
        loops += 1
        starts[loops] = n
    return points[:n], starts[: loops + 1].copy()


@njit(
    types.void(MUTABLE_FIELD, FIELD, ROWS, types.float32, types.float32, types.float32),
    cache=True,
    nogil=True,
)
def half_spacings(half, local, thick, one, two, elsewhere):  # type: ignore[no-untyped-def]
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


@njit(types.void(FIELD, ROWS, MUTABLE_FIELD), cache=True, nogil=True)
def copy_outside(field, where, target):  # type: ignore[no-untyped-def]
    """target = field but for the pixels of `where` (packed)."""
    for y in range(field.shape[0]):
        for x in range(field.shape[1]):
            if not (where[y, x >> 6] >> np.uint64(x & 63)) & U1:
                target[y, x] = field[y, x]


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


@njit(types.void(MUTABLE_FIELD, ROWS, INDEX_LIST, INDEX_LIST, VALUES, types.float64), cache=True, nogil=True)
def paint_ends(field, skeleton, rows, columns, values, radius_px):  # type: ignore[no-untyped-def]
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
def middles(remaining, skeleton, rows, columns):  # type: ignore[no-untyped-def]
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
