"""Small parts of a layer get their material to the tenth: the widths of all their beads by one factor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.fdm.beads import Path
from layerfix.fdm.fields import pixels_of
from layerfix.layers.components import components_at, smaller_than
from layerfix.layers.morphology import dilate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from layerfix.bits import Rows

LARGEST_MM2 = 4.0
LET_BE = 0.04


def filled_spots(
    paths: Sequence[Path],
    solid: Rows,
    corner_mm: NDArray[np.float64],
    pixel_mm: float,
    *,
    overlap_mm: float,
    range_mm: tuple[float, float],
    wanted: float,
) -> list[Path]:
    """The paths, those on components (8-connected) of `solid` (packed) under LARGEST_MM2 so wide that they lay
    `wanted` of its area, within the widths that the nozzle lays. `corner_mm` is the upper left corner of `solid`."""
    small = smaller_than(solid, LARGEST_MM2 / pixel_mm**2)
    if not small.any() or not paths:
        return list(paths)
    rows, columns = pixels_of(small)
    middles = np.array([path.points_mm[:-1].mean(axis=0) for path in paths])
    x, y = np.rint((middles - corner_mm) * np.array([1, -1]) / pixel_mm - 0.5).astype(np.int64).T
    near = dilate(small, 64 * small.shape[1], (2.5, 2.5))  # a bead across a neck may have its middle beside it
    on = (near[y, x >> 6] >> (x & 63).astype(np.uint64) & np.uint64(1)).astype(np.bool_)
    number, _ = components_at(small, np.concatenate([columns, x]), np.concatenate([rows, y]))
    areas = np.bincount(number[: len(rows)], minlength=int(number.max()) + 1) * pixel_mm**2
    laid = np.zeros(len(areas))
    mine = number[len(rows) :]
    for k in np.flatnonzero(on).tolist():
        laid[mine[k]] += float(paths[k].lengths_mm @ (paths[k].width_mm - overlap_mm))
    out = list(paths)
    for k in np.flatnonzero(on).tolist():
        factor = wanted * areas[mine[k]] / max(laid[mine[k]], 1e-9)
        if abs(factor - 1) > LET_BE:
            widths = np.clip(np.round((paths[k].width_mm - overlap_mm) * factor + overlap_mm, 4), *range_mm)
            out[k] = Path(paths[k].points_mm, widths, paths[k].kind)
    return out
