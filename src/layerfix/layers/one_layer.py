"""One layer corrected, on `layerfix.layers.columns`: Ŝ, where F was drawn, and what had to stay too narrow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import types

from layerfix.bits import ROWS, WORK, popcount
from layerfix.kernels import njit
from layerfix.layers.columns import BOX, Room, fill_columns, to_rows
from layerfix.layers.drawing import box_with_reach, draw_paths, missing_places
from layerfix.layers.feature import Feature
from layerfix.layers.gaps import Grow, centres_apart, grow_apart, one_by_one, void_parts
from layerfix.layers.print_paths import IMAGES_OF_LAYER, printed_and_paths, tool_of
from layerfix.layers.skeleton import Spurs
from layerfix.layers.thickness import narrowest

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.layers.gaps import Kind as Conflicting

    Columns = NDArray[np.uint64]
    Found = tuple[Conflicting, NDArray[np.int64], float]  # a component: area and box; its width in mm


@njit(types.UniTuple(types.int64, 3)(ROWS, WORK), cache=True, nogil=True)
def _count_changes(before, after):  # type: ignore[no-untyped-def]  # numba types it
    """(solid before, added, removed) in pixels."""
    solid, added, removed = 0, 0, 0
    for y in range(before.shape[0]):
        for w in range(before.shape[1]):
            a, b = before[y, w], after[y, w]
            if a:
                solid += popcount(a)
            if a != b:
                added += popcount(b & ~a)
                removed += popcount(a & ~b)
    return solid, added, removed


@njit(
    types.Tuple((types.int64, types.int64, types.int64, types.float64))(
        ROWS, WORK, WORK, WORK, BOX, types.int64, types.float64, types.float64, types.float64, WORK
    ),
    cache=True,
    nogil=True,
)
def finish(before, solid, paths, printed, outer, width, limit_mm, px_mm, py_mm, out):  # type: ignore[no-untyped-def]  # numba types it
    """out |= what is printed, as rows. Returns (solid before, added, removed) in pixels, and how narrow S is on the
    paths."""
    to_rows(printed, outer, width, out)
    counts = _count_changes(before, out)
    return counts[0], counts[1], counts[2], narrowest(solid, paths, limit_mm, px_mm, py_mm, False)


@dataclass(frozen=True)
class Free:
    """What is to stay free, in pixels; keep_out are packed rows where nothing is added."""

    gap_px: tuple[float, float] | None = None
    grow: Grow = "both"
    keep_out: Rows | None = None


class Corrected(NamedTuple):
    """A box, and as columns of it, in a `Room`: S, its paths, where F was drawn, the result."""

    outer: tuple[int, int, int, int]
    solid: Columns
    paths: Columns
    centres: Columns
    printed: Columns
    conflicts: list[Found]


def corrected_columns(
    rows: Rows,
    feature: Feature,
    spurs: Spurs,
    add_only: bool,
    room: Room,
    free: Free | None = None,
    pixel_mm: tuple[float, float] = (1.0, 1.0),
    small: NDArray[np.int64] | None = None,
) -> Corrected | None:
    """One layer; None if it is empty."""
    disc = feature.half_widths, *feature.block
    shifts = free is not None and (free.keep_out is not None or free.grow != "both")
    reach_x, reach_y = feature.reach_px
    outer = box_with_reach(rows, (1 + shifts) * reach_x, (1 + shifts) * reach_y)
    if outer[1] == 0:
        return None
    images = room.columns(outer, IMAGES_OF_LAYER)
    solid, _, skeleton, printed, paths, spare = images[:6]
    fill_columns(rows, outer, solid)
    centres = paths
    conflicts: list[Found] = []
    gap_px = None if free is None else free.gap_px
    tool = tool_of(feature, spurs)
    found_any = printed_and_paths(images, tool, room, whole=gap_px is not None, draw=not shifts)
    if found_any and shifts and free is not None:
        centres, kept, conflicts = _kept_out(solid, paths, outer, feature, free, pixel_mm)
        draw_paths(centres, printed, *disc, spare)
        np.bitwise_or(printed, kept, out=printed)
    dots = np.empty_like(solid) if small is not None else solid
    if small is not None and missing_places(printed, small, outer[0], 64 * outer[2], dots):
        if free is not None and shifts:
            dots, kept, more = _kept_out(solid, dots, outer, feature, free, pixel_mm)
            np.bitwise_or(printed, kept, out=printed)
            conflicts += more
        draw_paths(dots, printed, *disc, spare)
        paths, centres = paths | dots & solid, centres | dots
    if add_only:
        np.bitwise_or(printed, solid, out=printed)
    if gap_px is not None:
        found = grow_apart(solid, skeleton, printed, centres, feature, gap_px, pixel_mm)
        conflicts += [("gap", *one) for one in found]
    return Corrected(outer, solid, paths, centres, printed, conflicts)


def _kept_out(
    solid: Columns,
    paths: Columns,
    outer: tuple[int, int, int, int],
    feature: Feature,
    free: Free,
    pixel_mm: tuple[float, float],
) -> tuple[Columns, Columns, list[Found]]:
    """(where F is drawn so that nothing is added where nothing is to be; what stays as it was, since F can be drawn
    nowhere near; conflicts)."""
    forbidden = np.zeros_like(solid)
    if free.keep_out is not None:
        fill_columns(free.keep_out, outer, forbidden)
    if free.grow != "both":
        side = np.empty_like(solid)
        void_parts(solid, free.grow == "outward", side)
        forbidden |= side
    centres, stuck = np.empty_like(solid), np.empty_like(solid)
    if not centres_apart(solid, forbidden, paths, feature, centres, stuck):
        return centres, stuck, []
    limit_mm = max(2 * r * p for r, p in zip(feature.radius_px, pixel_mm, strict=True))
    found: list[Found] = []
    for part, only in one_by_one(stuck):
        inside = only & solid  # a crumb may hold no pixel
        width_mm = narrowest(solid, inside, limit_mm, *pixel_mm, False) if inside.any() else min(pixel_mm)
        found.append(("keep_out", part, float(width_mm)))
    kept = np.zeros_like(solid)
    draw_paths(stuck, kept, feature.half_widths, *feature.block, np.empty_like(solid))
    return centres, kept & solid, found
