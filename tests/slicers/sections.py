"""Sections of a mesh as polygons, worked out without the package under test."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from layerfix.mesh.triangles import Mesh

ROUNDING_MM2 = 2e-5  # slivers under this come from rounding
DECIMALS = 7  # of a mm: nearer points are one


def layer_planes(mesh: Mesh, layer_mm: float) -> NDArray[np.float64]:
    """z of the middle of each layer below the top, from z = 0."""
    count = int(np.ceil(mesh.bounds_mm[1, 2] / layer_mm - 0.5 - 1e-9))
    planes: NDArray[np.float64] = (np.arange(count) + 0.5) * layer_mm
    return planes


def components(mesh: Mesh, z_mm: float) -> NDArray[np.object_]:
    """The polygons of the solid at z: what the surface winds round, so that overlapping bodies are one."""
    segments = cut(mesh, z_mm)
    if not len(segments):
        return np.empty(0, np.object_)
    segments = np.concatenate([segments, closing(segments)])
    lines = shapely.linestrings(segments)
    cells = shapely.get_parts(shapely.polygonize([shapely.union_all(lines)]))
    if not len(cells):
        return np.empty(0, np.object_)
    inside = shapely.get_coordinates(shapely.point_on_surface(cells))
    solid = cells[winding(segments, inside) != 0]
    parts: NDArray[np.object_] = shapely.get_parts(shapely.union_all(solid))
    large: NDArray[np.bool_] = shapely.area(parts) >= ROUNDING_MM2
    return parts[large]


def cut(mesh: Mesh, z_mm: float) -> NDArray[np.float64]:
    """(n, 2, 2): where triangles cross the plane, from start to end with the solid on the left.

    A corner in the plane counts as below it. Edges are walked upwards, so that neighbours agree on every point.
    """
    z = mesh.vertices[:, 2][mesh.faces]
    faces = mesh.faces[(z.min(axis=1) <= z_mm) & (z.max(axis=1) > z_mm)]
    ends = np.empty((len(faces), 2, 2))
    for k in range(3):
        a, b = mesh.vertices[faces[:, k]], mesh.vertices[faces[:, (k + 1) % 3]]
        for side, low, high in ((1, a, b), (0, b, a)):  # a triangle's rising edge ends its segment
            crosses = (low[:, 2] <= z_mm) & (high[:, 2] > z_mm)
            p, q = low[crosses], high[crosses]
            share = (z_mm - p[:, 2]) / (q[:, 2] - p[:, 2])
            ends[crosses, side] = p[:, :2] + share[:, None] * (q[:, :2] - p[:, :2])
    ends = np.round(ends, DECIMALS)
    longer_than_0: NDArray[np.bool_] = (ends[:, 0] != ends[:, 1]).any(axis=1)
    return ends[longer_than_0]


def closing(segments: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 2, 2): segments from where lines stop to where lines begin, of a mesh with gaps; the shortest in all."""
    points, which = np.unique(segments.reshape(-1, 2), axis=0, return_inverse=True)
    stops = np.bincount(which.reshape(-1, 2)[:, 1], minlength=len(points))
    excess = stops - np.bincount(which.reshape(-1, 2)[:, 0], minlength=len(points))
    loose_ends = np.repeat(points, np.maximum(excess, 0), axis=0)
    loose_starts = np.repeat(points, np.maximum(-excess, 0), axis=0)
    a, b = linear_sum_assignment(cdist(loose_ends, loose_starts))
    return np.stack([loose_ends[a], loose_starts[b]], axis=1)


def winding(segments: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.int64]:
    """How often closed lines go round each of (n, 2) points: the sum of the angles it sees them under."""
    turns = np.empty(len(points))
    for k, point in enumerate(points):
        (ax, ay), (bx, by) = (segments[:, 0] - point).T, (segments[:, 1] - point).T
        turns[k] = np.arctan2(ax * by - ay * bx, ax * bx + ay * by).sum()
    return np.rint(turns / (2 * np.pi)).astype(np.int64)
