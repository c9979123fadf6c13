"""The boundary of a stack's voxels as a mesh (the paper's own output), which slices back to the same pixels.

Each vertex is on an edge between the centres of two neighbouring voxels, one solid and one not. Wherever on its edge
it is, no cut at a layer's middle gains or loses a pixel. So the vertices may be moved along their edges: onto the
input's own surface where that crosses the edge, which it does wherever nothing was corrected, or by smoothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.mesh.fill import below, not_above
from layerfix.mesh.triangles import Mesh
from layerfix.surface.cubes import EDGES, march

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer, LayerStack

    Floats = NDArray[np.float64]
    Watch = Callable[[int, Layer], None]

CLOSEST = 1 / 512  # of an edge, that a vertex keeps from its ends: slicing rounds to 1/1024 px
PASSES = 12  # of smoothing, each a step in and a step out (Taubin 1995): stairs of eight pixels become slopes
STEP_IN, STEP_OUT = 0.5, -0.53
LOSSLESS_PX = 1e-3  # how far simplification may move the surface without a pixel noticing

SHARES = types.Array(types.float64, 1, "C")
POSITIONS = types.Array(types.float64, 1, "C")
PLACES = types.Array(types.float64, 2, "C")
TRIANGLES = types.Array(types.int32, 2, "C", readonly=True)
CORNERS = types.Array(types.float64, 3, "C", readonly=True)
SAMPLES = types.Array(types.float64, 1, "C", readonly=True)
KEYS = types.Array(types.int64, 1, "C")


@dataclass(frozen=True, eq=False)
class VoxelSurface:
    """A surface whose vertices are on edges of the grid of voxel centres.

    edges    (n, 4) int32: column, row and layer of the lower end, and the axis (0 x, 1 y (down), 2 z)
    shares   (n,) float64 in (0, 1): where on its edge each vertex is, from the lower end
    faces    (m, 3) int32, counter-clockwise from outside
    centres  (x, y, z): places in mm of the voxel centres along each axis, with one more at both ends
    """

    edges: NDArray[np.int32]
    shares: Floats
    faces: NDArray[np.int32]
    centres: tuple[Floats, Floats, Floats]

    def vertices_mm(self) -> Floats:
        """(n, 3) float64."""
        out = np.empty((len(self.edges), 3))
        for axis, centres in enumerate(self.centres):
            at = self.edges[:, axis] + 1
            out[:, axis] = centres[at]
            mine = self.edges[:, 3] == axis
            out[mine, axis] += self.shares[mine] * (centres[at[mine] + 1] - centres[at[mine]])
        return out


def voxel_surface(stack: LayerStack, watch: Watch | None = None) -> VoxelSurface:
    """The boundary of the voxels of a stack, cut through the middles of grid edges, and at the layers' bounds in z.

    Several exposures of one height count as their union. Raises InputError if all layers are empty.
    """
    patches = list(march(_heights(stack, watch), (stack.height, 0), stack.width))
    edges = np.concatenate([patch.edges for patch in patches])
    faces = np.concatenate([patch.faces for patch in patches])
    if not len(faces):
        raise InputError("every layer is empty, so there is no surface")
    grid = grid_of(stack)
    return VoxelSurface(edges, grid.middle_shares(edges), faces, grid.centres)


@dataclass(frozen=True, eq=False)
class Grid:
    """Where voxels are.

    centres  (x, y, z): places in mm of the voxel centres along each axis, with one more at both ends
    bounds   (layers + 1,) z in mm, between one layer and the next
    """

    centres: tuple[Floats, Floats, Floats]
    bounds: Floats

    def middle_shares(self, edges: NDArray[np.int32]) -> Floats:
        """(n,) where on their edges vertices are that lie between two pixels, and at the layers' bounds."""
        shares = np.full(len(edges), 0.5)
        upright = edges[:, 3] == 2
        z, k = self.centres[2], edges[upright, 2] + 1
        shares[upright] = (self.bounds[k] - z[k]) / (z[k + 1] - z[k])
        return shares


