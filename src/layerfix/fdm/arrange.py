"""Paths of a layer in the order they are laid: part by part, perimeters from inside out, then infill."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from layerfix.fdm.beads import EXTERNAL, KINDS, PERIMETER, SKIRT, Path, spacing_mm
from layerfix.fdm.order import in_short_order, short_tour
from layerfix.layers.components import components_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.fdm.settings import PathSettings
    from layerfix.stack import Layer, LayerStack

    Point = NDArray[np.float64]

# What is laid together; inner perimeters first, so that the outer ones have something to lean on. Gaps are filled on
# the way of the infill: a tour of their own was a quarter of all travel.
STAGES = ((PERIMETER,), (EXTERNAL,), tuple(k for k in KINDS if k not in (PERIMETER, EXTERNAL)))


def arranged(
    paths: Sequence[Path], layer: Layer, stack: LayerStack, settings: PathSettings, index: int
) -> tuple[list[Path], list[int], int]:
    """(all paths in order, a number of the separate part of the layer that each belongs to, how many parts are
    smaller than the narrowest dot of the nozzle).

    Loops start where the seam is wanted. The nozzle comes from the rear left.
    """
    parts, small = _parts(paths, layer, stack, settings.range_mm[0])
    if not paths:
        return [], [], small
    where = np.array([stack.origin_mm[0], stack.origin_mm[1]])
    middles = np.array([paths[group[0]].points_mm[0] for group in parts])
    order, _ = short_tour(np.hstack([middles, middles]), *where.tolist())
    random = np.random.default_rng(index)
    out: list[Path] = []
    numbers: list[int] = []
    for part in order.tolist():
        for stage in STAGES:
            chosen = [paths[k] for k in parts[part] if paths[k].kind in stage]
            for path in in_short_order(chosen, where):
                laid = _with_seam(path, where, settings.seam, random)
                out.append(laid)
                numbers.append(part)
                where = laid.points_mm[-1]
    return out, numbers, small


def _parts(paths: Sequence[Path], layer: Layer, stack: LayerStack, dot_mm: float) -> tuple[list[list[int]], int]:
    """(numbers of the paths of each separate part of the layer, 8-connected; how many parts are under a dot)."""
    starts = np.array([path.points_mm[0] for path in paths]).reshape(-1, 2) - np.array(stack.origin_mm)
    x, y = np.floor(starts * np.array([1 / stack.pixel_mm[0], -1 / stack.pixel_mm[1]])).astype(np.int64).T
    component, areas_px = components_at(layer.rows, x, y)
    dot_px = np.pi / 4 * dot_mm**2 / (stack.pixel_mm[0] * stack.pixel_mm[1])
    found: dict[int, list[int]] = {}
    for k, number in enumerate(component.tolist()):
        found.setdefault(number, []).append(k)
    return list(found.values()), int((areas_px < dot_px).sum())


def _with_seam(path: Path, near: Point, seam: str, random: np.random.Generator) -> Path:
    if not path.closed:
        return path
    points = path.points_mm[:-1]
    if seam == "rear":
        k = int(np.argmax(points[:, 1]))
    elif seam == "random":
        k = int(random.integers(len(points)))
    else:
        k = int(np.argmin(np.hypot(*(points - near).T)))
    return path.starting_at(k)


def skirt(layer: Layer, stack: LayerStack, settings: PathSettings, width_mm: float) -> list[Path]:
    """Loops round everything on the first layer, to start the flow; outermost first."""
    import shapely

    from layerfix.outlines.contours import outline

    shape = outline(layer, stack.pixel_mm, stack.origin_mm, max(stack.pixel_mm))
    hull = shapely.convex_hull(shape)
    if hull.is_empty:
        return []
    step = spacing_mm(width_mm, layer.z_mm[1] - layer.z_mm[0])
    loops = []
    for k in reversed(range(settings.skirt_loops)):
        ring = shapely.buffer(hull, settings.skirt_gap_mm + width_mm / 2 + k * step).exterior.simplify(0.01)
        points = np.asarray(ring.coords)
        loops.append(Path(points, np.full(len(points) - 1, width_mm), SKIRT))
    return loops
