"""Beads as areas: what the paths of a layer cover of it, and pictures in mm to lay them on."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import shapely

import layerfix as lf
from layerfix import Layer, LayerStack, PathSettings
from layerfix.fdm import LayerPaths, Path
from layerfix.outlines.contours import outline

if TYPE_CHECKING:
    from shapely import Geometry, MultiPolygon

PIXEL_MM, LAYER_MM, WIDTH_MM = 0.05, 0.2, 0.45
NARROWEST_MM, WIDEST_MM = 0.34, 0.8  # 0.85 and 2 nozzles of 0.4
OVERLAP_MM = LAYER_MM * (1 - math.pi / 4)  # of two beads side by side
SPACING_MM = WIDTH_MM - OVERLAP_MM
NO_SKIRT = PathSettings(0.4, WIDTH_MM, skirt_loops=0)


def section_mm2(width_mm: np.ndarray | float, layer_mm: float) -> np.ndarray:
    """A bead with half-round sides: (w − h)·h + π(h / 2)²."""
    return (np.asarray(width_mm) - layer_mm) * layer_mm + math.pi * (layer_mm / 2) ** 2


def volume_mm3(paths: Iterable[Path], layer_mm: float = LAYER_MM) -> float:
    """Of all beads."""
    return sum(float(path.lengths_mm @ section_mm2(path.width_mm, layer_mm)) for path in paths)


def length_mm(paths: Iterable[Path]) -> float:
    """Of all beads."""
    return sum(float(path.lengths_mm.sum()) for path in paths)


def drawn(size_mm: tuple[float, float], shape: Geometry, pixel_mm: float = PIXEL_MM) -> np.ndarray:
    """An image of so many mm (x, y); a pixel is solid where its middle is inside. y is 0 at the lower edge."""
    width, height = (round(s / pixel_mm) for s in size_mm)
    x, y = np.meshgrid((np.arange(width) + 0.5) * pixel_mm, (height - np.arange(height) - 0.5) * pixel_mm)
    return shapely.contains_xy(shape, x, y)


def stack_of(*images: np.ndarray, pixel_mm: float | tuple[float, float] = PIXEL_MM, **heights: float) -> LayerStack:
    """Images as layers of 0.2 mm, placed as `drawn` draws them."""
    stack = LayerStack.from_images(images, pixel_mm=pixel_mm, **{"layer_mm": LAYER_MM, **heights})
    return replace(stack, origin_mm=(0.0, stack.height * stack.pixel_mm[1]))


def shape_of(stack: LayerStack, layer: Layer) -> MultiPolygon:
    """The exact pixels of a layer, in mm."""
    return outline(layer, stack.pixel_mm, stack.origin_mm, 0.0)


def beads_on(image: np.ndarray, settings: PathSettings = NO_SKIRT, width_mm: float | None = None) -> LayerPaths:
    """The beads of an image that is the only layer, so all solid."""
    return lf.plan_toolpaths(stack_of(image), settings, width_mm=width_mm)[0]


def area_of(paths: Iterable[Path]) -> Geometry:
    """What the beads cover: each piece as wide as it is, its ends round."""
    pieces = []
    for path in paths:
        strokes = shapely.linestrings(np.stack([path.points_mm[:-1], path.points_mm[1:]], axis=1))
        pieces.append(shapely.buffer(strokes, path.width_mm / 2, quad_segs=6))
    return shapely.union_all(np.concatenate(pieces)) if pieces else shapely.Polygon()


def lines_of(paths: Iterable[Path]) -> Geometry:
    """The way of the nozzle's middle."""
    return shapely.union_all([shapely.linestrings(path.points_mm) for path in paths])


@dataclass(frozen=True)
class Proof:
    """What beads do to a shape."""

    iou: float
    covered: float  # share of the shape
    outside: float  # share of the shape's area that is covered beside it
    least_component: float  # share covered of the part that is covered least
    narrowest_mm: float
    widest_mm: float
    volume_over_covered: float  # volume over the covered area times the height
    volume_over_shape: float
    astray_mm: float  # length of the nozzle's way outside


def proof(paths: Iterable[Path], shape: Geometry, layer_mm: float = LAYER_MM) -> Proof:
    """Lay the beads on the shape again."""
    paths = list(paths)
    beads, volume = area_of(paths), volume_mm3(paths, layer_mm)
    inside = shapely.intersection(beads, shape).area
    parts = shapely.get_parts(shape)
    widths = np.concatenate([path.width_mm for path in paths])
    return Proof(
        iou=inside / (beads.area + shape.area - inside),
        covered=inside / shape.area,
        outside=(beads.area - inside) / shape.area,
        least_component=float((shapely.area(shapely.intersection(parts, beads)) / shapely.area(parts)).min()),
        narrowest_mm=float(widths.min()),
        widest_mm=float(widths.max()),
        volume_over_covered=volume / (beads.area * layer_mm),
        volume_over_shape=volume / (shape.area * layer_mm),
        astray_mm=float(shapely.difference(lines_of(paths), shape).length),
    )


def main_width(paths: list[Path]) -> float:
    """The width of most of the beads' length: its median by length."""
    width = np.concatenate([p.width_mm for p in paths])
    length = np.concatenate([p.lengths_mm for p in paths])
    order = np.argsort(width)
    return float(width[order][np.searchsorted(np.cumsum(length[order]), length.sum() / 2)])