def grid_of(stack: LayerStack) -> Grid:
    """The voxels of a stack; exposures of one height are one layer of them."""
    x = (np.arange(-1, stack.width + 1, dtype=np.float64) + 0.5) * stack.pixel_mm[0] + stack.origin_mm[0]
    y = -(np.arange(-1, stack.height + 1, dtype=np.float64) + 0.5) * stack.pixel_mm[1] + stack.origin_mm[1]
    bounds = stack.z_mm[_is_first(stack)]
    middles: Floats = bounds.mean(axis=1)
    low, high = bounds[0, 1] - bounds[0, 0], bounds[-1, 1] - bounds[-1, 0]
    z: Floats = np.concatenate([[middles[0] - low], middles, [middles[-1] + high]])
    between = (np.append(bounds[:, 0], bounds[-1, 1]) + np.append(bounds[0, 0], bounds[:, 1])) / 2
    return Grid((x, y, z), between)


def _is_first(stack: LayerStack) -> NDArray[np.bool_]:
    """(layers,) bool: not one more exposure of the layer before."""
    again = (stack.z_mm[1:] == stack.z_mm[:-1]).all(axis=1)
    return np.concatenate([[True], ~again])


def _heights(stack: LayerStack, watch: Watch | None) -> Iterator[Rows]:
    """Packed rows of each height, from the bottom up."""
    first = _is_first(stack)
    union: Rows | None = None
    for index, layer in enumerate(stack):
        if watch is not None:
            watch(index, layer.without_pixels())
        if first[index] and union is not None:
            yield union
        union = layer.rows if first[index] or union is None else union | layer.rows
    if union is not None:
        yield union


@njit(types.void(EDGES, TRIANGLES, PLACES, SHARES), cache=True, nogil=True)
def _pull(edges, faces, places, pull):  # type: ignore[no-untyped-def]  # numba types it
    """pull[v] = how far the mean of a vertex's neighbours is from it, along its own axis."""
    count = np.zeros(len(edges), np.int64)
    pull[:] = 0.0
    for t in range(len(faces)):
        for corner in range(3):
            v = faces[t, corner]
            axis = edges[v, 3]
            for other in (faces[t, (corner + 1) % 3], faces[t, (corner + 2) % 3]):
                pull[v] += places[other, axis] - places[v, axis]
            count[v] += 2
    for v in range(len(edges)):
        if count[v]:
            pull[v] /= count[v]


def smoothed(surface: VoxelSurface, moving: NDArray[np.bool_] | None = None) -> VoxelSurface:
    """The surface with the stairs of its pixels smoothed, and every pixel as before.

    moving  (n,) bool: which vertices may move
    """
    edges, faces = surface.edges, surface.faces
    shares = surface.shares.copy()
    places = surface.vertices_mm()
    pull = np.empty(len(edges))
    each = np.arange(len(edges))
    axis = edges[:, 3]
    start = np.empty(len(edges))
    length = np.empty(len(edges))
    for a, centres in enumerate(surface.centres):
        mine = axis == a
        at = edges[mine, a] + 1
        start[mine], length[mine] = centres[at], centres[at + 1] - centres[at]
    for _ in range(PASSES):
        for step in (STEP_IN, STEP_OUT):
            _pull(edges, faces, places, pull)
            if moving is not None:
                pull[~moving] = 0.0
            shares = np.clip(shares + step * pull / length, CLOSEST, 1 - CLOSEST)
            places[each, axis] = start + shares * length
    return replace(surface, shares=shares)


