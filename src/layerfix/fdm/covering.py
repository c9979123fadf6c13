"""Nothing twice: what is laid already, as a mask, and the stretches of a bead that it leaves to lay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.fdm.chains import MASK
from layerfix.fdm.fields import POINTS
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

HALF_COVERED = 0.5  # a disc half covered has its middle on the border of what is laid: there beads meet
STUMP = 0.3  # of its spacing
LEAST_LENGTH = 0.5  # of its spacing: a shorter rest is no bead, and its neighbours get wider instead


@njit(types.void(MASK, POINTS), cache=True, nogil=True)
def lay_discs(laid, points):  # type: ignore[no-untyped-def]  # numba types it
    """laid = 1 in the disc round each point: (n, 3) x, y, radius in px."""
    height, width = laid.shape
    for k in range(points.shape[0]):
        x, y, radius = points[k]
        for j in range(max(int(np.ceil(y - radius)), 0), min(int(np.floor(y + radius)) + 1, height)):
            half = np.sqrt(max(radius * radius - (j - y) ** 2, 0.0))
            for i in range(max(int(np.ceil(x - half)), 0), min(int(np.floor(x + half)) + 1, width)):
                laid[j, i] = 1


@njit(types.float64[::1](MASK, POINTS), cache=True, nogil=True)
def share_laid(laid, points):  # type: ignore[no-untyped-def]  # numba types it
    """(n,) which share of the disc round each point, (n, 3) x, y, radius in px, is laid already."""
    height, width = laid.shape
    shares = np.zeros(points.shape[0])
    for k in range(points.shape[0]):
        x, y, radius = points[k]
        found, all_px = 0, 0
        for j in range(max(int(np.ceil(y - radius)), 0), min(int(np.floor(y + radius)) + 1, height)):
            half = np.sqrt(max(radius * radius - (j - y) ** 2, 0.0))
            for i in range(max(int(np.ceil(x - half)), 0), min(int(np.floor(x + half)) + 1, width)):
                found += laid[j, i]
                all_px += 1
        if all_px:
            shares[k] = found / all_px
    return shares


def lay(laid: NDArray[np.uint8], line: Floats, pixel_mm: float) -> None:
    """Mark a bead, (n, 3) x, y in px, hardly more than one apart, and spacing in mm."""
    lay_discs(laid, line * np.array([1, 1, 0.5 / pixel_mm]))


def lay_the_rest(laid: NDArray[np.uint8], lines: list[Floats], pixel_mm: float, narrowest_mm: float) -> list[Floats]:
    """The stretches of the lines, the longest first, that are not covered by what is laid or by each other.

    Left out is what is much shorter than it is wide, and wider than the narrowest bead: it would hold the place of a
    spot and hardly lay anything.
    """
    kept: list[Floats] = []
    for line in sorted(lines, key=len, reverse=True):
        fine = finely(line)
        discs = np.column_stack([fine[:, :2], fine[:, 2] / (2 * pixel_mm)])
        free = share_laid(laid, discs) < HALF_COVERED
        wide = fine[:, 2].mean()
        if wide > narrowest_mm and np.hypot(*np.diff(fine[:, :2], axis=0).T).sum() * pixel_mm < STUMP * wide:
            continue
        if free.all():
            kept.append(line)
            lay_discs(laid, discs)
            continue
        edges = np.flatnonzero(np.diff(free.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
        for a, b in edges.tolist():
            length = np.hypot(*np.diff(fine[a:b, :2], axis=0).T).sum() * pixel_mm
            if length > LEAST_LENGTH * fine[a:b, 2].mean():
                kept.append(fine[a:b])
                lay_discs(laid, discs[a:b])
    return kept


def finely(line: Floats) -> Floats:
    """The line with points at most a pixel apart."""
    steps = np.maximum(np.ceil(np.hypot(*np.diff(line[:, :2], axis=0).T)).astype(np.int64), 1)
    if (steps == 1).all():
        return line
    at = np.concatenate([[0], np.cumsum(steps)])
    wanted = np.arange(at[-1] + 1)
    return np.column_stack([np.interp(wanted, at, line[:, k]) for k in range(3)])
