"""Outlines for tests: shapely's shapes as a slicer's rings, and back; random ones."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import affinity

UNIT_MM = 1e-6


def rings(shape: shapely.Geometry, unit_mm: float = UNIT_MM) -> list[list[np.ndarray]]:
    """Polygons as lists of int64 rings, outer ones counter-clockwise, holes clockwise."""
    return [
        [
            np.rint(shapely.get_coordinates(ring)[:-1] / unit_mm).astype(np.int64)
            for ring in (one.exterior, *one.interiors)
        ]
        for one in shapely.get_parts(shapely.orient_polygons(shape))
        if one.geom_type == "Polygon" and one.area > 0
    ]


def shape_of(region: list[list[np.ndarray]]) -> shapely.Geometry:
    """The area of a region, in its own units."""
    return shapely.union_all([shapely.Polygon(polygon[0], polygon[1:]) for polygon in region])


def random_part(rng: np.random.Generator, size_mm: float = 12.0) -> shapely.Geometry:
    """Bars, lines, triangles and holes of all widths. No gap is so narrow that pixels of 0.05 mm would close it."""
    shapes = []
    for _ in range(rng.integers(1, 8)):
        x, y = rng.uniform(0, size_mm, 2)
        kind = rng.integers(0, 4)
        if kind < 2:
            bar = shapely.box(x, y, x + rng.uniform(0.05, 6), y + rng.uniform(0.05, 6))
            shapes.append(affinity.rotate(bar, rng.uniform(0, 90)))
        elif kind == 2:
            line = shapely.LineString(rng.uniform(0, size_mm, (rng.integers(2, 4), 2)))
            shapes.append(line.buffer(rng.uniform(0.03, 0.6)))
        else:
            shapes.append(shapely.Polygon(np.array([x, y]) + rng.uniform(-3, 3, (3, 2))))
    part = shapely.union_all(shapes)
    for _ in range(rng.integers(0, 4)):
        part = part.difference(shapely.Point(rng.uniform(0, size_mm, 2)).buffer(rng.uniform(0.1, 1.5)))
    gap_mm = 0.08
    return part.buffer(gap_mm, join_style="round", quad_segs=2).buffer(-gap_mm, join_style="mitre")