def ends_of(surface: VoxelSurface) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Two (n,) bool: vertices below the lowest solid voxels, and above the highest."""
    upright = surface.edges[:, 3] == 2
    level = surface.edges[:, 2]
    return upright & (level == level[upright].min()), upright & (level == level[upright].max())


def reaching_bounds(surface: VoxelSurface, bounds: Floats) -> VoxelSurface:
    """The surface with its lowest vertex on the lower bound of the lowest layer, and its highest on the upper one.

    Slicers begin at the lowest point: on the input's round bottom, every layer would be cut a little too high.
    bounds  of the stack's grid
    """
    shares = surface.shares.copy()
    z, centres = surface.vertices_mm()[:, 2], surface.centres[2]
    for end, sign in zip(ends_of(surface), (1.0, -1.0), strict=True):
        of_end = np.flatnonzero(end)
        v = of_end[np.argmin(sign * z[of_end])]
        k = int(surface.edges[v, 2]) + 1
        if sign * (z[v] - bounds[k]) > 0:
            shares[v] = (bounds[k] - centres[k]) / (centres[k + 1] - centres[k])
    return replace(surface, shares=shares)


@njit(types.int64(CORNERS, SAMPLES, SAMPLES, SAMPLES, KEYS, POSITIONS), cache=True, nogil=True)
def _met(corners, along, us, vs, keys, places):  # type: ignore[no-untyped-def]  # numba types it
    """Where triangles (axes rolled: along, u, v) meet the lines through the samples of u and v; how often.

    keys    which edge between two samples of `along` it is in
    places  on `along`
    All three rise. Both are filled as far as they reach.
    """
    n = 0
    for t in range(corners.shape[0]):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        area = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        if area == 0.0:
            continue
        j = below(us, min(a[1], b[1], c[1]))
        last_u, first_v, last_v = max(a[1], b[1], c[1]), min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
        first_k = below(vs, first_v)
        while j < us.shape[0] and us[j] <= last_u:
            k = first_k
            while k < vs.shape[0] and vs[k] <= last_v:
                p = ((us[j] - a[1]) * (c[2] - a[2]) - (vs[k] - a[2]) * (c[1] - a[1])) / area
                q = ((b[1] - a[1]) * (vs[k] - a[2]) - (b[2] - a[2]) * (us[j] - a[1])) / area
                if p >= -1e-9 and q >= -1e-9 and p + q <= 1 + 1e-9:
                    place = a[0] + p * (b[0] - a[0]) + q * (c[0] - a[0])
                    i = not_above(along, place) - 1
                    if 0 <= i < along.shape[0] - 1:
                        if n < keys.shape[0]:
                            keys[n] = (i * us.shape[0] + j) * vs.shape[0] + k
                            places[n] = place
                        n += 1
                k += 1
            j += 1
    return n


def snapped(surface: VoxelSurface, mesh: Mesh) -> tuple[VoxelSurface, NDArray[np.bool_]]:
    """The surface with its vertices on the mesh wherever the mesh crosses their edges; and (n,) bool, which do.

    mesh  what was sliced, at the stack's place
    """
    shares, on_mesh = surface.shares.copy(), np.zeros(len(surface.edges), np.bool_)
    corners = mesh.vertices[mesh.faces]
    signs = [1.0 if centres[-1] > centres[0] else -1.0 for centres in surface.centres]
    rising = [np.ascontiguousarray(sign * centres) for sign, centres in zip(signs, surface.centres, strict=True)]
    for axis in range(3):
        order = [axis, (axis + 1) % 3, (axis + 2) % 3]
        rolled = np.ascontiguousarray(corners[:, :, order] * np.array(signs)[order])
        lines = [rising[a] for a in order]
        count = _met(rolled, *lines, np.empty(0, np.int64), np.empty(0))
        keys, places = np.empty(count, np.int64), np.empty(count)
        _met(rolled, *lines, keys, places)
        by_edge = np.lexsort((places, keys))
        keys, places = keys[by_edge], places[by_edge]
        edges, first, times = np.unique(keys, return_index=True, return_counts=True)
        mine = np.flatnonzero(surface.edges[:, 3] == axis)
        at = surface.edges[mine][:, order].astype(np.int64) + 1
        wanted = (at[:, 0] * len(lines[1]) + at[:, 1]) * len(lines[2]) + at[:, 2]
        where = np.minimum(np.searchsorted(edges, wanted), max(len(edges) - 1, 0))
        hit = edges[where] == wanted if len(edges) else np.zeros(len(mine), np.bool_)
        middle = places[first[where[hit]] + times[where[hit]] // 2]
        low, high = lines[0][at[hit, 0]], lines[0][at[hit, 0] + 1]
        shares[mine[hit]] = np.clip((middle - low) / (high - low), CLOSEST, 1 - CLOSEST)
        on_mesh[mine[hit]] = True
    return replace(surface, shares=shares), on_mesh
