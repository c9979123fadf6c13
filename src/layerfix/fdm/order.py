"""The order in which paths are laid: nearest end first, then 2-opt, so that the nozzle travels little."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.fdm.beads import Path
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Point = NDArray[np.float64]

ENDS = types.Array(types.float64, 2, "C", readonly=True)
SWEEPS = 8  # of 2-opt; most orders are settled after three
WINDOW = 200  # how far along the order an exchange may reach: enough, and linear


@njit
def _away(ends, a, flip_a, b, flip_b):  # type: ignore[no-untyped-def]  # numba types it
    """From the end of path a to the start of path b."""
    i, j = (0 if flip_a else 2), (2 if flip_b else 0)
    return np.hypot(ends[a, i] - ends[b, j], ends[a, i + 1] - ends[b, j + 1])


@njit(types.Tuple((types.int64[::1], types.boolean[::1]))(ENDS, types.float64, types.float64), cache=True, nogil=True)
def short_tour(ends, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """(order, flipped) of paths with (n, 4) ends x0, y0, x1, y1, beginning near (x, y)."""
    n = ends.shape[0]
    order, flip, used = np.empty(n, np.int64), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for place in range(n):
        best, best_flip, nearest = 0, False, np.inf
        for k in range(n):
            if not used[k]:
                a, b = np.hypot(ends[k, 0] - x, ends[k, 1] - y), np.hypot(ends[k, 2] - x, ends[k, 3] - y)
                if min(a, b) < nearest:
                    best, best_flip, nearest = k, b < a, min(a, b)
        order[place], flip[place], used[best] = best, best_flip, True
        x, y = (ends[best, 0], ends[best, 1]) if best_flip else (ends[best, 2], ends[best, 3])
    for _ in range(SWEEPS):
        better = False
        for i in range(1, n):
            for j in range(i, min(n, i + WINDOW)):
                now = _away(ends, order[i - 1], flip[i - 1], order[i], flip[i])
                then = _away(ends, order[i - 1], flip[i - 1], order[j], not flip[j])
                if j + 1 < n:
                    now += _away(ends, order[j], flip[j], order[j + 1], flip[j + 1])
                    then += _away(ends, order[i], not flip[i], order[j + 1], flip[j + 1])
                if then < now - 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1].copy()
                    flip[i : j + 1] = ~flip[i : j + 1][::-1]
                    better = True
        if not better:
            break
    return order, flip


def in_short_order(paths: Sequence[Path], near: Point) -> list[Path]:
    """The paths so that travels are short, some of them reversed; the first begins near `near`."""
    if not paths:
        return []
    ends = np.array([[*path.points_mm[0], *path.points_mm[-1]] for path in paths])
    order, flip = short_tour(ends, *near)
    return [paths[k].reversed() if turned else paths[k] for k, turned in zip(order, flip, strict=True)]
