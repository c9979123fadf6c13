"""Layers → polygons in mm, on the edges of the pixels.

`cv2.findContours` walks along the centres of a layer's border pixels. Between the pixel it came from and the one
it goes to, counter-clockwise, all neighbours of a border pixel are void; those beside it (not diagonal) are the
pixel's edges on the outline, in the order in which the outline passes them. So a table of 8 × 8 turns gives the
outline itself, with the exact area of the pixels.

Then two steps, both optional. A stair of single pixels is replaced by the line through the middles of its steps,
which takes as much away as it adds, and is less than half a pixel from them. Douglas and Peucker's simplification
leaves out corners, and each ring is then moved sideways, by less than a corner was moved, until it has the area of
its pixels again. A layer whose simplified outlines would touch, cross or vanish keeps its exact ones.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

import numpy as np
from numba import types

from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from shapely import MultiPolygon

    from layerfix.stack import Layer, LayerStack

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

# Of the tolerance: what simplification may move a corner by; the rest is for giving a ring its area back.
CORNERS_SHARE = 0.6
# East, then counter-clockwise as seen: the steps (x, y) to the eight neighbours, y down.
STEPS = np.array([(1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1)])
# Where the outline starts along the east, north, west and south edge of pixel (0, 0).
EDGE_STARTS = np.array([(1, 1), (1, 0), (0, 0), (0, 1)])
ALONE = 8  # "direction" of a pixel that is its own predecessor


def _turns() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How many pixel edges lie between the way back and the way on, and which: (9, 9) and (9, 9, 4)."""
    counts, edges = np.zeros((9, 9), np.int64), np.zeros((9, 9, 4), np.int64)
    for back in range(9):
        for on in range(9):
            if (back == ALONE) != (on == ALONE):
                continue
            passed = range(8) if back == ALONE else range(back + 1, back + 1 + (on - back - 1) % 8)
            chosen = [k % 8 // 2 for k in passed if k % 2 == 0]
            counts[back, on] = len(chosen)
            edges[back, on, : len(chosen)] = chosen
    return counts, edges


TURN_COUNTS, TURN_EDGES = _turns()
DIRECTION = np.full((3, 3), ALONE)
for _k, (_dx, _dy) in enumerate(STEPS):
    DIRECTION[_dy + 1, _dx + 1] = _k


@dataclass(frozen=True, eq=False)
class Rings:
    """Closed rings of a layer, all in one array; `starts[k]` to `starts[k + 1]` is ring k, outer ones
    counter-clockwise as seen, holes clockwise. `first_rings` are the outer ones; their holes follow them."""

    points: Floats  # (n, 2) x, y
    starts: Indices
    first_rings: Indices

    def previous(self) -> Indices:
        """For each point, the one before it in its ring."""
        before = np.arange(len(self.points)) - 1
        before[self.starts[:-1]] = self.starts[1:] - 1
        return before

    def following(self) -> Indices:
        """For each point, the one after it in its ring."""
        after = np.arange(len(self.points)) + 1
        after[self.starts[1:] - 1] = self.starts[:-1]
        return after

    def areas(self) -> Floats:
        """Signed area of each ring: holes are negative where y points up."""
        x, y = self.points.T
        after = self.following()
        return np.add.reduceat(x * y[after] - x[after] * y, self.starts[:-1]) / 2 if len(x) else np.empty(0)

    def chosen(self, keep: NDArray[np.bool_]) -> Rings:
        """Only these points; every ring must keep one."""
        starts = np.concatenate([[0], np.cumsum(np.add.reduceat(keep.astype(np.int64), self.starts[:-1]))])
        return Rings(self.points[keep], starts, self.first_rings)

    def polygons(self) -> NDArray[np.object_]:
        """One shapely Polygon for each outer ring."""
        import shapely

        closed = np.insert(self.points, self.starts[1:], self.points[self.starts[:-1]], axis=0)
        offsets = self.starts + np.arange(len(self.starts))
        ends = np.append(self.first_rings, len(self.starts) - 1)
        made: NDArray[np.object_] = shapely.from_ragged_array(shapely.GeometryType.POLYGON, closed, (offsets, ends))
        return made


@dataclass(frozen=True, eq=False)
class Contours(Sequence["MultiPolygon"]):
    """The outlines of a stack's layers: item k is the shapely MultiPolygon (mm) of layer k, made when asked for.

    Iterating makes them in the stack's threads; `each` gives the layers along with them.
    """

    stack: LayerStack
    tolerance_mm: float

    def __len__(self) -> int:
        return len(self.stack)

    @overload
    def __getitem__(self, index: int) -> MultiPolygon: ...
    @overload
    def __getitem__(self, index: slice) -> Contours: ...
    def __getitem__(self, index: int | slice) -> MultiPolygon | Contours:
        if isinstance(index, slice):
            return Contours(self.stack[index], self.tolerance_mm)
        return self.of(self.stack[index])

    def __iter__(self) -> Iterator[MultiPolygon]:
        return self.stack.each(self.of, once=True)

    @property
    def z_mm(self) -> Floats:
        """(layers, 2): bottom and top of each layer."""
        return self.stack.z_mm

    def each(self) -> Generator[tuple[Layer, MultiPolygon]]:
        """(layer, its outlines) in order, made in the stack's threads."""
        return self.stack.each(lambda layer: (layer, self.of(layer)))

    def of(self, layer: Layer) -> MultiPolygon:
        """The outlines of one layer on the stack's frame."""
        if layer.change is not None:
            feature_mm = 2 * min(r * p for r, p in zip(layer.change.radius_px, self.stack.pixel_mm, strict=True))
            if self.tolerance_mm > feature_mm:
                raise InputError(
                    f"tolerance {format_mm(self.tolerance_mm)} is larger than the minimum feature of"
                    f" {format_mm(feature_mm)}: it would take away what was corrected"
                )
        return outline(layer, self.stack.pixel_mm, self.stack.origin_mm, self.tolerance_mm)


def trace_contours(stack: LayerStack, *, tolerance_mm: float | None = None) -> Contours:
    """The layers as polygons with holes, in mm, x to the right and y to the back.

    tolerance_mm  how far simplification may move the outline (default: half a pixel); 0 gives the pixels' edges
                  themselves. From half a pixel on, stairs of single pixels are straightened first, which moves the
                  outline by less than half a pixel more
    returns       a sequence of one shapely MultiPolygon per layer, valid, outer rings counter-clockwise, with the
                  area of the layer's pixels (within 0.1 % at tolerances up to a pixel). Solids that touch at a
                  corner are polygons that touch there; the number of polygons and holes does not depend on the
                  tolerance
    raises        InputError for a tolerance below 0, or (when the outlines are made) above the minimum feature
    """
    tolerance = min(stack.pixel_mm) / 2 if tolerance_mm is None else tolerance_mm
    if not 0 <= tolerance < math.inf:
        raise InputError(f"tolerance {tolerance} mm: it must be 0 or more")
    return Contours(stack, tolerance)


def outline(
    layer: Layer, pixel_mm: tuple[float, float], origin_mm: tuple[float, float], tolerance_mm: float
) -> MultiPolygon:
    """One layer as a MultiPolygon in mm; arguments as in `trace_contours` and `LayerStack`."""
    import shapely

    def in_mm(rings: Rings) -> Rings:
        scale = np.array([pixel_mm[0], -pixel_mm[1]])
        return Rings(rings.points * scale + np.array(origin_mm), rings.starts, rings.first_rings)

    edges, touching = _without_pinches(pixel_edges(layer))
    if not len(edges.points):
        return shapely.MultiPolygon()
    exact = in_mm(edges).polygons()
    if tolerance_mm == 0:
        return shapely.multipolygons(exact)
    straight = _without_stairs(edges) if tolerance_mm >= min(pixel_mm) / 2 * (1 - 1e-9) else edges
    polygons = _simplified(in_mm(straight), in_mm(edges).areas(), CORNERS_SHARE * tolerance_mm)
    if not _same_topology(polygons, exact):
        return shapely.multipolygons(exact)
    for chosen in (polygons, np.where(touching, exact, polygons)):
        found = shapely.multipolygons(chosen)
        if shapely.is_valid(found):
            return found
    return shapely.multipolygons(exact)


def pixel_edges(layer: Layer) -> Rings:
    """The outline of a layer along the edges of its pixels, in px from the frame's upper left corner, y down."""
    import cv2

    image, left, top = solid_part(layer)
    contours, hierarchy = cv2.findContours(image, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE, offset=(left, top))
    if not contours:
        return Rings(np.empty((0, 2)), np.zeros(1, np.int64), np.empty(0, np.int64))
    parents = hierarchy[0, :, 3]
    order = np.lexsort((parents >= 0, np.where(parents >= 0, parents, np.arange(len(parents)))))
    pixels = np.concatenate([contours[k] for k in order]).reshape(-1, 2).astype(np.int64)
    starts = np.concatenate([[0], np.cumsum([len(contours[k]) for k in order])])
    walk = Rings(pixels.astype(np.float64), starts, np.flatnonzero(parents[order] < 0))
    back = pixels[walk.previous()] - pixels
    on = pixels[walk.following()] - pixels
    turn = DIRECTION[back[:, 1] + 1, back[:, 0] + 1], DIRECTION[on[:, 1] + 1, on[:, 0] + 1]
    passed = TURN_COUNTS[turn]
    which = TURN_EDGES[turn][np.arange(4) < passed[:, None]]
    points = np.repeat(pixels, passed, axis=0) + EDGE_STARTS[which]
    starts = np.concatenate([[0], np.cumsum(passed)])[starts]
    rings = Rings(points.astype(np.float64), starts, walk.first_rings)
    ahead, behind = points[rings.following()] - points, points - points[rings.previous()]
    return rings.chosen((ahead != behind).any(axis=1))


def solid_part(layer: Layer) -> tuple[NDArray[np.uint8], int, int]:
    """(the box around the solid as (h, w) uint8, its left column, its top row); (0, 0) if it is empty."""
    from layerfix.bits import unpack
    from layerfix.layers.columns import bounding_box

    top, bottom, first, last = bounding_box(layer.rows)
    width = min(last * 64, layer.width) - first * 64
    rows = np.ascontiguousarray(layer.rows[top:bottom, first:last])
    return unpack(rows, max(width, 0)).view(np.uint8), first * 64, top


def _without_pinches(rings: Rings) -> tuple[Rings, NDArray[np.bool_]]:
    """The same outline in rings that pass no point twice, and of each polygon, whether it meets itself or another
    at a corner.

    Where two solid pixels meet at a corner only, `cv2.findContours` walks across. Turning there instead makes the
    solids separate; a ring that still meets itself is one that closes round a void, and is parted into an outer
    ring and a hole.
    """
    keys = rings.points[:, 0] * 2.0**24 + rings.points[:, 1]
    order = np.argsort(keys, kind="stable")
    again = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    if not len(again):
        return rings, np.zeros(len(rings.first_rings), np.bool_)
    pinched = np.zeros(len(keys), np.bool_)
    pinched[order[again]] = pinched[order[again + 1]] = True
    chain, starts = relink(rings.following(), order[again], order[again + 1])
    apart = Rings(rings.points[chain], starts, np.arange(len(starts) - 1))
    outer = apart.areas() < 0  # y points down here
    holder = np.arange(len(outer))
    holder[~outer] = np.flatnonzero(outer)[_holders(apart, outer)]
    by_polygon = np.lexsort((~outer, holder))
    where = np.concatenate([np.arange(starts[k], starts[k + 1]) for k in by_polygon])
    starts = np.concatenate([[0], np.cumsum(np.diff(starts)[by_polygon])])
    sorted_rings = Rings(apart.points[where], starts, np.flatnonzero(outer[by_polygon]))
    touching = np.logical_or.reduceat(pinched[chain][where], starts[sorted_rings.first_rings])
    return sorted_rings, touching


@njit(
    types.UniTuple(types.int64[::1], 2)(types.int64[::1], types.int64[::1], types.int64[::1]), cache=True, nogil=True
)
def relink(following, first, second):  # type: ignore[no-untyped-def]  # numba types it
    """Exchange what follows `first[k]` and `second[k]`, two visits to one point, unless that leaves both in one
    ring. Returns all points ring by ring, and where each ring starts."""
    after = following.copy()
    for k in range(first.shape[0]):
        after[first[k]], after[second[k]] = after[second[k]], after[first[k]]
    ring = np.full(after.shape[0], -1)
    rings = 0
    for start in range(after.shape[0]):
        if ring[start] < 0:
            i = start
            while ring[i] < 0:
                ring[i] = rings
                i = after[i]
            rings += 1
    for k in range(first.shape[0]):
        if ring[first[k]] == ring[second[k]]:
            after[first[k]], after[second[k]] = after[second[k]], after[first[k]]
            i = first[k]
            while ring[i] != rings:
                ring[i] = rings
                i = after[i]
            rings += 1
    chain, starts = np.empty_like(after), np.zeros(rings + 1, np.int64)
    n, rings = 0, 0
    for start in range(after.shape[0]):
        if ring[start] >= 0:
            i = start
            while ring[i] >= 0:
                ring[i] = -1
                chain[n] = i
                n += 1
                i = after[i]
            rings += 1
            starts[rings] = n
    return chain, starts[: rings + 1].copy()


def _holders(rings: Rings, outer: NDArray[np.bool_]) -> Indices:
    """For each hole the number of the outer ring that it is cut from: the smallest round the solid beside it."""
    import shapely

    first = rings.starts[:-1][~outer]
    a, b = rings.points[first], rings.points[rings.following()[first]]
    along = np.sign(b - a)
    beside = shapely.points((a + b) / 2 + 0.25 * np.stack([along[:, 1], -along[:, 0]], axis=1))  # to its left
    shells = Rings(rings.points, rings.starts, np.arange(len(outer))).polygons()[outer]
    hole, shell = shapely.STRtree(shells).query(beside, predicate="within")
    found = np.zeros(len(first), np.int64)
    order = np.argsort(-shapely.area(shells[shell]), kind="stable")  # the smallest is written last
    found[hole[order]] = shell[order]
    return found


def _without_stairs(rings: Rings) -> Rings:
    """The outline with stairs of single pixels straightened.

    A step is a run of one pixel between a turn to one side and a turn to the other. The points half the shorter
    neighbouring run before and after it replace its two corners: the triangles cut off on both sides are alike.
    """
    points, after, before = rings.points, rings.following(), rings.previous()
    run = points[after] - points
    length = np.abs(run).sum(axis=1)
    unit = run / length[:, None]
    left = unit[before, 0] * unit[:, 1] - unit[before, 1] * unit[:, 0] > 0
    step = (length == 1) & (left != left[after])
    reach = np.where(step, np.minimum(length[before], length[after]) / 2, 0.0)
    # How far each corner is cut back along the run before it, and along its own.
    back = np.maximum(np.where(step, reach, 0.0), np.where(step[before], 0.5, 0.0))
    ahead = np.maximum(np.where(step, 0.5, 0.0), np.where(step[before], reach[before], 0.0))
    pairs = np.stack([points - unit[before] * back[:, None], points + unit * ahead[:, None]], axis=1)
    cut = Rings(pairs.reshape(-1, 2), 2 * rings.starts, rings.first_rings)
    return cut.chosen((cut.points != cut.points[cut.previous()]).any(axis=1))


def _simplified(rings: Rings, areas_mm2: Floats, tolerance_mm: float) -> NDArray[np.object_]:
    """Polygons with fewer corners, every ring of the area it had as pixels."""
    import shapely

    polygons = shapely.simplify(rings.polygons(), tolerance_mm, preserve_topology=False)
    if (shapely.get_type_id(polygons) != shapely.GeometryType.POLYGON).any() or shapely.is_empty(polygons).any():
        return np.empty(0, np.object_)
    _, points, (starts, ends) = shapely.to_ragged_array(polygons)
    if len(starts) != len(rings.starts):
        return np.empty(0, np.object_)  # a hole vanished
    open_points = np.delete(points, starts[1:] - 1, axis=0)
    simple = Rings(open_points, starts - np.arange(len(starts)), ends[:-1])
    for _ in range(2):
        simple = _grown(simple, areas_mm2)
    return simple.polygons()


def _grown(rings: Rings, areas_mm2: Floats) -> Rings:
    """Each ring moved sideways so far that it gets the given area (but for what its corners make of it)."""
    along = rings.points[rings.following()] - rings.points
    lengths = np.hypot(along[:, 0], along[:, 1])
    outwards = np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths[:, None]
    beside = outwards[rings.previous()]
    missing = (areas_mm2 - rings.areas()) / np.add.reduceat(lengths, rings.starts[:-1])
    missing[np.abs(missing) < 1e-9] = 0.0
    by = np.repeat(missing, np.diff(rings.starts))
    spread = np.maximum(1 + (outwards * beside).sum(axis=1), 0.5)
    return Rings(rings.points + (outwards + beside) * (by / spread)[:, None], rings.starts, rings.first_rings)


def _same_topology(polygons: NDArray[np.object_], exact: NDArray[np.object_]) -> bool:
    """Whether both have as many polygons, each with as many holes."""
    import shapely

    if len(polygons) != len(exact):
        return False
    return bool((shapely.get_num_interior_rings(polygons) == shapely.get_num_interior_rings(exact)).all())
