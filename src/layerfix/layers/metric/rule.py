"""The metric rule, step by step, on one layer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import U0, WORK
from layerfix.kernels import njit
from layerfix.layers.columns import BLOCK
from layerfix.layers.metric.cones import disc_erosions, erosions, significant, tips
from layerfix.layers.metric.levels import plan_for
from layerfix.layers.metric.retreat import retreat
from layerfix.layers.metric.tiles import clear_live, near_free, tiles_of
from layerfix.layers.thinning import (
    FIRST,
    SECOND,
    flag_blocks,
    flag_free,
    remove_spurs,
    start_changes,
    sub_iteration,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from layerfix.layers.columns import Room
    from layerfix.layers.feature import Feature
    from layerfix.layers.metric.levels import Plan

STRIP = 8  # columns for each that a strip needs on either side, of which there are two at least


@njit(types.void(WORK, WORK, WORK, types.boolean, WORK), cache=True, nogil=True)
def thin_protected(columns, anchor, protected, everywhere, scratch):  # type: ignore[no-untyped-def]
    """Guo–Hall around `anchor` until nothing changes; ends go in each round, unless they are `protected`.

    Unless `everywhere`, it begins only near what is protected and not anchored.
    """
    words, height = columns.shape
    blocks = (height - 2) // BLOCK
    changed = np.zeros((4, words, blocks), np.uint8)
    active = np.zeros((words, blocks), np.uint8)
    gone = np.zeros((2, height), np.uint64)
    if everywhere:
        start_changes(columns, changed)
    else:
        line = np.empty(height - 2, np.uint64)
        for w in range(1, words - 1):
            here, kept, fixed = columns[w][1:], protected[w][1:], anchor[w][1:]
            for i in range(height - 2):
                line[i] = here[i] & kept[i] & ~fixed[i]
            flag_blocks(line, changed[0, w])
    flag_free(columns, anchor, protected, changed)
    again = True
    while again:
        again = sub_iteration(columns, anchor, FIRST, changed, active, gone)
        again = sub_iteration(columns, anchor, SECOND, changed, active, gone) or again
        again = remove_spurs(columns, protected, changed, active, gone, scratch) or again


@njit(types.boolean(WORK, WORK, WORK), cache=True, nogil=True)
def _either(a, b, out):  # type: ignore[no-untyped-def]
    """out = a ∪ b; True if b has anything."""
    seen = U0
    for w in range(a.shape[0]):
        left, right, line = a[w], b[w], out[w]
        for i in range(left.shape[0]):
            line[i] = left[i] | right[i]
            seen |= right[i]
    return seen != U0


def _significant(
    solid: NDArray[np.uint64],
    anchor: NDArray[np.uint64],
    plan: Plan,
    room: Room,
    spare: NDArray[np.uint64],
    out: NDArray[np.uint64],
) -> None:
    """out = the pixels of S \\ A outside every cone, a strip of columns at a time, near S \\ A only.

    What is significant depends on pixels nearer than `Plan.margin_px`. The images of a strip stay in the processor's
    cache; those of a whole 12K layer took 60 MB.
    """
    words, height = solid.shape
    halo = -(-plan.margin_px // 64)
    strip, levels = STRIP * max(halo, 2), len(plan.levels)
    out[0] = out[-1] = 0
    for first in range(1, words - 1, strip):
        stop = min(first + strip, words - 1)
        begin, end = max(first - halo - 1, 0), min(stop + halo + 1, words)
        images = room.empty_images(levels + 4, (end - begin, height))
        live = np.zeros((levels + 4, end - begin, tiles_of(height)), np.uint8)
        depths, near_anchor, found = images[:levels], images[-1], spare[begin:end]
        near_free(solid[begin:end], anchor[begin:end], plan.margin_px, depths[0], live[0], near_anchor, live[-1])
        if plan.round:
            top = erosions(depths[0], plan.levels, depths, live[:levels])
        else:
            top = disc_erosions(depths[0], plan.half_widths, plan.starts, depths, live[:levels])
        significant(depths[0], near_anchor, plan.schedule, plan.elements, depths, live[:levels], top,
                    images[levels:-1], live[levels:-1], found)  # fmt: skip
        out[first:stop] = found[first - begin : stop - begin]
        clear_live(images, live)
        room.emptied(images)


def thin_metric(
    columns: NDArray[np.uint64],
    solid: NDArray[np.uint64],
    anchor: NDArray[np.uint64],
    feature: Feature,
    scratch: Sequence[NDArray[np.uint64]],
    room: Room,
) -> None:
    """Thin `columns` in place around `anchor` to the meso-skeleton whose ends are measured.

    columns, anchor  (words, height) with an empty border, `layerfix.layers.columns`
    solid            what `columns` is before
    scratch          four more of them, with anything in them
    room             its `empty_images` are used
    """
    plan = plan_for(*feature.radius_px)
    marked, kept, fixed, spare = scratch
    _significant(solid, anchor, plan, room, spare, marked)
    _either(anchor, marked, kept)
    thin_protected(columns, kept, kept, True, spare)
    tips(columns, marked, anchor, fixed)
    thin_protected(columns, fixed, kept, False, spare)
    retreat(columns, anchor, marked, solid[None], 1, plan.offsets, plan.lengths, plan.outside,
            plan.radius, plan.scale, plan.pixel)  # fmt: skip
