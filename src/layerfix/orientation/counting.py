"""What correction changes, counted: layers of a cut mesh are filled, corrected and compared, and nothing is kept.

One kernel goes through the layers, without the interpreter's lock: threads take directions, not layers. It does what
`layerfix.layers.correction` does with the same kernels, bit for bit, but for what only a report needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import types

from layerfix.bits import U0, WORK, popcount
from layerfix.kernels import njit
from layerfix.layers.columns import fill_columns
from layerfix.layers.drawing import (
    anchor_columns,
    box_with_reach,
    draw_paths,
    find_paths,
    missing_places,
    open_columns,
)
from layerfix.layers.metric.cones import disc_erosions, erosions, significant, tips
from layerfix.layers.metric.levels import plan_for
from layerfix.layers.metric.retreat import LENGTHS, retreat
from layerfix.layers.metric.rule import thin_protected
from layerfix.layers.metric.tiles import TILE, clear_live
from layerfix.layers.morphology import HALF_WIDTHS
from layerfix.layers.skeleton import thin_anchored
from layerfix.mesh.fill import fill
from layerfix.mesh.pieces import small_pieces
from layerfix.mesh.slicing import HEIGHTS, POINTS, SNAP_PER_PX, TRIANGLES, bucket, cut

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.feature import Feature
    from layerfix.layers.skeleton import Spurs

IMAGES = types.Array(types.uint64, 3, "C")
TABLE = types.Array(types.int64, 2, "C", readonly=True)
NUMBERS = types.Array(types.int64, 1, "C", readonly=True)
MATRIX = types.Array(types.float64, 2, "C")
VECTOR = types.Array(types.float64, 1, "C", readonly=True)
COUNTS = types.Array(types.int64, 2, "C")
PLAN = types.Tuple((
    TABLE, NUMBERS, NUMBERS, TABLE, NUMBERS, TABLE, LENGTHS, NUMBERS,
    types.UniTuple(types.float64, 2), types.float64, types.float64,
))  # fmt: skip
TOOL = types.Tuple((
    HALF_WIDTHS, types.int64, types.int64, types.int64, types.int64, types.float64, types.boolean, types.boolean,
    types.boolean, types.boolean,
))  # fmt: skip
IMAGES_OF_COLUMNS = 9  # solid, anchor, skeleton, printed, paths, and four to work in


@njit(types.void(WORK, WORK, WORK, IMAGES, PLAN, types.boolean, IMAGES, types.Array(types.uint8, 3, "C")),
      cache=True, nogil=True)  # fmt: skip
def _thin_by_measure(columns, solid, anchor, scratch, plan, round_pixels, images, live):  # type: ignore[no-untyped-def]
    """`layerfix.layers.metric.rule.thin_metric` on arrays that are there; images: 0, and 0 again at the end."""
    levels, half_widths, starts, schedule, elements, offsets, lengths, outside, scale, pixel, radius = plan
    count = levels.shape[0]
    depths, depths_live = images[:count], live[:count]
    marked, kept, fixed, spare = scratch[0], scratch[1], scratch[2], scratch[3]
    if round_pixels:
        top = erosions(solid, levels, depths, depths_live)
    else:
        top = disc_erosions(solid, half_widths, starts, depths, depths_live)
    significant(solid, anchor, schedule, elements, depths, depths_live, top, images[count:], live[count:], marked)
    for w in range(kept.shape[0]):
        for y in range(kept.shape[1]):
            kept[w, y] = anchor[w, y] | marked[w, y]
    thin_protected(columns, kept, kept, True, spare)
    tips(columns, marked, anchor, fixed)
    thin_protected(columns, fixed, kept, False, spare)
    retreat(columns, anchor, marked, depths, top, offsets, lengths, outside, radius, scale, pixel)
    clear_live(images, live)


@njit
def _any_lost(solid, printed, copy):  # type: ignore[no-untyped-def]
    """copy = solid; whether it has a pixel that is not in `printed`."""
    lost = U0
    for w in range(solid.shape[0]):
        here, there, line = solid[w], printed[w], copy[w]
        for y in range(here.shape[0]):
            line[y] = here[y]
            lost |= here[y] & ~there[y]
    return lost != U0


@njit
def _compare(before, after, add_only, count):  # type: ignore[no-untyped-def]
    """Add solid, added and removed pixels of a layer to `count`."""
    for w in range(before.shape[0]):
        for y in range(before.shape[1]):
            a, b = before[w, y], after[w, y]
            if add_only:
                b |= a
            if a != U0:
                count[0] += popcount(a)
            if a != b:
                count[1] += popcount(b & ~a)
                count[2] += popcount(a & ~b)


@njit(types.void(POINTS, POINTS, VECTOR, MATRIX, MATRIX), cache=True, nogil=True)
def stand(vertices, matrix, shift, out, bounds):  # type: ignore[no-untyped-def]
    """out = vertices turned by a (3, 3) matrix and moved; bounds (2, 3): their lowest and highest corner."""
    for k in range(3):
        bounds[0, k], bounds[1, k] = np.inf, -np.inf
    for v in range(vertices.shape[0]):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        for k in range(3):
            value = x * matrix[k, 0] + y * matrix[k, 1] + z * matrix[k, 2] + shift[k]
            out[v, k] = value
            bounds[0, k] = min(bounds[0, k], value)
            bounds[1, k] = max(bounds[1, k], value)


@njit(types.void(MATRIX, VECTOR, types.float64, types.float64, types.float64, types.float64), cache=True, nogil=True)
def snap(points, origin, pitch_x, pitch_y, lowest, quantum):  # type: ignore[no-untyped-def]
    """Vertices in mm → columns and rows in steps of 1/1024 px, z in quanta, in place: as `layerfix.mesh.slicing`."""
    for v in range(points.shape[0]):
        points[v, 0] = np.rint(((points[v, 0] - origin[0]) / pitch_x - 0.5) * SNAP_PER_PX) / SNAP_PER_PX
        points[v, 1] = np.rint(((origin[1] - points[v, 1]) / pitch_y - 0.5) * SNAP_PER_PX) / SNAP_PER_PX
        points[v, 2] = np.rint((points[v, 2] - lowest) / quantum)


@njit(COUNTS(POINTS, TRIANGLES, HEIGHTS, types.int64, types.int64, types.int64, TOOL, PLAN), cache=True, nogil=True)
def _count_layers(points, faces, planes, width, height, rule, tool, plan):  # type: ignore[no-untyped-def]
    half_widths, bx, by, reach_x, reach_y, rounds, by_size, add_only, metric, round_pixels = tool
    counts = np.zeros((planes.shape[0], 3), np.int64)
    starts, crossed = bucket(points, faces, planes, 1)
    rows = np.empty((height, (width + 63) // 64), np.uint64)
    more = plan[0].shape[0] + 3 if metric else 0
    room, zeros = np.empty(0, np.uint64), np.empty(0, np.uint64)
    for k in range(planes.shape[0]):
        segments = cut(points, faces, crossed[starts[k] : starts[k + 1]], planes[k])
        if segments.shape[0] == 0:
            continue
        for y in range(rows.shape[0]):
            for w in range(rows.shape[1]):
                rows[y, w] = U0
        fill(segments, width, rule, True, rows)
        small = small_pieces(segments, rows)
        outer = box_with_reach(rows, reach_x, reach_y)
        if outer[1] == 0:
            continue
        words, tall = outer[3] - outer[2], outer[1] - outer[0]
        size = words * tall
        if room.shape[0] < IMAGES_OF_COLUMNS * size:
            room = np.empty(IMAGES_OF_COLUMNS * size * 5 // 4, np.uint64)
        images = room[: IMAGES_OF_COLUMNS * size].reshape(IMAGES_OF_COLUMNS, words, tall)
        solid, anchor, skeleton, printed, paths = images[0], images[1], images[2], images[3], images[4]
        scratch = images[5:]
        fill_columns(rows, outer, solid)
        anchor_columns(solid, half_widths, bx, by, anchor, scratch[0])
        open_columns(anchor, half_widths, printed, scratch[0])
        if _any_lost(solid, printed, skeleton) or not by_size:  # else no path is drawn, whatever the skeleton is
            if metric:
                if zeros.shape[0] < more * size:
                    zeros = np.zeros(more * size * 5 // 4, np.uint64)
                live = np.zeros((more, words, (tall - 2 + TILE - 1) // TILE), np.uint8)
                _thin_by_measure(skeleton, solid, anchor, scratch, plan, round_pixels,
                                 zeros[: more * size].reshape(more, words, tall), live)  # fmt: skip
            else:
                thin_anchored(skeleton, anchor, rounds, scratch[0])
            if find_paths(solid, skeleton, anchor, printed, half_widths, bx, by, by_size, paths):
                draw_paths(paths, printed, half_widths, bx, by, scratch[0])
        if small.shape[0] and missing_places(printed, small, outer[0], 64 * outer[2], scratch[1]):
            draw_paths(scratch[1], printed, half_widths, bx, by, scratch[0])
        _compare(solid, printed, add_only, counts[k])
    return counts


class Tool(NamedTuple):
    """F and the rules of correction, as the kernel takes them."""

    values: tuple[object, ...]
    plan: tuple[object, ...]


def tool_of(feature: Feature, spurs: Spurs, add_only: bool) -> Tool:
    """What `count_layers` corrects with."""
    plan = plan_for(*feature.radius_px)
    reach_x, reach_y = feature.reach_px
    values = (
        feature.half_widths, *feature.block, reach_x, reach_y, float(max(feature.radius_px)), feature.by_size,
        add_only, spurs == "metric", plan.round,
    )  # fmt: skip
    return Tool(
        values,
        (plan.levels, plan.half_widths, plan.starts, plan.schedule, plan.elements, plan.offsets, plan.lengths,
         plan.outside, plan.scale, plan.pixel, plan.radius),
    )  # fmt: skip


def count_layers(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    planes: NDArray[np.float64],
    size_px: tuple[int, int],
    rule: int,
    tool: Tool,
) -> NDArray[np.int64]:
    """(n, 3): pixels that are solid, added and removed in the layers of a closed mesh whose mid-planes these are.

    points   (v, 3) on the grid, as `snap` leaves them
    planes   (n,) rising, in z quanta
    size_px  (width, height) of the frame, which has room for F round the part
    rule     the winding rule of `layerfix.mesh.fill`
    """
    counts: NDArray[np.int64] = _count_layers(points, faces, planes, *size_px, rule, tool.values, tool.plan)
    return counts
