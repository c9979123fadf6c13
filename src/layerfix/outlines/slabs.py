"""A stack as a body: each layer's polygons, as high as the layer, one on top of the other.

No boolean operations: slabs share faces where they meet, which slicers read as one solid. Every cut between two
faces gives exactly the layer, whatever slices it. Layers that are the same make one slab.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from shapely import MultiPolygon

    from layerfix.outlines.contours import Contours
    from layerfix.stack import Layer

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]


BRIDGE_MM = 0.01  # at most half the width of a bridge between rings that touch: below any bead, above rounding


@dataclass(frozen=True, eq=False)
class Slab:
    """One closed body of prisms: (n, 3) vertices in mm and (m, 3) faces, counter-clockwise from outside."""

    vertices: Floats
    faces: Indices


def slabs(contours: Contours) -> Iterator[tuple[list[Layer], Slab | None]]:
    """The layers (without pixels) of each slab, and the slab (None where they are empty), from the bottom up."""
    bridge_mm = min(BRIDGE_MM, min(contours.stack.pixel_mm) / 4)
    below: list[Layer] = []
    last: Layer | None = None
    outlines: MultiPolygon | None = None
    for layer, polygons in contours.each():
        alike = last is not None and last.z_mm[1] == layer.z_mm[0] and np.array_equal(last.rows, layer.rows)
        if not alike and outlines is not None:
            yield below, _slab(outlines, below[0].z_mm[0], below[-1].z_mm[1], bridge_mm)
            below = []
        below.append(layer.without_pixels())
        last, outlines = layer, polygons
    if outlines is not None:
        yield below, _slab(outlines, below[0].z_mm[0], below[-1].z_mm[1], bridge_mm)


def _slab(outlines: MultiPolygon, bottom_mm: float, top_mm: float, bridge_mm: float) -> Slab | None:
    import shapely

    polygons = shapely.get_parts(_bridged(outlines, bridge_mm))
    if not len(polygons):
        return None
    corners, owner = _triangles(polygons)
    rings = shapely.get_rings(polygons)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    ends = np.flatnonzero(np.diff(ring, append=len(rings)))
    walls = np.delete(np.arange(len(points)), ends)  # the last point of a ring is its first
    ring_owner = np.repeat(np.arange(len(polygons)), 1 + shapely.get_num_interior_rings(polygons))
    # A corner is one vertex, but not that of another polygon that touches there.
    keyed = np.concatenate(
        [np.column_stack([ring_owner[ring], points]), np.column_stack([np.repeat(owner, 3), corners.reshape(-1, 2)])]
    )
    unique, number = np.unique(keyed, axis=0, return_inverse=True)
    count = len(unique)
    along = number[: len(points)]
    a, b = along[walls], along[walls + 1]
    flat = number[len(points) :].reshape(-1, 3)
    faces = [flat[:, ::-1], flat + count, np.stack([a, b, b + count], 1), np.stack([a, b + count, a + count], 1)]
    vertices = np.empty((2 * count, 3))
    vertices[:, :2] = np.tile(unique[:, 1:], (2, 1))
    vertices[:count, 2], vertices[count:, 2] = bottom_mm, top_mm
    return Slab(vertices, np.concatenate(faces))


def _bridged(outlines: MultiPolygon, bridge_mm: float) -> MultiPolygon:
    """The outlines with a tiny bridge wherever rings touch at a corner.

    There four walls would share one upright edge, and slic3r 1.3 drops the whole part that it is on.
    """
    import shapely

    rings = shapely.get_rings(shapely.get_parts(outlines))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    first = np.diff(ring, prepend=-1) > 0  # a ring's first point comes again as its last
    unique, times = np.unique(points[~first], axis=0, return_counts=True)
    corners = unique[times > 1]
    if not len(corners):
        return outlines
    bridges = shapely.buffer(shapely.points(corners), bridge_mm, quad_segs=1)
    joined = shapely.union_all([outlines, *bridges])
    return shapely.orient_polygons(joined)


def _triangles(polygons: NDArray[np.object_]) -> tuple[Floats, Indices]:
    """(t, 3, 2) corners of counter-clockwise triangles that cover the polygons, and whose each is."""
    import shapely

    parts, owner = shapely.get_parts(shapely.constrained_delaunay_triangles(polygons), return_index=True)
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    corners[clockwise] = corners[clockwise][:, ::-1]
    return corners, owner
