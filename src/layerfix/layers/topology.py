"""What a correction did to parts and holes: which grew together, which closed, where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numba import types

from layerfix.bits import WORK, pack
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import bounding_box, to_columns, with_border
from layerfix.layers.components import AREA, BOTTOM, LEFT, RIGHT, RUNS, TOP, joined_runs, measured_parts, row_edges
from layerfix.stack import Layer, LayerStack

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows

    Numbers = NDArray[np.int64]

Kind = Literal["merged", "split", "lost", "new", "closed", "enclosed", "opened"]

OUTSIDE_PX = 1 << 40  # the void around the part, whose first run is the border's, is the largest


@dataclass(frozen=True)
class TopologyChange:
    """What became of components (8-connected) and of void parts (4-connected, the outside is one) in one layer.

    kind      "merged": `count` components are one now; "split": one is `count` now; "lost": one has no pixel left;
              "new": there is one where all was void. "closed": a void part, such as a hole, is solid now;
              "enclosed": a void part is `count` now: a channel closed at its mouth, a hole cut in two; "opened":
              `count` void parts are one now or, if the count is 1, there is one where all was solid
    box_mm    (left, bottom, right, top) on the stack's frame; of what was split or enclosed: of the smaller parts
    area_mm2  of what is in the box; of several that became one: without the largest
    """

    kind: Kind
    count: int
    box_mm: tuple[float, float, float, float]
    area_mm2: float
    z_mm: tuple[float, float] = (0.0, 0.0)


@njit
def _shared(runs, number, other_runs, other_number, parts):  # type: ignore[no-untyped-def]
    """(n, 2): which components share a pixel, some several times."""
    latest = np.full(parts, -1, np.int64)
    pairs = np.empty((runs.shape[0] + other_runs.shape[0], 2), np.int64)
    n, j = 0, 0
    for k in range(runs.shape[0]):
        y, first, stop = runs[k]
        while j < other_runs.shape[0] and (
            other_runs[j, 0] < y or (other_runs[j, 0] == y and other_runs[j, 2] <= first)
        ):
            j += 1
        i = j
        while i < other_runs.shape[0] and other_runs[i, 0] == y and other_runs[i, 1] < stop:
            a, b = number[k], other_number[i]
            if latest[a] != b:
                pairs[n, 0], pairs[n, 1] = a, b
                latest[a] = b
                n += 1
            i += 1
    return pairs[:n]


@njit
def _one_to_one(pairs, parts, others):  # type: ignore[no-untyped-def]
    """Whether each component shares pixels with exactly one of the others."""
    partner, other_partner = np.full(parts, -1, np.int64), np.full(others, -1, np.int64)
    met = 0
    for k in range(pairs.shape[0]):
        a, b = pairs[k]
        if partner[a] == b and other_partner[b] == a:
            continue
        if partner[a] >= 0 or other_partner[b] >= 0:
            return False
        partner[a], other_partner[b] = b, a
        met += 1
    return met == parts and met == others


@njit(types.UniTuple(RUNS, 6)(WORK, WORK), cache=True, nogil=True)
def _overlaps(before, after):  # type: ignore[no-untyped-def]
    """(components of `before`, of `after`: area and box; (n, 2): which of them share a pixel, some several times),
    and the same of the void; of either nothing if each shares pixels with exactly one."""
    width = 64 * before.shape[0]
    starts, edges = row_edges(before)
    other_starts, other_edges = row_edges(after)
    nothing = np.empty((0, 5), np.int64)
    found = (nothing, nothing, nothing)
    for of_void in (True, False):
        runs, parent, _ = joined_runs(starts, edges, width, of_void)
        number, parts = measured_parts(runs, parent)
        other_runs, other_parent, _ = joined_runs(other_starts, other_edges, width, of_void)
        other_number, other_parts = measured_parts(other_runs, other_parent)
        pairs = _shared(runs, number, other_runs, other_number, parts.shape[0])
        if _one_to_one(pairs, parts.shape[0], other_parts.shape[0]):
            parts, other_parts, pairs = nothing, nothing, nothing
        if of_void:
            found = (parts, other_parts, pairs.copy())
        else:
            return parts, other_parts, pairs.copy(), found[0], found[1], found[2]
    return nothing, nothing, nothing, nothing, nothing, nothing


def box_of(
    part: NDArray[np.int64],
    corner_px: tuple[int, int],
    pixel_mm: tuple[float, float],
    origin_mm: tuple[float, float],
) -> tuple[float, float, float, float]:
    """(left, bottom, right, top) in mm of a row of `measured_parts`; corner_px as in `changes_of`."""
    (x, y), (px, py) = origin_mm, pixel_mm
    left, right = int(part[LEFT]) + corner_px[0], int(part[RIGHT]) + corner_px[0]
    top, bottom = int(part[TOP]) + corner_px[1], int(part[BOTTOM]) + corner_px[1]
    return x + left * px, y - bottom * py, x + right * px, y - top * py


def changes_of(
    before: NDArray[np.uint64],
    after: NDArray[np.uint64],
    corner_px: tuple[int, int],
    pixel_mm: tuple[float, float],
    origin_mm: tuple[float, float],
    z_mm: tuple[float, float] = (0.0, 0.0),
) -> tuple[TopologyChange, ...]:
    """What happened between two layers as columns of one box, the largest first.

    corner_px  column and row of the stack's frame where the box begins
    """
    found: list[TopologyChange] = []

    def tell(kind: Kind, count: int, parts: NDArray[np.int64], area_px: int) -> None:
        whole = np.array(
            [0, parts[:, LEFT].min(), parts[:, TOP].min(), parts[:, RIGHT].max(), parts[:, BOTTOM].max()]
        )
        box_mm = box_of(whole, corner_px, pixel_mm, origin_mm)
        found.append(TopologyChange(kind, count, box_mm, area_px * pixel_mm[0] * pixel_mm[1], z_mm))

    names: tuple[tuple[Kind, Kind, Kind, Kind], ...] = (
        ("merged", "split", "lost", "new"),
        ("opened", "enclosed", "closed", "opened"),
    )
    overlaps = _overlaps(before, after)
    for (many_one, one_many, gone, new), parts, others, pairs in zip(
        names, overlaps[::3], overlaps[1::3], overlaps[2::3], strict=True
    ):
        if not len(pairs) and not len(parts) and not len(others):
            continue
        if gone == "closed":
            parts[0, AREA] = others[0, AREA] = OUTSIDE_PX
        lone, other_lone, groups = _groups(len(parts), len(others), pairs)
        for mine, its in groups:
            if len(mine) > 1:
                area = parts[mine, AREA]
                tell(many_one, len(mine), parts[mine], int(area.sum() - area.max()))
            if len(its) > 1:
                smaller = np.delete(its, int(others[its, AREA].argmax()))
                tell(one_many, len(its), others[smaller], int(others[smaller, AREA].sum()))
        for k in lone:
            tell(gone, 1, parts[k : k + 1], int(parts[k, AREA]))
        for k in other_lone:
            tell(new, 1, others[k : k + 1], int(others[k, AREA]))
    return tuple(sorted(found, key=lambda change: -change.area_mm2))


def _groups(count: int, other_count: int, pairs: Numbers) -> tuple[Numbers, Numbers, list[tuple[Numbers, Numbers]]]:
    """(components without a counterpart, before and after; those before and after that hang together by shared
    pixels, where it is not one that stays one)."""
    mine, its = np.divmod(np.unique(pairs[:, 0] * max(other_count, 1) + pairs[:, 1]), max(other_count, 1))
    shares, other_shares = np.bincount(mine, minlength=count), np.bincount(its, minlength=other_count)
    mixed = (shares[mine] > 1) | (other_shares[its] > 1)
    parent: dict[int, int] = {}

    def root(k: int) -> int:
        while (above := parent.setdefault(k, k)) != k:
            parent[k] = k = parent[above]
        return k

    for a, b in zip(mine[mixed].tolist(), its[mixed].tolist(), strict=True):
        one, other = root(a), root(count + b)
        parent[max(one, other)] = min(one, other)
    members: dict[int, list[int]] = {}
    for k in sorted(parent):
        members.setdefault(root(k), []).append(k)
    groups = [(group[group < count], group[group >= count] - count) for group in map(np.array, members.values())]
    return np.flatnonzero(shares == 0), np.flatnonzero(other_shares == 0), groups


def compare_topology(
    before: LayerStack | Layer | ArrayLike, after: LayerStack | Layer | ArrayLike
) -> list[TopologyChange]:
    """Which components merged, split, were lost, and which voids closed, were enclosed or opened; the largest first.

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
            change
            for one, other in zip(before, after, strict=True)
            for change in changes_of_rows(one.rows, other.rows, before.pixel_mm, before.origin_mm, one.z_mm)
        ]
        return sorted(found, key=lambda change: -change.area_mm2)
    if isinstance(before, LayerStack) or isinstance(after, LayerStack):
        raise InputError("a stack can be compared with a stack only")
    rows = [layer.rows if isinstance(layer, Layer) else pack(layer) for layer in (before, after)]
    if rows[0].shape != rows[1].shape:
        raise InputError(f"layers of {rows[0].shape} and {rows[1].shape} packed rows: they have to match")
    return list(changes_of_rows(rows[0], rows[1], (1.0, 1.0), (0.0, 0.0)))


def changes_of_rows(
    before: Rows,
    after: Rows,
    pixel_mm: tuple[float, float],
    origin_mm: tuple[float, float],
    z_mm: tuple[float, float] = (0.0, 0.0),
) -> tuple[TopologyChange, ...]:
    """`compare_topology` of one layer as packed rows, (H, words), on a frame of this pitch and corner."""
    if np.array_equal(before, after):
        return ()
    outer = with_border(bounding_box(before | after), 0, 0)
    corner_px = 64 * outer[2], outer[0]
    return changes_of(to_columns(before, outer), to_columns(after, outer), corner_px, pixel_mm, origin_mm, z_mm)
