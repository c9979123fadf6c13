"""Directions worth a look because of the part's shape: its axes, its large faces, and what it can stand on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.orientation.directions import distinct

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh

SAME = np.radians(2.0)  # faces whose normals differ by less are one
COSINE_BINS = 1 << 6  # of normals, along each axis, before they are put together


def facets(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(unit normals (n, 3), areas (n,) in mm², corners (n, 3, 3)) of the triangles that have a size."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    sized = lengths > 0
    return normals[sized] / lengths[sized, None], lengths[sized] / 2, corners[sized]


def large_faces(normals: NDArray[np.float64], areas: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """(k, 3): mean directions of the normals that hold most area, the largest first; opposite ones are one."""
    turned = np.where((_sign(normals) < 0)[:, None], -normals, normals)
    bins = np.round(turned * COSINE_BINS).astype(np.int64)
    _, first, group = np.unique(bins, axis=0, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    sums = np.column_stack([np.bincount(group, turned[:, k] * areas, len(first)) for k in range(3)])
    held = np.bincount(group, areas, len(first))
    order = np.argsort(-held, kind="stable")[: 8 * most]
    directions = sums[order] / np.maximum(np.linalg.norm(sums[order], axis=1), 1e-300)[:, None]
    kept = distinct(directions, SAME)[:most]
    found: NDArray[np.float64] = directions[kept]
    return found


def resting_faces(mesh: Mesh, most: int) -> NDArray[np.float64]:
    """(k, 3): directions of the largest faces of the convex hull, on which the part would stand."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(mesh.vertices)
    corners = mesh.vertices[hull.simplices]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return large_faces(hull.equations[:, :3], areas, most)


def structured(mesh: Mesh, normals: int = 10, resting: int = 10) -> list[NDArray[np.float64]]:
    """Distinct directions: z, x, y, then the largest faces, then those of the convex hull."""
    unit_normals, areas, _ = facets(mesh)
    found = [*np.eye(3)[[2, 0, 1]], *large_faces(unit_normals, areas, normals), *resting_faces(mesh, resting)]
    return [found[k] for k in distinct(found, SAME)]


def _sign(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sign of the first coordinate, from z on, that is not about 0: the same axis has one sign."""
    x, y, z = vectors.T
    sign: NDArray[np.float64] = np.where(np.abs(z) > 1e-6, z, np.where(np.abs(y) > 1e-6, y, x))
    return sign
