"""What a correction did to parts and holes: which grew together, which closed, where."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numba import types

from layerfix.bits import WORK, pack
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import bounding_box, to_columns, with_border
from layerfix.layers.components import has_bit, label_runs, root_of
from layerfix.stack import Layer, LayerStack

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows

    Box = tuple[int, int, int, int]

PARTS = types.Array(types.int64, 2, "C")
AREA, LEFT, TOP, RIGHT, BOTTOM, BECOMES = range(6)  # columns of the kernel's tables


@dataclass(frozen=True)
class TopologyChange:
    """Parts that became one, or a hole (a channel's cut) that is gone, in one layer.

    kind      "merged": `count` components (8-connected) are one now; "closed": a void part (4-connected) is solid
              now; "lost": a component has no pixel left
    box_mm    (left, bottom, right, top) of what merged or was closed, on the stack's frame
    area_mm2  of all merged components but the largest; of the hole; of what was lost
    """

    kind: Literal["merged", "closed", "lost"]
    count: int
    box_mm: tuple[float, float, float, float]
    area_mm2: float
    z_mm: tuple[float, float] = (0.0, 0.0)


@njit
def _measured(runs, parent, other, of_void):  # type: ignore[no-untyped-def]
    """(n, 6) of components given by runs: area, box (right and bottom past the last), 1 if `other` has part of it."""
    number = np.zeros(parent.shape[0], np.int64)
    count = 0
    for k in range(parent.shape[0]):
        if parent[k] == k:
            number[k] = count
            count += 1
    out = np.zeros((count, 6), np.int64)
    for k in range(parent.shape[0]):
        i = number[root_of(parent, k)]
        y, first, stop = runs[k]
        fresh = out[i, AREA] == 0
        out[i, LEFT] = first if fresh else min(out[i, LEFT], first)
        out[i, TOP] = y if fresh else min(out[i, TOP], y)
        out[i, RIGHT] = stop if fresh else max(out[i, RIGHT], stop)
        out[i, BOTTOM] = y + 1
        out[i, AREA] += stop - first
        if not out[i, BECOMES]:
            out[i, BECOMES] = np.int64(has_bit(other, of_void, y, first, stop))
    return out


@njit(types.UniTuple(PARTS, 2)(WORK, WORK), cache=True, nogil=True)
def _compared(before, after):  # type: ignore[no-untyped-def]
    """(solid components of `before`: area, box, number of the component of `after` that holds a pixel of it, or -1;
    void components: area, box, whether anything of them is left)."""
    runs, parent, _ = label_runs(before, False)
    solid = _measured(runs, parent, after, False)
    after_runs, after_parent, _ = label_runs(after, False)
    first_of_row = np.zeros(before.shape[1] + 1, np.int64)
    for k in range(after_parent.shape[0]):
        first_of_row[after_runs[k, 0] + 1] = k + 1
    for y in range(before.shape[1]):
        first_of_row[y + 1] = max(first_of_row[y + 1], first_of_row[y])
    i = 0
    for k in range(parent.shape[0]):
        if parent[k] == k:
            solid[i, BECOMES] = -1 - k  # not known yet
            i += 1
    number = np.zeros(parent.shape[0], np.int64)
    i = 0
    for k in range(parent.shape[0]):
        if parent[k] == k:
            number[k] = i
            i += 1
    for k in range(parent.shape[0]):
        i = number[root_of(parent, k)]
        if solid[i, BECOMES] >= 0:
            continue
        y, first, stop = runs[k]
        for j in range(first_of_row[y], first_of_row[y + 1]):
            if after_runs[j, 1] < stop and after_runs[j, 2] > first:
                solid[i, BECOMES] = root_of(after_parent, j)
                break
    runs, parent, _ = label_runs(before, True)
    return solid, _measured(runs, parent, after, True)


def changes_of(before: NDArray[np.uint64], after: NDArray[np.uint64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The two tables of the kernel for two layers as columns of one box."""
    found: tuple[NDArray[np.int64], NDArray[np.int64]] = _compared(before, after)
    return found


def told(
    solid: NDArray[np.int64],
    void: NDArray[np.int64],
    corner_px: tuple[int, int],
    pixel_mm: tuple[float, float],
    origin_mm: tuple[float, float],
) -> tuple[TopologyChange, ...]:
    """The tables as what happened; corner_px: column and row of the frame where their counting begins."""

    def box_mm(rows: NDArray[np.int64]) -> tuple[float, float, float, float]:
        left, right = rows[:, LEFT].min() + corner_px[0], rows[:, RIGHT].max() + corner_px[0]
        top, bottom = rows[:, TOP].min() + corner_px[1], rows[:, BOTTOM].max() + corner_px[1]
        return (
            float(origin_mm[0] + left * pixel_mm[0]),
            float(origin_mm[1] - bottom * pixel_mm[1]),
            float(origin_mm[0] + right * pixel_mm[0]),
            float(origin_mm[1] - top * pixel_mm[1]),
        )

    area_mm2 = pixel_mm[0] * pixel_mm[1]
    changes = []
    order = np.argsort(solid[:, BECOMES], kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(solid[order, BECOMES])) + 1):
        rows = solid[group]
        if len(rows) and rows[0, BECOMES] < 0:
            changes.append(TopologyChange("lost", 1, box_mm(rows), float(rows[0, AREA] * area_mm2)))
        elif len(rows) > 1:
            joined_px = int(rows[:, AREA].sum() - rows[:, AREA].max())
            changes.append(TopologyChange("merged", len(rows), box_mm(rows), joined_px * area_mm2))
    closed = void[void[:, BECOMES] == 0]
    changes += [TopologyChange("closed", 1, box_mm(row[None]), float(row[AREA] * area_mm2)) for row in closed]
    return tuple(sorted(changes, key=lambda change: -change.area_mm2))


