"""What a correction did to parts and holes: which grew together, which closed, where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from layerfix.bits import WORK, pack
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import bounding_box, to_columns, with_border
from layerfix.layers.components import (
    AREA,
    BOTTOM,
    LEFT,
    RIGHT,
    RUNS,
    TOP,
    joined_runs,
    measured_parts,
    root_of,
    row_edges,
)
from layerfix.stack import Layer, LayerStack

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.bits import Rows

Kind = Literal["merged", "split", "lost", "new", "closed", "enclosed", "opened"]

# Several became one, one several, one is gone, one is new: of components, then of voids.
KINDS: tuple[Kind, ...] = ("merged", "split", "lost", "new", "opened", "enclosed", "closed", "opened")
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
def _shared(runs, number, other_runs, other_number):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 3): components that share pixels in a run of each, and how many: some pairs several times."""
    pairs = np.empty((runs.shape[0] + other_runs.shape[0], 3), np.int64)
    n, j = 0, 0
    for k in range(runs.shape[0]):
        y, first, stop = runs[k]
        while j < other_runs.shape[0] and (
            other_runs[j, 0] < y or (other_runs[j, 0] == y and other_runs[j, 2] <= first)
        ):
            j += 1
        i = j
        while i < other_runs.shape[0] and other_runs[i, 0] == y and other_runs[i, 1] < stop:
            pairs[n, 0], pairs[n, 1] = number[k], other_number[i]
            pairs[n, 2] = min(stop, other_runs[i, 2]) - max(first, other_runs[i, 1])
            n += 1
            i += 1
    return pairs[:n]


@njit
def _counterparts(pairs, parts, others):  # type: ignore[no-untyped-def]  # numba types it
    """Those pairs, each once, of which one shares more with the other than with any else.

    Where a part lost a corner and its neighbour grew over that, they share pixels, and nothing else: neither is the
    other's counterpart.
    """
    starts = np.zeros(parts + 1, np.int64)
    for k in range(pairs.shape[0]):
        starts[pairs[k, 0] + 1] += 1
    for a in range(parts):
        starts[a + 1] += starts[a]
    order, where = np.empty(pairs.shape[0], np.int64), starts.copy()
    for k in range(pairs.shape[0]):
        order[where[pairs[k, 0]]] = k
        where[pairs[k, 0]] += 1
    area, once, n = np.zeros(others, np.int64), np.empty((pairs.shape[0], 3), np.int64), 0
    most, most_of = np.full(parts, -1, np.int64), np.full(others, -1, np.int64)  # numbers of pairs
    for a in range(parts):
        mine = order[starts[a] : starts[a + 1]]
        for k in mine:
            area[pairs[k, 1]] += pairs[k, 2]
        for k in mine:
            b = pairs[k, 1]
            if area[b] == 0:
                continue
            once[n, 0], once[n, 1], once[n, 2] = a, b, area[b]
            area[b] = 0
            if most[a] < 0 or once[n, 2] > once[most[a], 2]:
                most[a] = n
            if most_of[b] < 0 or once[n, 2] > once[most_of[b], 2]:
                most_of[b] = n
            n += 1
    kept = 0
    for k in range(n):
        a, b = once[k, 0], once[k, 1]
        if most[a] == k or most_of[b] == k:
            once[kept, 0], once[kept, 1] = a, b
            kept += 1
    return once[:kept, :2]


@njit
def _joined(parts, others, pairs):  # type: ignore[no-untyped-def]  # numba types it
    """Of each component, before and then after, the least number of those it hangs together with by these pairs."""
    count = parts.shape[0]
    parent = np.arange(count + others.shape[0])
    for k in range(pairs.shape[0]):
        a, b = root_of(parent, pairs[k, 0]), root_of(parent, count + pairs[k, 1])
        if a != b:
            parent[max(a, b)] = min(a, b)
    for k in range(parent.shape[0]):
        parent[k] = root_of(parent, k)
    return parent


@njit
def _tell(table, n, kind, number, area, box):  # type: ignore[no-untyped-def]  # numba types it
    """The table with one row more as its n-th."""
    if n == table.shape[0]:
        longer = np.empty((2 * n, 7), np.int64)
        longer[:n] = table
        table = longer
    table[n, 0], table[n, 1], table[n, 2] = kind, number, area
    for k in range(4):
        table[n, 3 + k] = box[LEFT + k]
    return table


@njit
def _with_box(box, part):  # type: ignore[no-untyped-def]  # numba types it
    """Make a box hold a component's, too."""
    box[LEFT], box[TOP] = min(box[LEFT], part[LEFT]), min(box[TOP], part[TOP])
    box[RIGHT], box[BOTTOM] = max(box[RIGHT], part[RIGHT]), max(box[BOTTOM], part[BOTTOM])


