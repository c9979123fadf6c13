"""What correction changes, counted: layers of a cut mesh are filled, corrected and compared, and nothing is kept.

One kernel goes through the layers, without the interpreter's lock: threads take directions, not layers. It does what
`layerfix.layers.correction` does with the same kernels, bit for bit, but for what only a report needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import U0, popcount
from layerfix.kernels import njit
from layerfix.layers.columns import fill_columns
from layerfix.layers.drawing import box_with_reach, draw_paths, missing_places
from layerfix.layers.metric.levels import PLAN
from layerfix.layers.metric.rule import zeros_needed
from layerfix.layers.print_paths import IMAGES_OF_LAYER, PATHS, PRINTED, SOLID, TOOL, find_printed
from layerfix.mesh.cutter import SNAP_PER_PX, bucket, cut
from layerfix.mesh.facet_runs import HEIGHTS, POINTS, TRIANGLES
from layerfix.mesh.fill import fill
from layerfix.mesh.pieces import small_pieces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.print_paths import Tool

MATRIX = types.Array(types.float64, 2, "C")
VECTOR = types.Array(types.float64, 1, "C", readonly=True)
COUNTS = types.Array(types.int64, 2, "C")


@njit
def _compare(before, after, add_only, count):  # type: ignore[no-untyped-def]  # numba types it
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
def stand(vertices, matrix, shift, out, bounds):  # type: ignore[no-untyped-def]  # numba types it
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
def snap(points, origin, pitch_x, pitch_y, lowest, quantum):  # type: ignore[no-untyped-def]  # numba types it
    """Vertices in mm → columns and rows in steps of 1/1024 px, z in quanta, in place: as `layerfix.mesh.slicing`."""
    for v in range(points.shape[0]):
        points[v, 0] = np.rint(((points[v, 0] - origin[0]) / pitch_x - 0.5) * SNAP_PER_PX) / SNAP_PER_PX
        points[v, 1] = np.rint(((origin[1] - points[v, 1]) / pitch_y - 0.5) * SNAP_PER_PX) / SNAP_PER_PX
        points[v, 2] = np.rint((points[v, 2] - lowest) / quantum)


@njit(COUNTS(POINTS, TRIANGLES, HEIGHTS, types.int64, types.int64, types.int64, TOOL, PLAN, types.boolean),
      cache=True, nogil=True)  # fmt: skip
def _count_layers(points, faces, planes, width, height, rule, tool, plan, add_only):  # type: ignore[no-untyped-def]  # numba types it
    half_widths, bx, by, _, _, _ = tool
    reach_x, reach_y = half_widths[0] + bx, half_widths.shape[0] - 1 + by
    counts = np.zeros((planes.shape[0], 3), np.int64)
    starts, crossed = bucket(points, faces, planes, 1)
    rows = np.empty((height, (width + 63) // 64), np.uint64)
    room, zeros = np.empty(0, np.uint64), np.empty(0, np.uint64)
    for k in range(planes.shape[0]):
        for y in range(rows.shape[0]):
            for w in range(rows.shape[1]):
                rows[y, w] = U0
        chosen = crossed[starts[k] : starts[k + 1]]
        segments = cut(points, faces, chosen, planes[k])
        fill(segments, width, rule, True, rows)
        small = small_pieces(segments, rows)
        outer = box_with_reach(rows, reach_x, reach_y)
        if outer[1] == 0:
            continue
        words, tall = outer[3] - outer[2], outer[1] - outer[0]
        size, more = IMAGES_OF_LAYER * words * tall, zeros_needed(plan, words, tall)
        if room.shape[0] < size:
            room = np.empty(size * 5 // 4, np.uint64)
        if zeros.shape[0] < more:
            zeros = np.zeros(more * 5 // 4, np.uint64)
        images = room[:size].reshape(IMAGES_OF_LAYER, words, tall)
        solid, printed, scratch = images[SOLID], images[PRINTED], images[PATHS + 1 :]
        fill_columns(rows, outer, solid)
        find_printed(images, tool, plan, zeros, False, True)
        if small.shape[0] and missing_places(printed, small, outer[0], 64 * outer[2], scratch[1]):
            draw_paths(scratch[1], printed, half_widths, bx, by, scratch[0])
        _compare(solid, printed, add_only, counts[k])
    return counts


def count_layers(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    planes: NDArray[np.float64],
    size_px: tuple[int, int],
    rule: int,
    tool: Tool,
    add_only: bool,
) -> NDArray[np.int64]:
    """(n, 3): pixels that are solid, added and removed in the layers of a closed mesh whose mid-planes these are.

    points   (v, 3) on the grid, as `snap` leaves them
    planes   (n,) rising, in z quanta
    size_px  (width, height) of the frame, which has room for F round the part
    rule     the winding rule of `layerfix.mesh.fill`
    """
    counts: NDArray[np.int64] = _count_layers(points, faces, planes, *size_px, rule, tool.values, tool.plan, add_only)
    return counts
