"""Few stretches of one width each: slicers end solid shells wherever the settings change, so changes must be few."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.widths import Widths


def banded(widths: Widths, count: int, *, min_height_mm: float = 0.0) -> Widths:
    """The same layers in at most `count` bands, none lower than `min_height_mm` (but for a part that is).

    No layer gets a wider bead than was suggested for it: a band has the narrowest of its layers. Of all such bands
    those are chosen whose beads are shortest in all, the length in a layer being its area over its width (dynamic
    programming over the layers where the suggestion changes).
    Raises InputError for no band and a height below 0.
    """
    if not float(count).is_integer() or count < 1:
        raise InputError(f"{count} bands: a whole number, at least one")
    if not 0 <= min_height_mm < np.inf:
        raise InputError(f"band height {min_height_mm} mm: it must be 0 or more")
    if not len(widths):
        return widths
    starts = np.flatnonzero(np.diff(widths.width_mm, prepend=np.nan) != 0)
    if min_height_mm > 0:  # a border may be needed where the suggestion does not change
        starts = np.arange(len(widths))
    borders = np.append(starts, len(widths))
    low = np.minimum.reduceat(widths.width_mm, starts)
    area = np.concatenate([[0.0], np.cumsum(np.add.reduceat(widths.area_mm2 * _heights_mm(widths), starts))])
    bottom, top = widths.z_mm[starts, 0], widths.z_mm[borders[1:] - 1, 1]
    chosen = _cheapest(low, area, bottom, top, int(count), min_height_mm)
    out = np.empty_like(widths.width_mm)
    for a, b in chosen:
        out[borders[a] : borders[b]] = low[a:b].min()
    return replace(widths, width_mm=out)


def _heights_mm(widths: Widths) -> NDArray[np.float64]:
    heights: NDArray[np.float64] = widths.z_mm[:, 1] - widths.z_mm[:, 0]
    return heights


def _cheapest(
    low: NDArray[np.float64],
    area: NDArray[np.float64],
    bottom: NDArray[np.float64],
    top: NDArray[np.float64],
    count: int,
    min_height_mm: float,
) -> list[tuple[int, int]]:
    """(first, past the last) stretch of each band; area: (n + 1,) cumulated, the others (n,) by stretch."""
    n = len(low)
    count = min(count, n)
    best = np.full((count + 1, n + 1), np.inf)  # [bands, stretches below]
    came_from = np.zeros((count + 1, n + 1), np.int64)
    best[:, 0] = 0.0
    for stop in range(1, n + 1):
        narrowest = np.minimum.accumulate(low[:stop][::-1])[::-1]  # of the stretches i … stop - 1
        cost = (area[stop] - area[:stop]) / narrowest
        cost[top[stop - 1] - bottom[:stop] < min_height_mm - 1e-9] = np.inf
        for bands in range(1, count + 1):
            total = best[bands - 1, :stop] + cost
            i = int(np.argmin(total))
            best[bands, stop], came_from[bands, stop] = total[i], i
    bands, stop = int(np.argmin(best[:, n])), n
    if not np.isfinite(best[bands, n]):
        return [(0, n)]  # lower than a band
    chosen = []
    while stop > 0:
        first = int(came_from[bands, stop])
        chosen.append((first, stop))
        bands, stop = bands - 1, first
    return chosen[::-1]
