"""The widths of a layer's beads, so that everywhere as much is laid as there is room for.

Rings and lines are right where a place is even; where it gets wider, bends or meets others they leave a little open
or lie on each other. Here all beads are laid on a coarse raster, which is compared with the layer: both blurred, as
the nozzle evens out what it lays. Then each piece of a bead is multiplied by what is wanted over what is laid, within
the widths that the nozzle lays, and laid again: the iteration of Richardson (1972) and Lucy (1974), whose fixed
points are the most likely amounts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.fdm.beads import Path
from layerfix.fdm.fields import FIELD, MUTABLE_FIELD, POINTS, STARTS
from layerfix.kernels import njit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Field = NDArray[np.float32]
    Floats = NDArray[np.float64]

CELL_MM = 0.2  # of the raster
BLUR_MM = 0.22
PIECE_MM = 0.2  # at most; each is laid at its middle
ROUNDS = 4
WANTED = 0.98  # of the area times the height: round sides leave a little open
WIDER = 0.35  # at most: what is missing at the end of a line must not make a bulb of it
LET_BE = 0.06  # what is off by less keeps its width: wide and narrow by turns is no better, and makes long files
MOST = np.float32(3)  # by which anything is multiplied: what no bead comes near does not blow up those beside it
NUMBERS = types.Array(types.float64, 1, "C")


@dataclass(frozen=True)
class Room:
    """What is to be filled: (H, W) float32, the share of each cell, and where its corner lies.

    corner_mm  x, y of the upper left corner of cell (0, 0); cell_mm its side
    """

    share: Field
    corner_mm: Floats
    cell_mm: float


@njit(types.void(MUTABLE_FIELD, POINTS, NUMBERS), cache=True, nogil=True)
def splat(field, points, amounts):  # type: ignore[no-untyped-def]  # numba types it
    """Add amounts at points (n, 2), x, y in cells, shared between the four cells round each."""
    height, width = field.shape
    for k in range(points.shape[0]):
        x, y = points[k, 0] - 0.5, points[k, 1] - 0.5
        i, j = int(np.floor(x)), int(np.floor(y))
        if 0 <= i < width - 1 and 0 <= j < height - 1:
            u, v = x - i, y - j
            field[j, i] += amounts[k] * (1 - u) * (1 - v)
            field[j, i + 1] += amounts[k] * u * (1 - v)
            field[j + 1, i] += amounts[k] * (1 - u) * v
            field[j + 1, i + 1] += amounts[k] * u * v


@njit(types.void(MUTABLE_FIELD, FIELD), cache=True, nogil=True)
def shortage(laid, wanted):  # type: ignore[no-untyped-def]  # numba types it
    """laid = wanted / laid, at most MOST."""
    for j in range(laid.shape[0]):
        for i in range(laid.shape[1]):
            if wanted[j, i] <= 0:
                laid[j, i] = 0
            else:
                laid[j, i] = wanted[j, i] / max(laid[j, i], wanted[j, i] / MOST)


@njit(types.void(FIELD, POINTS, NUMBERS, NUMBERS, NUMBERS), cache=True, nogil=True)
def multiply(factor, points, spacings, lows, highs):  # type: ignore[no-untyped-def]  # numba types it
    """spacings *= factor at points (n, 2), x, y in cells, kept within lows … highs."""
    height, width = factor.shape
    for k in range(points.shape[0]):
        x, y = points[k, 0] - 0.5, points[k, 1] - 0.5
        i, j = int(np.floor(x)), int(np.floor(y))
        if 0 <= i < width - 1 and 0 <= j < height - 1:
            u, v = x - i, y - j
            a = (1 - v) * ((1 - u) * factor[j, i] + u * factor[j, i + 1])
            a += v * ((1 - u) * factor[j + 1, i] + u * factor[j + 1, i + 1])
            spacings[k] = min(max(spacings[k] * a, lows[k]), highs[k])


@njit(types.Tuple((POINTS, STARTS))(POINTS, STARTS, types.float64), cache=True, nogil=True)
def in_pieces(points, starts, longest):  # type: ignore[no-untyped-def]  # numba types it
    """Polylines cut into pieces of at most `longest`: (m, 5) x, y of the middle, spacing, length, and which piece of
    the polylines it is part of, and the starts of the polylines in it.

    points: (n, 3) x, y and the spacing of the piece that begins there; starts: (polylines + 1,) rows of it
    """
    count = 0
    for p in range(starts.shape[0] - 1):
        for k in range(starts[p], starts[p + 1] - 1):
            length = np.hypot(points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1])
            count += max(int(np.ceil(length / longest)), 1)
    out, begins = np.empty((count, 5)), np.zeros(starts.shape[0], np.int64)
    n = 0
    for p in range(starts.shape[0] - 1):
        for k in range(starts[p], starts[p + 1] - 1):
            dx, dy = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
            length = np.hypot(dx, dy)
            parts = max(int(np.ceil(length / longest)), 1)
            for i in range(parts):
                t = (i + 0.5) / parts
                out[n, 0], out[n, 1] = points[k, 0] + t * dx, points[k, 1] + t * dy
                out[n, 2], out[n, 3], out[n, 4] = points[k, 2], length / parts, k
                n += 1
        begins[p + 1] = n
    return out, begins


def balanced(
    paths: Sequence[Path], room: Room, *, overlap_mm: float, range_mm: tuple[float, float], step_mm: float
) -> list[Path]:
    """The paths with widths that fill the room, in steps of `step_mm` from the path's own."""
    import cv2

    if not paths:
        return []
    starts = np.cumsum([0] + [len(p.points_mm) for p in paths])
    points = np.zeros((starts[-1], 3))
    np.concatenate([p.points_mm for p in paths], out=points[:, :2])
    last = np.zeros(1)  # a point more than pieces
    points[:, 2] = np.concatenate([part for p in paths for part in (p.width_mm, last)])
    pieces, begins = in_pieces(points, starts, PIECE_MM)
    cells = np.ascontiguousarray((pieces[:, :2] - room.corner_mm) * np.array([1, -1]) / room.cell_mm)
    before = pieces[:, 2] - overlap_mm
    spacings, areas = before.copy(), pieces[:, 3] / room.cell_mm**2
    lows = np.full(len(before), range_mm[0] - overlap_mm)
    highs = np.minimum(range_mm[1] - overlap_mm, before * (1 + WIDER))

    def blurred(field: Field) -> Field:
        sigma = BLUR_MM / room.cell_mm
        return np.asarray(cv2.GaussianBlur(field, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT), np.float32)

    wanted = room.share * np.float32(WANTED)
    for _ in range(ROUNDS):
        laid = np.zeros_like(wanted)
        splat(laid, cells, spacings * areas)
        laid = blurred(laid)
        shortage(laid, wanted)
        multiply(blurred(laid), cells, spacings, lows, highs)
    factors = spacings / before
    changed = np.abs(factors - 1) > LET_BE
    if not changed.any():
        return list(paths)
    spacings = before * np.where(changed, factors - LET_BE * np.sign(factors - 1), 1.0)
    part_of = pieces[:, 4].astype(np.int64)
    usual = points[part_of, 2]
    steps = usual + step_mm * np.round((np.where(changed, spacings, before) + overlap_mm - usual) / step_mm)
    steps = np.where(changed, np.clip(np.round(steps, 4), *range_mm), usual)
    new_points, new_steps, bounds = _cut(points, part_of, steps, begins)
    touched = np.add.reduceat(changed, begins[:-1]) > 0
    out = list(paths)
    for k in np.flatnonzero(touched).tolist():
        a, b = bounds[k], bounds[k + 1]
        ends = np.vstack([new_points[a:b], paths[k].points_mm[-1:]])
        out[k] = Path(ends, new_steps[a:b], paths[k].kind)
    return out


def _cut(
    points: Floats, part_of: NDArray[np.int64], widths: Floats, begins: NDArray[np.int64]
) -> tuple[Floats, Floats, list[int]]:
    """Polylines (n, 3) cut where the widths of equal parts of their pieces change: (where each part that is kept
    begins, its width, the polylines' bounds in them). `part_of` is the piece of each part."""
    parts = np.bincount(part_of, minlength=len(points))
    nth = np.arange(len(part_of)) - (np.cumsum(parts) - parts)[part_of]
    t = (nth / parts[part_of])[:, None]
    keep = nth == 0
    keep[1:] |= widths[1:] != widths[:-1]
    starts = points[part_of, :2] * (1 - t) + points[part_of + 1, :2] * t
    counts = np.concatenate([[0], np.cumsum(keep)])
    return starts[keep], widths[keep], counts[begins].tolist()