def compare_topology(
    before: LayerStack | Layer | ArrayLike, after: LayerStack | Layer | ArrayLike
) -> list[TopologyChange]:
    """Which components merged and which holes closed between two layers or stacks, the largest first.

    before, after  two stacks of one frame and as many layers; or two layers, or (H, W) images, whose pixels then
                   count as millimetres, the first row's upper edge at 0
    raises         InputError for two that do not match
    """
    if isinstance(before, LayerStack) and isinstance(after, LayerStack):
        if (before.width, before.height, len(before)) != (after.width, after.height, len(after)):
            raise InputError(
                f"{len(before)} layers of {before.width} × {before.height} px and {len(after)} of"
                f" {after.width} × {after.height} px: they have to match"
            )
        found = [
            replace(change, z_mm=one.z_mm)
            for one, other in zip(before, after, strict=True)
            for change in _of_layers(one.rows, other.rows, before.pixel_mm, before.origin_mm)
        ]
        return sorted(found, key=lambda change: -change.area_mm2)
    if isinstance(before, LayerStack) or isinstance(after, LayerStack):
        raise InputError("a stack can be compared with a stack only")
    rows = [layer.rows if isinstance(layer, Layer) else pack(layer) for layer in (before, after)]
    if rows[0].shape != rows[1].shape:
        raise InputError(f"layers of {rows[0].shape} and {rows[1].shape} packed rows: they have to match")
    return list(_of_layers(rows[0], rows[1], (1.0, 1.0), (0.0, 0.0)))


def _of_layers(
    before: Rows, after: Rows, pixel_mm: tuple[float, float], origin_mm: tuple[float, float]
) -> tuple[TopologyChange, ...]:
    if not before.any() or np.array_equal(before, after):
        return ()
    outer = with_border(bounding_box(before | after), 0, 0)
    solid, void = changes_of(to_columns(before, outer), to_columns(after, outer))
    return told(solid, void, (64 * outer[2], outer[0]), pixel_mm, origin_mm)
