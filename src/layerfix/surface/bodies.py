"""Bodies of what is too thin: smooth closed surfaces round the paths along which F was drawn.

A body is { φ > 0 }, φ = r − the distance to the nearest place of F's middle in the same layer: the sweep of F,
exactly, at a pitch fine enough to be smooth. Within a layer a Gaussian straightens the path's stairs, across layers
another those of slopes; together they move the exact sweep by MOST_PX at most. Vertices are put where φ is 0 on the
edges of the grid.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from numba import types

from layerfix.bits import pack
from layerfix.kernels import njit
from layerfix.surface.cubes import march
from layerfix.surface.voxels import CLOSEST, VoxelSurface, grid_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from layerfix.stack import Layer, LayerStack

    Floats = NDArray[np.float64]
    Field = NDArray[np.float32]

SIGMA_PX = 1.0  # of the Gaussian within a layer: straightens the stairs of paths
SIGMA_LAYERS = 3.0  # across layers, at most a third of F's radius
MOST_PX = 0.8  # that both may move the exact sweep; without a limit, 8 px were missed on a dragon
STEEPEST_PX = 1.0  # that φ falls from layer to layer, in a layer as high as a pixel, if it is still a slope
LEVEL_PX = 2.0  # that it falls where the body ends level
LIFT_PX = 0.25  # outwards: what smoothing and simplification take
FAR_PX = 60.0  # where no path is near
ALIKE_PX = 1e-3  # between layers that are the same but for rounding
NEAR_PX = 4.0  # from the surface: further away, nothing can change sides

FIELDS = types.Array(types.float32, 3, "C")
FIELD = types.Array(types.float32, 2, "C")
SLOTS = types.Array(types.int64, 1, "C", readonly=True)
WEIGHTS = types.Array(types.float64, 1, "C", readonly=True)


class Tile(NamedTuple):
    """A part of the plate on which bodies do not meet those of others: its frame, and its points in each layer.

    box     (x, y, width, height) in pixels
    first   layer of `points[0]`
    points  (n, 2) row and column of F's pixel, within the box
    """

    box: tuple[int, int, int, int]
    first: int
    points: list[NDArray[np.int64]]


def drawn_places(stack: LayerStack, watch: Callable[[int, Layer], None]) -> list[NDArray[np.int64]]:
    """(n, 2) row and column of the pixels that F was drawn at, in each layer of a `corrected_like` stack."""
    found = []
    for index, (places, bare) in enumerate(stack.each(lambda layer: (places_in(layer), layer.without_pixels()))):
        watch(index, bare)
        found.append(places)
    return found


def places_in(layer: Layer) -> NDArray[np.int64]:
    """(n, 2) row and column of the pixels that F was drawn at in a layer whose change tells."""
    paths = layer.change.paths if layer.change is not None else None
    if paths is None:
        return np.empty((0, 2), np.int64)
    y, word = np.nonzero(paths)
    bits = np.unpackbits(paths[y, word].astype("<u8").view(np.uint8).reshape(-1, 8), axis=1, bitorder="little")
    which, bit = np.nonzero(bits)
    return np.column_stack([y[which], 64 * word[which] + bit])


def tiles(places: list[NDArray[np.int64]], shape: tuple[int, int], reach_px: int) -> Iterator[Tile]:
    """Places sorted by the part of the plate that they are on; parts are further apart than twice `reach_px`."""
    height, width = shape
    seen = np.zeros((height, width), np.uint8)
    for points in places:
        seen[points[:, 0], points[:, 1]] = 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach_px + 1, 2 * reach_px + 1))
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(cv2.dilate(seen, disc), connectivity=8)
    numbers = [labels[points[:, 0], points[:, 1]] for points in places]
    layers: list[list[int]] = [[] for _ in range(count)]
    for k, of_points in enumerate(numbers):
        for label in np.unique(of_points).tolist():
            layers[label].append(k)
    for label in range(1, count):
        x, y, w, h = (int(v) for v in boxes[label, :4])
        first, last = layers[label][0], layers[label][-1]
        own = [places[k][numbers[k] == label] - (y, x) for k in range(first, last + 1)]
        yield Tile((x, y, w, h), first, own)


@njit(types.void(FIELDS, FIELDS, SLOTS, WEIGHTS, types.float64, types.float64, FIELD), cache=True, nogil=True)
def _across(exact, blurred, slots, weights, steepest, lift, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = the middle slot's φ, smoothed across the layers in `slots` (−1: none), in pairs up and down.

    A pair counts where φ has not fallen by more than `steepest` a layer: there the body goes on.
    """
    reach = weights.shape[0] - 1
    here = slots[reach]
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            phi = exact[here, y, x]
            if abs(phi) > NEAR_PX:
                out[y, x] = phi
                continue
            total, weight = weights[0] * blurred[here, y, x], weights[0]
            for d in range(1, reach + 1):
                low, high = slots[reach - d], slots[reach + d]
                if low < 0 or high < 0:
                    continue
                a, b = blurred[low, y, x], blurred[high, y, x]
                if a > -steepest * d and b > -steepest * d:
                    total += weights[d] * (a + b)
                    weight += 2 * weights[d]
            smooth = total / weight + lift
            out[y, x] = min(max(smooth, phi - MOST_PX), phi + MOST_PX) + LIFT_PX


