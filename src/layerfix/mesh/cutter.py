"""A mesh on the grid of pixels and layers, and its cuts.

Grid: pixel (row j, column i) has its centre at (i, j); x and y are snapped to 1/1024 px, which closes the
hairline cracks of STL files. z is counted in quanta of a decimal fraction of a layer, so that vertices
given in decimals meet planes given in decimals exactly.

No vertex is ever "on" a plane or a pixel row: above means z > plane, and a row belongs to an edge if
y0 ≤ row < y1, a column to the solid if it is at or past the crossing (half-open everywhere). Every edge is
interpolated from its lower end, so both its triangles get the bit-identical point and closed meshes give
closed rows.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import WORK
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.mesh.closing import edges_balance, orient
from layerfix.mesh.doubles import without_doubles
from layerfix.mesh.facet_runs import HEIGHTS, INDICES, POINTS, TRIANGLES, by_slabs
from layerfix.mesh.fill import SEGMENTS, below, fill
from layerfix.mesh.pieces import CONTOURS, PLACES, fill_pieces
from layerfix.mesh.sheets import LEAST
from layerfix.stack import layer_bounds_mm
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh

SNAP_PER_PX = 1024
SLAB_LAYERS = 16  # layers that share one list of triangles: 4 % of the memory of a list per layer
MAX_FRAME_PX = 2**31
CHUNK = 1 << 20  # vertices that are put on the grid at once: 24 MB


@dataclass(frozen=True, eq=False)
class Grid:
    """Where layers and pixels are."""

    pitch: tuple[float, float]
    origin: tuple[float, float]
    shape: tuple[int, int]  # of packed rows
    width: int
    lowest_mm: float  # z of the part's lowest point, which becomes 0
    z_mm: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cutter:
    """A mesh on the grid, with the triangles sorted into slabs of layers."""

    points: NDArray[np.float64]  # (n, 3) column, row, z quanta
    faces: NDArray[np.int32]
    planes: NDArray[np.float64]  # (layers,) z quanta of the mid-planes
    bounds: NDArray[np.float64]  # (layers, 2) of bottoms and tops
    slab_starts: NDArray[np.int64]
    slab_faces: NDArray[np.int32]
    closed: bool

    def facets(self, index: int) -> NDArray[np.int32]:
        """Those that a layer's mid-plane may cut."""
        slab = index // SLAB_LAYERS
        return self.slab_faces[self.slab_starts[slab] : self.slab_starts[slab + 1]]

    def segments(self, index: int) -> NDArray[np.float64]:
        segments: NDArray[np.float64] = cut(self.points, self.faces, self.facets(index), self.planes[index])
        return segments


@njit(types.UniTuple(types.int64, 2)(HEIGHTS, types.float64, types.float64), cache=True, nogil=True)
def _planes_cut(planes, low, high):  # type: ignore[no-untyped-def]  # numba types it
    """Planes k with low ≤ planes[k] < high, as (first, past the last)."""
    return below(planes, low), below(planes, high)


