"""Rectilinear infill: parallel lines across a field, joined end to end into few long paths."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1
from layerfix.fdm.chains import lengths_of, way
from layerfix.fdm.fields import FIELD, POINTS
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PARTED = types.Tuple((POINTS, types.int64[::1], types.boolean[::1]))
CHAINED = types.Tuple((POINTS, types.int64[::1]))


@njit
def _at(field, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """The field between its pixels, bilinear; -1 outside."""
    if not (0 <= x < field.shape[1] - 1 and 0 <= y < field.shape[0] - 1):
        return -1.0
    i, j = int(x), int(y)
    u, v = x - i, y - j
    top = field[j, i] + u * (field[j, i + 1] - field[j, i])
    bottom = field[j + 1, i] + u * (field[j + 1, i + 1] - field[j + 1, i])
    return top + v * (bottom - top)


@njit(POINTS(FIELD, types.float64, types.float64, types.float64), cache=True, nogil=True)
def scan(field, angle, spacing, offset):  # type: ignore[no-untyped-def]  # numba types it
    """(m, 5): line number, x, y of start and end of every stretch above 0 of parallel lines, line by line.

    Lines run along `angle` (radians), at multiples of `spacing` px plus `offset` from the field's corner.
    """
    height, width = field.shape
    ux, uy = math.cos(angle), math.sin(angle)
    nx, ny = -uy, ux
    low = min(0.0, nx * width) + min(0.0, ny * height)
    high = max(0.0, nx * width) + max(0.0, ny * height)
    first, last = math.ceil((low - offset) / spacing), math.floor((high - offset) / spacing)
    out, n = np.empty((1024, 5)), 0
    for line in range(first, last + 1):
        px, py = nx * (offset + line * spacing), ny * (offset + line * spacing)
        t0, t1 = -1e18, 1e18
        for p, u, size in ((px, ux, width - 1.0), (py, uy, height - 1.0)):
            if abs(u) > 1e-12:
                a, b = -p / u, (size - p) / u
                t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
            elif p < 0 or p > size:
                t1 = -1e18
        t, before, start = t0, -1.0, 0.0
        while t <= t1 + 1:
            value = -1.0
            if t <= t1:
                x, y = px + t * ux, py + t * uy
                # Far outside, where two opposite corners are, costs two looks instead of four.
                i, j = min(max(int(x), 0), width - 2), min(max(int(y), 0), height - 2)
                if before > 0 or field[j, i] > -1 or field[j + 1, i + 1] > -1 or field[j, i + 1] > -1:
                    value = _at(field, x, y)
            if (value > 0) != (before > 0):
                crossing = t - value / (value - before)
                if value > 0:
                    start = crossing
                elif crossing - start > 1e-6:
                    if n == out.shape[0]:
                        more = np.empty((2 * n, 5))
                        more[:n] = out
                        out = more
                    out[n, 0] = line
                    out[n, 1], out[n, 2] = px + start * ux, py + start * uy
                    out[n, 3], out[n, 4] = px + crossing * ux, py + crossing * uy
                    n += 1
            before = value
            t += 1.0
    return out[:n].copy()


@njit
def _clear(field, x0, y0, x1, y1, least):  # type: ignore[no-untyped-def]  # numba types it
    """Whether the straight way between two points stays where the field is at least `least`."""
    steps = int(math.hypot(x1 - x0, y1 - y0)) + 1
    for k in range(steps + 1):
        t = k / steps
        if _at(field, x0 + t * (x1 - x0), y0 + t * (y1 - y0)) < least:
            return False
    return True


@njit(CHAINED(FIELD, POINTS, types.float64, types.float64), cache=True, nogil=True)
def join_lines(field, lines, longest, least):  # type: ignore[no-untyped-def]  # numba types it
    """(points (n, 2), starts): the lines of `scan` as zigzags.

    From the end of a line the way goes on to the nearest end on the next line that is at most `longest` px away
    and straight ahead, where the field stays at least `least`.
    """
    m = lines.shape[0]
    points, starts = np.empty((2 * m, 2)), np.zeros(m + 1, np.int64)
    used = np.zeros(m, np.bool_)
    n, chains = 0, 0
    for begin in range(m):
        if used[begin]:
            continue
        at, flip = begin, False
        while True:
            used[at] = True
            a, b = (3, 1) if flip else (1, 3)
            points[n] = lines[at, a : a + 2]
            points[n + 1] = lines[at, b : b + 2]
            n += 2
            x, y = points[n - 1]
            best, best_flip, nearest = -1, False, longest
            for k in range(at + 1, m):
                if lines[k, 0] > lines[at, 0] + 1:
                    break
                if used[k] or lines[k, 0] == lines[at, 0]:
                    continue
                for end in range(2):
                    c = 3 if end else 1
                    away = math.hypot(lines[k, c] - x, lines[k, c + 1] - y)
                    if away < nearest and _clear(field, x, y, lines[k, c], lines[k, c + 1], least):
                        best, best_flip, nearest = k, end == 1, away
            if best < 0:
                break
            at, flip = best, best_flip
        chains += 1
        starts[chains] = n
    return points[:n].copy(), starts[: chains + 1].copy()


@njit(PARTED(POINTS, ROWS), cache=True, nogil=True)
def parted(points, mask):  # type: ignore[no-untyped-def]  # numba types it
    """(points (m, 2), starts, whether each part lies in the mask): a polyline (n, 2), cut where it enters or leaves a
    mask (packed).

    It is looked at every pixel; parts touch where they are cut.
    """
    pieces = points.shape[0] - 1
    most = 2 * (int(way(points, 0, pieces)) + 2 * pieces) + 2
    out, starts = np.empty((most, 2)), np.zeros(most, np.int64)
    inside, before, n, parts = np.zeros(most, np.bool_), False, 0, 0
    for k in range(pieces + 1):
        x0, y0 = points[k]
        dx, dy = points[min(k + 1, pieces), 0] - x0, points[min(k + 1, pieces), 1] - y0
        steps = max(math.ceil(math.hypot(dx, dy)), 1)
        for i in range(steps):
            x, y = x0 + i / steps * dx, y0 + i / steps * dy
            column, row = int(np.rint(x)), int(np.rint(y))
            here = (mask[row, column >> 6] >> np.uint64(column & 63)) & U1 != U0
            if k == 0 and i == 0:
                before = here
            cut = here != before
            if cut or i == 0:
                out[n, 0], out[n, 1] = x, y
                n += 1
            if cut:
                inside[parts] = before
                parts += 1
                starts[parts] = n
                out[n, 0], out[n, 1] = x, y
                n += 1
                before = here
    if n - starts[parts] > 1:
        inside[parts] = before
        parts += 1
        starts[parts] = n
    return out[:n].copy(), starts[: parts + 1].copy(), inside[:parts].copy()


def rectilinear(
    field: NDArray[np.float32],
    angle: float,
    spacing_px: float,
    least: float,
    corner_px: Floats,
    shortest_px: float = 0.0,
) -> list[Floats]:
    """Zigzags of lines `spacing_px` apart where the field is above 0: a list of (n, 2) points in px.

    corner_px    where the field's pixel (0, 0) lies in a frame in which the lines are the same for all layers
    shortest_px  zigzags that are no longer are left out
    """
    across = -math.sin(angle) * corner_px[0] + math.cos(angle) * corner_px[1]
    lines = scan(field, angle, spacing_px, float((0.5 * spacing_px - across) % spacing_px))
    points, starts = join_lines(field, lines, 2.2 * spacing_px, least)
    long = (lengths_of(points, starts) > shortest_px).tolist()
    return [points[a:b] for (a, b), kept in zip(pairwise(starts.tolist()), long, strict=True) if kept]