def body_of(tile: Tile, radius_px: Floats, stack: LayerStack) -> VoxelSurface | None:
    """The body of a tile; None if none of it is left.

    Layers that are alike are one, as high as all of them: upright walls have few triangles.

    radius_px  (layers,) of F, in pixels of the stack
    """
    x, y, w, h = tile.box
    count = len(tile.points)
    z_mm = stack.z_mm[tile.first : tile.first + count]
    steep = (z_mm[:, 1] - z_mm[:, 0]) / min(stack.pixel_mm)
    far = np.full((h, w), -FAR_PX, np.float32)
    recent = deque([far, far], maxlen=2)
    runs: list[tuple[int, int]] = []  # first and last of layers that are alike

    def layers() -> Iterator[NDArray[np.uint64]]:
        fields = _smooth_fields(tile, radius_px[tile.first : tile.first + count], steep)
        for first, last, field in _runs(fields):
            # Both ends stay single: towards a level end, the surface of voxels tapers over half of its layer.
            pieces = [(first, first), (first + 1, last - 1), (last, last)]
            for piece in dict.fromkeys(piece for piece in pieces if piece[0] <= piece[1]):
                runs.append(piece)
                recent.append(field)
                yield pack(field > 0)

    edges, faces, shares = [], [], []
    for n, patch in enumerate(march(layers(), (h, 0), w)):
        if n >= len(runs):
            recent.append(far)  # above the highest
        beside = runs[max(n - 1, 0) : n + 1]
        alone = all(first == last for first, last in beside)
        level_px = LEVEL_PX * float(steep[beside[-1][0]]) if alone and beside else 0.0
        edges.append(patch.edges)
        faces.append(patch.faces)
        shares.append(_at_zero(patch.edges, recent[0], recent[1], level_px))
    found, triangles, at = np.concatenate(edges), np.concatenate(faces), np.concatenate(shares)
    if not len(triangles):
        return None
    grid = grid_of(replace(stack, z_mm=np.array([(z_mm[first, 0], z_mm[last, 1]) for first, last in runs])))
    found += np.array([x, y, 0, 0], np.int32)
    return VoxelSurface(found, np.where(np.isnan(at), grid.middle_shares(found), at), triangles, grid.centres)


def _runs(fields: Iterator[Field]) -> Iterator[tuple[int, int, Field]]:
    """(first, last, φ) of layers that are alike, one after the other."""
    first, held = 0, next(fields)
    k = 0
    for k, field in enumerate(fields, 1):
        if not _alike(field, held):
            yield first, k - 1, held
            first, held = k, field
    yield first, k, held


def _alike(field: Field, other: Field) -> bool:
    """Whether two layers of φ have their zero at the same places."""
    near = np.abs(other) < NEAR_PX
    return (
        np.array_equal(near, np.abs(field) < NEAR_PX) and float(np.abs(field - other)[near].max(initial=0)) < ALIKE_PX
    )


def _at_zero(edges: NDArray[np.int32], below: Field, above: Field, level_px: float) -> Floats:
    """(n,) where φ is 0 on edges of one layer, and up to the next; NaN where the body ends level."""
    h, w = below.shape
    x, y, axis = edges[:, 0].clip(0, w - 1), edges[:, 1].clip(0, h - 1), edges[:, 3]
    here = below[y, x].astype(np.float64)
    there = np.where(
        axis == 2, above[y, x], below[(y + (axis == 1)).clip(0, h - 1), (x + (axis == 0)).clip(0, w - 1)]
    )
    share: Floats = (here / np.where(here == there, 1.0, here - there)).clip(CLOSEST, 1 - CLOSEST)
    share[(axis == 2) & (np.minimum(here, there) < -level_px)] = np.nan
    return share


def _smooth_fields(tile: Tile, radius_px: Floats, steep: Floats) -> Iterator[Field]:
    """φ of each layer of a tile. Memory: as many layers as the Gaussian reaches, twice."""
    sigma = min(SIGMA_LAYERS, float(radius_px.max()) / 3)
    reach = math.ceil(2.5 * sigma)
    weights = np.exp(-0.5 * (np.arange(reach + 1) / sigma) ** 2)
    _, _, w, h = tile.box
    count, slots = len(tile.points), 2 * reach + 1
    exact = np.full((slots, h, w), -FAR_PX, np.float32)
    blurred = np.full((slots, h, w), -FAR_PX, np.float32)
    loaded = 0
    for k in range(count):
        while loaded <= min(k + reach, count - 1):
            _load(tile.points[loaded], float(radius_px[loaded]), exact[loaded % slots], blurred[loaded % slots])
            loaded += 1
        if not len(tile.points[k]):
            yield exact[k % slots].copy()
            continue
        around = np.arange(k - reach, k + reach + 1)
        there = np.where((around >= 0) & (around < count), around % slots, -1)
        out = np.empty((h, w), np.float32)
        _across(exact, blurred, there, weights, STEEPEST_PX * float(steep[k]),
                SIGMA_PX**2 / (2 * float(radius_px[k])), out)  # fmt: skip
        yield out


def _load(points: NDArray[np.int64], radius_px: float, exact: Field, blurred: Field) -> None:
    """φ of one layer, and φ blurred within the layer."""
    exact[:] = -FAR_PX
    blurred[:] = -FAR_PX
    if not len(points):
        return
    pad = math.ceil(radius_px + 4 * SIGMA_PX) + 1
    (y0, x0), (y1, x1) = np.maximum(points.min(axis=0) - pad, 0), points.max(axis=0) + pad + 1
    room = exact[y0:y1, x0:x1]
    free = np.ones(room.shape, np.uint8)
    free[points[:, 0] - y0, points[:, 1] - x0] = 0
    phi = radius_px - cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    room[:] = np.maximum(phi, -FAR_PX)
    blurred[y0:y1, x0:x1] = cv2.GaussianBlur(
        np.maximum(phi, -3 * radius_px).astype(np.float32), (0, 0), SIGMA_PX, borderType=cv2.BORDER_REPLICATE
    )