@njit(
    types.Tuple((types.Array(types.int64, 1, "C"), types.Array(types.int32, 1, "C")))(
        POINTS, TRIANGLES, HEIGHTS, types.int64
    ),
    cache=True,
    nogil=True,
)
def bucket(points, faces, planes, slab_layers):  # type: ignore[no-untyped-def]  # numba types it
    """Triangles cut by any plane of each slab: (starts, faces), CSR."""
    reach = np.zeros((faces.shape[0], 2), np.int32)
    for t in range(faces.shape[0]):
        a, b, c = points[faces[t, 0], 2], points[faces[t, 1], 2], points[faces[t, 2], 2]
        first, stop = _planes_cut(planes, min(a, b, c), max(a, b, c))
        if stop > first:
            reach[t, 0], reach[t, 1] = first // slab_layers, (stop - 1) // slab_layers + 1
    return by_slabs(reach, (planes.shape[0] + slab_layers - 1) // slab_layers)


@njit(SEGMENTS(POINTS, TRIANGLES, INDICES, types.float64), cache=True, nogil=True)
def cut(points, faces, chosen, plane):  # type: ignore[no-untyped-def]  # numba types it
    """Segments in which `plane` cuts the chosen triangles: (n, 4) x, y of start and end, solid on the left
    (of x right, y up) for triangles that face outwards."""
    out = np.empty((chosen.shape[0], 4), np.float64)
    n = 0
    for p in range(chosen.shape[0]):
        t = chosen[p]
        crossings = 0
        for e in range(3):
            a, b = faces[t, e], faces[t, 0 if e == 2 else e + 1]
            az, bz = points[a, 2], points[b, 2]
            if (az > plane) == (bz > plane):
                continue
            crossings += 1
            if bz > plane:
                s = (plane - az) / (bz - az)
                out[n, 2] = points[a, 0] + s * (points[b, 0] - points[a, 0])
                out[n, 3] = points[a, 1] + s * (points[b, 1] - points[a, 1])
            else:
                s = (plane - bz) / (az - bz)
                out[n, 0] = points[b, 0] + s * (points[a, 0] - points[b, 0])
                out[n, 1] = points[b, 1] + s * (points[a, 1] - points[b, 1])
        if crossings:
            n += 1
    return out[:n].copy()


@njit(
    types.Tuple((types.int64, types.int64, PLACES, types.boolean, SEGMENTS, CONTOURS))(
        POINTS, TRIANGLES, INDICES, types.float64, types.int64, types.int64, types.boolean, WORK
    ),
    cache=True,
    nogil=True,
)
def fill_cut(points, faces, chosen, plane, width, rule, hairlines, rows):  # type: ignore[no-untyped-def]  # numba types it
    """`cut` and `fill` of a closed surface: (segments, pixels of hairlines, middles of small pieces, whether pieces
    may have been joined, and if so, the segments and their contours); the latter only if `hairlines`."""
    segments = cut(points, faces, chosen, plane)
    if segments.shape[0] == 0 or not hairlines:
        added = fill(segments, width, rule, False, rows) if segments.shape[0] else 0
        none = np.empty(0, np.int64)
        contours = none, none, np.empty((0, 7)), none, none
        return segments.shape[0], added, np.empty((0, 2), np.int64), False, segments[:0], contours
    added, small, joined, contours = fill_pieces(segments, width, rule, rows)
    return segments.shape[0], added, small, joined, segments if joined else segments[:0], contours


def frame_of(
    mesh: Mesh, pitch: tuple[float, float], margin_mm: float, frame_px: tuple[int, int] | None
) -> tuple[int, int, tuple[float, float]]:
    """(width, height, origin): pixel edges lie on whole multiples of the pitch, so boxes drawn on it stay exact."""
    (x0, y0, _), (x1, y1, _) = mesh.bounds_mm.tolist()
    if frame_px is None:
        left = _floor((x0 - margin_mm) / pitch[0])
        top = -_floor(-(y1 + margin_mm) / pitch[1])
        width = -_floor(-(x1 + margin_mm) / pitch[0]) - left
        height = top - _floor((y0 - margin_mm) / pitch[1])
    else:
        try:
            width, height = map(operator.index, frame_px)
        except (TypeError, ValueError):
            raise InputError(f"frame of {frame_px} px: it is two whole numbers, (width, height)") from None
        if x1 - x0 > width * pitch[0] * (1 + 1e-9) or y1 - y0 > height * pitch[1] * (1 + 1e-9):
            raise InputError(
                f"{mesh.name}: the part is {x1 - x0:.4g} × {y1 - y0:.4g} mm,"
                f" the printer's area {width * pitch[0]:.4g} × {height * pitch[1]:.4g} mm"
            )
        left = round((x0 + x1) / 2 / pitch[0] - width / 2)
        top = round((y0 + y1) / 2 / pitch[1] + height / 2)
    width, height = max(width, 1), max(height, 1)
    if width * height > MAX_FRAME_PX:
        raise InputError(
            f"{mesh.name}: {x1 - x0:.4g} × {y1 - y0:.4g} mm in pixels of {format_mm(min(pitch))} is a layer of"
            f" {width} × {height} px, above the limit of {MAX_FRAME_PX}; use larger pixels"
        )
    return width, height, (left * pitch[0], top * pitch[1])


def _floor(value_px: float) -> int:
    """Floor of what is snapped as the vertices are: a part read from 32-bit floats has the same frame."""
    return math.floor(round(value_px * SNAP_PER_PX) / SNAP_PER_PX)


def layers_of(mesh: Mesh, layer_mm: float, first_layer_mm: float | None, rescued: bool) -> NDArray[np.float64]:
    """Bounds of the layers whose mid-plane is inside the part; one at least, which may be met by none if what is so
    is rescued."""
    layer_bounds_mm(1, layer_mm, first_layer_mm)  # checks both heights
    first = layer_mm if first_layer_mm is None else first_layer_mm
    x, y, z = mesh.size_mm
    if min(x, y, z) <= 0:
        raise InputError(f"{mesh.name}: the part is {x:.4g} × {y:.4g} × {z:.4g} mm; it has no thickness")
    share, words = (LEAST, "a quarter of") if rescued else (0.5, "half")
    if z <= first * share:
        raise InputError(
            f"{mesh.name}: the part is {format_mm(z)} tall, under {words} the first layer of {format_mm(first)};"
            " use a smaller layer height"
        )
    count = 1 + max(0, math.ceil(round((z - first) / layer_mm, 4) - 0.5))
    if count > 1_000_000:
        raise InputError(f"{mesh.name}: {z:.4g} mm in layers of {format_mm(layer_mm)} is {count} layers")
    return layer_bounds_mm(count, layer_mm, first_layer_mm)


def cutter_of(mesh: Mesh, grid: Grid) -> Cutter:
    """A mesh on a grid: snapped, without doubled faces, facing outwards where that can be told, sorted into slabs."""
    z_mm = grid.z_mm
    quantum = quantum_of(z_mm)
    points = np.empty_like(mesh.vertices)
    for start in range(0, len(points), CHUNK):
        vertices, out = mesh.vertices[start : start + CHUNK], points[start : start + CHUNK]
        out[:, 0] = (vertices[:, 0] - grid.origin[0]) / grid.pitch[0] - 0.5
        out[:, 1] = (grid.origin[1] - vertices[:, 1]) / grid.pitch[1] - 0.5
        out[:, :2] = np.round(out[:, :2] * SNAP_PER_PX) / SNAP_PER_PX
        out[:, 2] = np.round((vertices[:, 2] - grid.lowest_mm) / quantum)
    planes = np.round(z_mm.mean(axis=1) / quantum, 1)
    faces = without_doubles(points, mesh.faces)
    closed = edges_balance(points, faces)
    if not closed:
        faces = orient(points, faces)
        closed = edges_balance(points, faces)
    starts, chosen = bucket(points, faces, planes, SLAB_LAYERS)
    return Cutter(points, faces, planes, z_mm / quantum, starts, chosen, closed)


def pixels_and_planes(
    mesh: Mesh,
    *,
    pixel_mm: tuple[float, float],
    layer_mm: float,
    first_layer_mm: float | None,
    margin_mm: float,
) -> tuple[int, int, tuple[float, float], NDArray[np.float64], float, NDArray[np.float64]]:
    """(width, height, origin, layers' bounds, z quantum, mid-planes in quanta) that `slice_mesh` takes for a mesh.

    For those who cut one thousands of times and need no Layers.
    """
    width, height, origin = frame_of(mesh, pixel_mm, margin_mm, None)
    z_mm = layers_of(mesh, layer_mm, first_layer_mm, rescued=False)
    quantum = quantum_of(z_mm)
    return width, height, origin, z_mm, quantum, np.round(z_mm.mean(axis=1) / quantum, 1)


def quantum_of(z_mm: NDArray[np.float64]) -> float:
    """What z is counted in: a decimal fraction of the lowest layer."""
    return float(10.0 ** (math.floor(math.log10(float((z_mm[:, 1] - z_mm[:, 0]).min()))) - 4))
