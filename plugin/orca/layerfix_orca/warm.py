"""Everything that a correction may need, loaded beforehand: modules, and kernels, compiled if they were not."""

from __future__ import annotations

import numpy as np

from layerfix import correct_regions

UNIT_MM = 1e-6


def warm() -> None:
    """Correct small layers in every mode: two regions, thin walls, dots, a thin bridge, holes, gaps, an empty one.

    What these do not call, `layerfix.kernels.ready` loads: all kernels of the modules that are imported by then.
    """
    import sys

    from layerfix.kernels import ready
    from layerfix.layers.correction import MODES

    wall, dot = box(0, 0, 4, 0.2), box(6, 0, 6.1, 0.1)
    plate = [*box(0, 2, 6, 6), *box(1, 3, 2, 4, hole=True), *box(2.1, 3, 5, 5, hole=True)]
    corner = [np.array([[7, 2], [10, 2.4], [7, 2.8]])]
    for mode in MODES:
        for gap_mm in (None, 0.1):
            regions = [[scaled(wall), scaled(plate), scaled(corner)], [scaled(dot), scaled(box(4, 0, 5, 0.2))]]
            correct_regions(regions, min_feature_mm=0.4, unit_mm=UNIT_MM, mode=mode, keep_gaps_mm=gap_mm)
    correct_regions([[]], min_feature_mm=0.4, unit_mm=UNIT_MM)
    ready(*[name for name in list(sys.modules) if name.startswith(("layerfix.layers.", "layerfix.outlines."))])


def box(left: float, bottom: float, right: float, top: float, hole: bool = False) -> list[np.ndarray]:
    """A rectangle as a polygon of one ring, in mm."""
    ring = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    return [ring[::-1] if hole else ring]


def scaled(polygon: list[np.ndarray]) -> list[np.ndarray]:
    """In the host's units."""
    return [np.rint(ring / UNIT_MM).astype(np.int64) for ring in polygon]