@njit
def _add_changes(parts, others, pairs, kind, table, n):  # type: ignore[no-untyped-def]  # numba types it
    """What became of some components, appended to a table of n rows: first where several became one and one several,
    then those that have no counterpart. Returns the table and its number of rows."""
    joined = _joined(parts, others, pairs)
    sizes, largest = np.zeros((joined.shape[0], 2), np.int64), np.full((joined.shape[0], 2), -1, np.int64)
    for k in range(joined.shape[0]):
        side = np.int64(k >= parts.shape[0])
        area = others[k - parts.shape[0], AREA] if side else parts[k, AREA]
        root = joined[k]
        sizes[root, side] += 1
        most = largest[root, side]
        if most < 0 or area > (others[most - parts.shape[0], AREA] if side else parts[most, AREA]):
            largest[root, side] = k
    following, latest = np.full(joined.shape[0], -1, np.int64), np.empty(joined.shape[0], np.int64)
    for k in range(joined.shape[0]):  # a chain from each root through all that hang together with it
        if joined[k] != k:
            following[latest[joined[k]]] = k
        latest[joined[k]] = k
    box = np.empty(5, np.int64)
    for root in range(joined.shape[0]):
        for after in range(2):
            if joined[root] != root or sizes[root, after] < 2:
                continue
            box[LEFT] = box[TOP] = np.int64(1) << 62
            box[RIGHT] = box[BOTTOM] = -1
            area, k = 0, root
            while k >= 0:
                if (k >= parts.shape[0]) == (after == 1):
                    part = others[k - parts.shape[0]] if after else parts[k]
                    if k != largest[root, after]:
                        area += part[AREA]
                    if not after or k != largest[root, after]:  # the largest of what was split is what it was
                        _with_box(box, part)
                k = following[k]
            table = _tell(table, n, kind + after, sizes[root, after], area, box)
            n += 1
    for k in range(joined.shape[0]):
        side = np.int64(k >= parts.shape[0])
        if sizes[joined[k], 0] + sizes[joined[k], 1] == 1:
            part = others[k - parts.shape[0]] if side else parts[k]
            table = _tell(table, n, kind + 2 + side, 1, part[AREA], part)
            n += 1
    return table, n


@njit(RUNS(WORK, WORK), cache=True, nogil=True)
def _changes(before, after):  # type: ignore[no-untyped-def]  # numba types it
    """(n, 7): what became of components and of voids: which of KINDS, count, area, left, top, right, bottom."""
    width = 64 * before.shape[0]
    starts, edges = row_edges(before)
    other_starts, other_edges = row_edges(after)
    table, n = np.empty((8, 7), np.int64), 0
    for of_void in (False, True):
        runs, parent, _ = joined_runs(starts, edges, width, of_void)
        number, parts = measured_parts(runs, parent)
        other_runs, other_parent, _ = joined_runs(other_starts, other_edges, width, of_void)
        other_number, others = measured_parts(other_runs, other_parent)
        pairs = _shared(runs, number, other_runs, other_number)
        pairs = _counterparts(pairs, parts.shape[0], others.shape[0])
        if of_void:
            parts[0, AREA] = others[0, AREA] = OUTSIDE_PX
        table, n = _add_changes(parts, others, pairs, 4 if of_void else 0, table, n)
    return table[:n].copy()


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
    found = []
    for kind, count, area, *box in _changes(before, after).tolist():
        box_mm = box_of(np.array([0, *box]), corner_px, pixel_mm, origin_mm)
        found.append(TopologyChange(KINDS[kind], count, box_mm, area * pixel_mm[0] * pixel_mm[1], z_mm))
    return tuple(sorted(found, key=lambda change: -change.area_mm2))


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
        check_same_frame(before, after)
        found = [
            change
            for one, other in zip(before, after, strict=True)
            for change in changes_of_rows(one.rows, other.rows, before.pixel_mm, before.origin_mm, one.z_mm)
        ]
        return sorted(found, key=lambda change: -change.area_mm2)
    if isinstance(before, LayerStack) or isinstance(after, LayerStack):
        raise InputError("a stack can be compared with a stack only")
    one, other = ((layer.rows, layer.width) if isinstance(layer, Layer) else (pack(layer), np.shape(layer)[1])
                  for layer in (before, after))  # fmt: skip
    sizes = [f"{width} × {len(rows)} px" for rows, width in (one, other)]
    if sizes[0] != sizes[1]:
        raise InputError(f"layers of {sizes[0]} and {sizes[1]}: they have to match")
    return list(changes_of_rows(one[0], other[0], (1.0, 1.0), (0.0, 0.0)))


def check_same_frame(before: LayerStack, after: LayerStack) -> None:
    """Raises InputError unless pixels and layers of two stacks, of as many of both, are at the same places."""
    for name, one, other in (
        ("pixels", before.pixel_mm, after.pixel_mm),
        ("corners", before.origin_mm, after.origin_mm),
    ):
        if not np.allclose(one, other, rtol=1e-6, atol=1e-6):
            shown = (" × ".join(f"{value:.6g}" for value in pair) for pair in (one, other))
            raise InputError(f"{name} of {' and of '.join(shown)} mm: they have to match")
    check_same_heights(before, after, ("one", "the other"))


def check_same_heights(before: LayerStack, after: LayerStack, names: tuple[str, str]) -> None:
    """Raises InputError, with the first layer and both names, unless all layers of two stacks are at the same z."""
    same = np.isclose(before.z_mm, after.z_mm, atol=1e-4).all(axis=1)
    if not same.all():
        k = int(np.flatnonzero(~same)[0])
        raise InputError(
            f"layer {k} is at z {before.z_mm[k, 0]:g} to {before.z_mm[k, 1]:g} mm in {names[0]} and at"
            f" {after.z_mm[k, 0]:g} to {after.z_mm[k, 1]:g} mm in {names[1]}"
        )


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
