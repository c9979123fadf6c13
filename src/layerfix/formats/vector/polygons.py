"""What writers of outlines share: the part seen from above as rings of points, layer after layer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from layerfix.formats.encoding import encoded

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from shapely import MultiPolygon

    from layerfix.formats.options import OutlineOptions
    from layerfix.stack import LayerStack

    # A closed ring of x, y in mm; its first point is its last. A polygon is its outer ring, counter-clockwise,
    # and then its holes, clockwise.
    Ring = NDArray[np.float64]
    Polygon = list[Ring]

Data = TypeVar("Data")
DIGITS = 4  # of a mm: half a pixel of 19 µm is still exact


def outlined(
    stack: LayerStack, options: OutlineOptions, encode: Callable[[list[Polygon]], Data]
) -> Iterator[tuple[tuple[float, float], Data]]:
    """Each layer's (bottom, top) in mm and `encode` of its polygons, which the stack's threads make.

    Raises InputError for a tolerance that `trace_contours` refuses.
    """
    from layerfix.outlines.contours import trace_contours

    contours = trace_contours(stack, tolerance_mm=options.tolerance_mm)
    every = encoded(contours.stack, lambda layer: encode(polygons(contours.of(layer))), options.watch, once=True)
    return zip(stack.z_mm.tolist(), every, strict=True)


def polygons(outlines: MultiPolygon) -> list[Polygon]:
    """The rings of each polygon, rounded to DIGITS."""
    import shapely

    if outlines.is_empty:
        return []
    _, points, (ring_starts, polygon_starts, _) = shapely.to_ragged_array([outlines])
    rings = np.split(np.round(points, DIGITS) + 0.0, ring_starts[1:-1])  # + 0.0: no "-0.0"
    return [rings[a:b] for a, b in pairwise(polygon_starts)]


def number(value: float) -> str:
    """A length in mm without zeros at its end: ``0.3``, ``12``."""
    return f"{round(value, DIGITS) + 0.0:.{DIGITS}f}".rstrip("0").rstrip(".")
