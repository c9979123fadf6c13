"""One-pixel lines as chains of pixels, and which points of a polyline are needed."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.fdm.fields import FIELD, INDEX_LIST, POINTS, STARTS
from layerfix.kernels import njit

LENGTHS = types.Array(types.float64, 1, "C")
PLACE, STEPS = types.UniTuple(types.float64, 6), types.UniTuple(types.float64, 5)
MASK = types.Array(types.uint8, 2, "C")
MOST_TURN = 1.1  # radians: in round spots, whose ridge is flat, the way would go round and round
FALL = 3  # pixels over which a ridge falls where it ends


@njit
def _degree(mask, y, x):  # type: ignore[no-untyped-def]  # numba types it
    count = -1 if mask[y, x] else 0
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            count += mask[y + dy, x + dx] != 0
    return count


@njit
def _follow(mask, y, x, y2, x2, points, n):  # type: ignore[no-untyped-def]  # numba types it
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
def trace_lines(mask, rows, columns):  # type: ignore[no-untyped-def]  # numba types it
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


@njit
def _between(field, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """The field between its pixels, bilinear; 0 outside."""
    i, j = int(np.floor(x)), int(np.floor(y))
    if not (0 <= i < field.shape[1] - 1 and 0 <= j < field.shape[0] - 1):
        return 0.0
    u, v = x - i, y - j
    top = field[j, i] + u * (field[j, i + 1] - field[j, i])
    bottom = field[j + 1, i] + u * (field[j + 1, i + 1] - field[j + 1, i])
    return top + v * (bottom - top)


@njit(POINTS(FIELD, types.float64, types.float64, types.float64, types.float64, types.int64), cache=True, nogil=True)
def along_ridge(field, x, y, angle, slope, longest):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 3) x, y and the field's value on the way along its ridge from (x, y), at most `longest` steps of a pixel.

    Each step turns by at most 36 degrees to where the field is highest, all together by MOST_TURN. The way ends
    where the field falls by more than `slope` a step over FALL steps, and those do not count.
    """
    points = np.empty((longest + 1, 3))
    points[0] = x, y, _between(field, x, y)
    n, first = 1, angle
    while n <= longest:
        best, turn = -1.0, 0.0
        for k in range(7):
            t = (k + 1) // 2 * 0.21 * (1 if k % 2 else -1)
            if abs(angle + t - first) > MOST_TURN:
                continue
            value = _between(field, x + np.cos(angle + t), y + np.sin(angle + t)) - 1e-6 * abs(t)
            if value > best:
                best, turn = value, t
        if best <= 0:
            return points[: max(n - FALL, 1)].copy()
        angle += turn
        x, y = x + np.cos(angle), y + np.sin(angle)
        points[n] = x, y, best
        n += 1
        if n > FALL and points[n - 1 - FALL, 2] - best > FALL * slope:
            return points[: n - FALL].copy()
    return points


@njit(types.int64(FIELD, types.int64, types.int64, types.int64), cache=True, nogil=True)
def spot_px(field, x, y, reach):  # type: ignore[no-untyped-def]  # numba types it
    """How many pixels above 0 hang together (8-connected) with pixel (x, y).

    It is 0 if that is not above 0, or if one of them is farther than `reach` away.
    """
    side = 2 * reach + 1
    seen = np.zeros((side, side), np.bool_)
    todo = np.empty((side * side, 2), np.int64)
    todo[0] = reach, reach
    seen[reach, reach] = True
    left, count = 1, 0
    if not field[y, x] > 0:
        return 0
    while left:
        left -= 1
        v, u = todo[left]
        count += 1
        for dv in range(-1, 2):
            for du in range(-1, 2):
                j, i = y + v + dv - reach, x + u + du - reach
                if not (0 <= j < field.shape[0] and 0 <= i < field.shape[1]) or not field[j, i] > 0:
                    continue
                if not (0 <= v + dv < side and 0 <= u + du < side):
                    return 0
                if not seen[v + dv, u + du]:
                    seen[v + dv, u + du] = True
                    todo[left] = v + dv, u + du
                    left += 1
    return count


@njit(types.boolean[::1](POINTS, types.float64), cache=True, nogil=True)
def needed_points(points, tolerance):  # type: ignore[no-untyped-def]  # numba types it
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


@njit
def way(points, first, last):  # type: ignore[no-untyped-def]  # numba types it
    """Of the way from one point to another of a polyline, along it; x and y are the first two columns."""
    length = 0.0
    for k in range(first, last):
        length += math.hypot(points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1])
    return length


@njit(LENGTHS(POINTS, STARTS), cache=True, nogil=True)
def lengths_of(points, starts):  # type: ignore[no-untyped-def]  # numba types it
    """(n,) how long each polyline is whose x and y are the first two columns of `points`; line k has the points from
    starts[k] to starts[k + 1]."""
    out = np.empty(starts.shape[0] - 1)
    for k in range(out.shape[0]):
        out[k] = way(points, starts[k], starts[k + 1] - 1)
    return out


@njit(types.Tuple((POINTS, LENGTHS))(POINTS, types.float64, types.float64, types.float64), cache=True, nogil=True)
def simplified(line, share, tolerance, turns):  # type: ignore[no-untyped-def]  # numba types it
    """(x, y of the `needed_points` of a line (n, 3) of x, y and spacing, mean spacing of each piece between them).

    share      how many px a unit of spacing is worth
    tolerance  px; small loops get a finer one, their length over `turns`
    """
    weighed = line.copy()
    weighed[:, 2] *= share
    keep = needed_points(weighed, min(tolerance, way(line, 0, line.shape[0] - 1) / turns))
    count = 0
    for k in range(keep.shape[0]):
        count += keep[k]
    points, spacings = np.empty((count, 2)), np.empty(max(count - 1, 0))
    n, before = 0, 0.0
    for k in range(keep.shape[0]):
        if keep[k]:
            points[n, 0], points[n, 1] = line[k, 0], line[k, 1]
            if n:
                spacings[n - 1] = (line[k, 2] + before) / 2
            before = line[k, 2]
            n += 1
    return points, spacings


@njit(types.Tuple((POINTS, LENGTHS))(POINTS, LENGTHS, PLACE, STEPS), cache=True, nogil=True)
def in_mm(points, spacings, place, steps):  # type: ignore[no-untyped-def]  # numba types it
    """(points in mm, width of each piece) of what `simplified` gives.

    place  (corner x, corner y) in px from the frame's, (x, y) mm of a pixel, (x, y) mm of the frame's corner
    steps  the usual width, what is added to a spacing, the step from the usual width, the least and the largest width
    """
    corner_x, corner_y, pixel_x, pixel_y, origin_x, origin_y = place
    usual, overlap, step, low, high = steps
    out, widths = np.empty(points.shape), np.empty(spacings.shape)
    for k in range(points.shape[0]):
        out[k, 0] = (points[k, 0] + corner_x) * pixel_x + origin_x
        out[k, 1] = (points[k, 1] + corner_y) * pixel_y + origin_y
    for k in range(spacings.shape[0]):
        width = usual + step * np.rint((spacings[k] + (overlap - usual)) / step)
        widths[k] = min(max(np.rint(width * 1e4) / 1e4, low), high)
    return out, widths
