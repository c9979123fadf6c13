"""Which thin places of fine layers the printer's layers ask for.

Fine layers are made to shape bodies smoothly. Where they cut the part between the printer's planes, or see a thin
place that is none on the printer's pixels, they find places that its corrected layers have not; and now and then one
is missing. The bodies are to give the printer's layers again, so both are set right before bodies are made.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from layerfix.bits import unpack
from layerfix.layers.correction import before, telling_paths
from layerfix.surface.bodies import places_in

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.stack import Layer, LayerStack

    Places = NDArray[np.int64]  # (n, 2) row and column
    Field = NDArray[np.float32]

CELL_ROW = 1 << 20  # cells of one row: more than any plate has
# Of the fine pixels: what smoothing may make of F around a place, which must have room in what its layer has and a
# pixel of the printer's around that; and by how much less F covers what is not missing.
ROOM_PX = COVERED_PX = 0.5
NEAR_PX = 1.5  # of the fine ones: places in neighbouring fine layers that are one
AROUND = np.ones((3, 3), np.uint8)


def asked_for(places: list[Places], fine: LayerStack, fixed: LayerStack, feature_mm: float) -> list[Places]:
    """Places of the fine layers, so that F around them is within a pixel of what `fixed` has.

    Out are those that have no place of their layer of `fixed` within about F (roofs of what is thick that are grazed,
    ends of walls within a layer), and where F would reach further than a pixel beyond that layer; in are places of
    `fixed` that no fine layer has. The latter two only where the printer's pixels are square.
    """
    layer_of = np.searchsorted(fixed.z_mm[:, 0], fine.z_mm.mean(axis=1), side="right") - 1
    layer_of = layer_of.clip(0, len(fixed) - 1)
    bottoms = np.searchsorted(layer_of, np.arange(len(fixed) + 1))
    square = abs(fixed.pixel_mm[0] - fixed.pixel_mm[1]) < 1e-9 * fixed.pixel_mm[0]
    solid = before(fixed)

    def matched(layer: Layer) -> list[Places]:
        k = int(np.abs(fixed.z_mm[:, 0] - layer.z_mm[0]).argmin())
        own = places[bottoms[k] : bottoms[k + 1]]
        drawn = places_in(layer)
        near = _with_neighbours(_cells(drawn, fixed, feature_mm))
        own = [points[np.isin(_cells(points, fine, feature_mm), near)] for points in own]
        if not square or layer.change is None or not any(map(len, [*own, drawn])):
            return own
        return _within_a_pixel(own, drawn, layer, solid[k], fine, fixed)

    kept = list(telling_paths(fixed).each(matched))
    return [points for own in kept for points in own]


def _within_a_pixel(
    own: list[Places], drawn: Places, layer: Layer, solid: Layer, fine: LayerStack, fixed: LayerStack
) -> list[Places]:
    """Places of the fine layers of one layer, without those where F reaches too far, and with what is missing."""
    assert layer.change is not None
    radius_px, fine_px = layer.change.radius_px[0], fine.pixel_mm[0] / fixed.pixel_mm[0]
    both = [_moved(points, fine, fixed) for points in own]
    ends = np.concatenate([*both, drawn.astype(np.float64)])
    reach = int(radius_px) + 4
    top, left = np.maximum(np.floor(ends.min(axis=0)).astype(int) - reach, 0).tolist()
    bottom, right = (np.ceil(ends.max(axis=0)).astype(int) + reach + 1).tolist()
    box = np.s_[top:bottom, left:right]
    has = np.pad(unpack(layer.rows, layer.width)[box].astype(np.uint8), 1)
    was = np.pad(unpack(solid.rows, solid.width)[box].astype(np.uint8), 1)
    corner = np.array([top - 1, left - 1])
    middle = len(own) // 2
    wide = cv2.dilate(has, AROUND)
    room: Field = np.asarray(cv2.distanceTransform(wide, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)
    fits = _sampled(room, both[middle] - corner) >= radius_px + ROOM_PX * fine_px
    if not fits.all():
        gone, stay = own[middle][~fits], own[middle][fits]
        own = [stay if points is own[middle] else _without(points, gone, stay) for points in own]
    kept = _moved(own[middle], fine, fixed) - corner
    free = np.ones(has.shape, np.uint8)
    at = np.rint(kept).astype(int).clip(0, np.array(has.shape) - 1)
    free[at[:, 0], at[:, 1]] = 0
    far = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) if len(at) else np.full(has.shape, np.inf)
    covered = (was != 0) | (far <= radius_px - COVERED_PX * fine_px)
    missing = (has != 0) & (cv2.dilate(covered.astype(np.uint8), AROUND) == 0)
    if not missing.any():
        return own
    lacking = cv2.distanceTransform((~missing).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    y, x = (drawn - corner).T
    middles = drawn + [0.0 if round(2 * r) % 2 else 0.5 for r in layer.change.radius_px[::-1]]  # of F, if it is even
    added = np.rint(_moved(middles[lacking[y, x] <= radius_px + 1], fixed, fine)).astype(np.int64)
    return [np.unique(np.concatenate([points, added]), axis=0) for points in own]


def _without(points: Places, gone: Places, stay: Places) -> Places:
    """Points but for those beside one that is gone, and further from all that stay."""
    off = np.array([np.hypot(*(gone - p).T).min() for p in points])
    beside = np.flatnonzero(off <= NEAR_PX).tolist()
    nearer = [k for k in beside if off[k] < np.hypot(*(stay - points[k]).T).min(initial=np.inf)]
    return np.delete(points, nearer, axis=0)


def _on_plate_mm(
    points: Places | NDArray[np.float64], stack: LayerStack
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(x, y) of the middles of (row, column) pixels."""
    row, column = np.asarray(points, np.float64).T
    return stack.origin_mm[0] + (column + 0.5) * stack.pixel_mm[0], stack.origin_mm[1] - (row + 0.5) * stack.pixel_mm[
        1
    ]


def _moved(points: Places | NDArray[np.float64], source: LayerStack, target: LayerStack) -> NDArray[np.float64]:
    """(n, 2) row and column in one frame → in another."""
    x_mm, y_mm = _on_plate_mm(points, source)
    row = (target.origin_mm[1] - y_mm) / target.pixel_mm[1] - 0.5
    column = (x_mm - target.origin_mm[0]) / target.pixel_mm[0] - 0.5
    return np.column_stack([row, column])


def _sampled(field: Field, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) the field between its pixels, bilinear."""
    last = np.array(field.shape) - 2
    low = np.clip(np.floor(points).astype(int), 0, last)
    (v, u), (y, x) = (points - low).T, low.T
    below = field[y, x] * (1 - u) + field[y, x + 1] * u
    return np.asarray(below * (1 - v) + (field[y + 1, x] * (1 - u) + field[y + 1, x + 1] * u) * v)


def _cells(points: Places, stack: LayerStack, cell_mm: float) -> NDArray[np.int64]:
    """(n,) which square cell of the plate each (row, column) pixel of a stack is in, as one number."""
    x_mm, y_mm = _on_plate_mm(points, stack)
    row, column = np.floor(y_mm / cell_mm).astype(np.int64), np.floor(x_mm / cell_mm).astype(np.int64)
    cells: NDArray[np.int64] = row * CELL_ROW + column
    return cells


def _with_neighbours(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells and the eight around each."""
    steps = np.array([dy * CELL_ROW + dx for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    around: NDArray[np.int64] = np.unique((np.unique(cells)[:, None] + steps).reshape(-1))
    return around
