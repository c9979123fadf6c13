"""The metric rule, step by step, on one layer."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import U0, WORK
from layerfix.kernels import njit
from layerfix.layers.columns import BLOCK
from layerfix.layers.metric.cones import disc_erosions, erosions, significant, tips
from layerfix.layers.metric.levels import PLAN
from layerfix.layers.metric.retreat import retreat
from layerfix.layers.metric.tiles import IMAGES, clear_live, near_free, tiles_of
from layerfix.layers.thinning import (
    FIRST,
    SECOND,
    flag_blocks,
    flag_free,
    remove_spurs,
    start_changes,
    sub_iteration,
)

ZEROS = types.Array(types.uint64, 1, "C")


@njit(types.void(WORK, WORK, WORK, types.boolean, WORK), cache=True, nogil=True)
def thin_protected(columns, anchor, protected, everywhere, scratch):  # type: ignore[no-untyped-def]  # numba types it
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
            for phase in range(3):  # each must look once
                flag_blocks(line, changed[phase, w])
    flag_free(columns, anchor, protected, changed)
    again = True
    while again:
        again = sub_iteration(columns, anchor, FIRST, changed, active, gone)
        again = sub_iteration(columns, anchor, SECOND, changed, active, gone) or again
        again = remove_spurs(columns, protected, changed, active, gone, scratch) or again


@njit
def _either(a, b, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = a ∪ b."""
    for w in range(a.shape[0]):
        left, right, line = a[w], b[w], out[w]
        for i in range(left.shape[0]):
            line[i] = left[i] | right[i]


@njit(types.int64(PLAN, types.int64, types.int64), cache=True, nogil=True)
def zeros_needed(plan, words, height):  # type: ignore[no-untyped-def]  # numba types it
    """How many words the images of a strip take, in a layer of so many columns and rows."""
    levels, _, _, _, _, _, _, _, _, _, _, margin, strip, _ = plan
    return (levels.shape[0] + 4) * min(strip + 2 * ((margin + 63) // 64) + 2, words) * height


@njit(types.void(WORK, WORK, PLAN, ZEROS, WORK, WORK), cache=True, nogil=True)
def significant_pixels(solid, anchor, plan, zeros, spare, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = the pixels of S \\ A outside every cone, a strip of columns at a time, near S \\ A only.

    What is significant depends on pixels nearer than `Plan.margin_px`. The images of a strip stay in the processor's
    cache; those of a whole 12K layer took 60 MB.
    """
    levels, half_widths, starts, schedule, elements, _, _, _, _, _, _, margin, strip, square = plan
    words, height = solid.shape
    halo, count = (margin + 63) // 64, levels.shape[0]
    for w in (0, words - 1):
        for y in range(height):
            out[w, y] = U0
    for first in range(1, words - 1, strip):
        stop = min(first + strip, words - 1)
        begin, end = max(first - halo - 1, 0), min(stop + halo + 1, words)
        images = zeros[: (count + 4) * (end - begin) * height].reshape(count + 4, end - begin, height)
        live = np.zeros((count + 4, end - begin, tiles_of(height)), np.uint8)
        depths, near_anchor, found = images[:count], images[count + 3], spare[begin:end]
        near_free(solid[begin:end], anchor[begin:end], margin, depths[0], live[0], near_anchor, live[count + 3])
        if square:
            top = erosions(depths[0], levels, depths, live[:count])
        else:
            top = disc_erosions(depths[0], half_widths, starts, depths, live[:count])
        significant(depths[0], near_anchor, schedule, elements, depths, live[:count], top, images[count : count + 3],
                    live[count : count + 3], found)  # fmt: skip
        for w in range(first, stop):
            for y in range(height):
                out[w, y] = found[w - begin, y]
        clear_live(images, live)


@njit(types.void(WORK, WORK, WORK, IMAGES, PLAN, ZEROS), cache=True, nogil=True)
def thin_metric(columns, solid, anchor, scratch, plan, zeros):  # type: ignore[no-untyped-def]  # numba types it
    """Thin `columns` in place around `anchor` to the meso-skeleton whose ends are measured.

    columns, anchor  (words, height) with an empty border, `layerfix.layers.columns`
    solid            what `columns` is before
    scratch          four more of them, with anything in them
    plan             `Plan.numbers`
    zeros            `zeros_needed` words, all 0, and all 0 again afterwards
    """
    marked, kept, fixed, spare = scratch[0], scratch[1], scratch[2], scratch[3]
    significant_pixels(solid, anchor, plan, zeros, spare, marked)
    _either(anchor, marked, kept)
    thin_protected(columns, kept, kept, True, spare)
    tips(columns, marked, anchor, fixed)
    thin_protected(columns, fixed, kept, False, spare)
    depths = solid.reshape(1, solid.shape[0], solid.shape[1])
    _, _, _, _, _, offsets, lengths, outside, scale, pixel, radius, _, _, _ = plan
    retreat(columns, anchor, marked, depths, 1, offsets, lengths, outside, radius, scale, pixel)
