"""Guo–Hall thinning and spur removal of packed pixels, one sub-iteration at a time.

Source: Guo and Hall 1989, as equation 3 of Ulu et al. states it: neighbours x1 = east, then
counter-clockwise (x3 = north, the row above). A pixel goes when
  (a)   its crossing number X_H is 1: b1 + b2 + b3 + b4 = 1, b_k = ¬x_{2k-1} ∧ (x_{2k} ∨ x_{2k+1}),
  (b)   2 ≤ min(n1, n2) ≤ 3,
  (c.1) (x2 ∨ x3 ∨ ¬x8) ∧ x1 = 0 in the first sub-iteration, (c.2) (x6 ∨ x7 ∨ ¬x4) ∧ x5 = 0 in the second.
Anchored pixels are never deleted. Thinning, spurs and anchoring know nothing of each other but this.

Each phase works in place on `layerfix.layers.columns`: the deletions of a column are computed from unchanged columns
and applied once the next column's have been, so no second image is written. A phase looks only at blocks of
rows near a change: ``changed[phase, w, b]`` says whether block b of column w changed when the phase last ran,
and a block can only behave differently if one of the nine around it did, in some phase, since. With a fourth plane,
``changed[FREE]``, only blocks marked there are looked at: those with a pixel that is not anchored (`flag_free`).
"""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import U0, U1, U63, WORK
from layerfix.kernels import njit
from layerfix.layers.columns import BLOCK

FIRST, SECOND, SPURS, FREE = 0, 1, 2, 3
# Runs of blocks closer than this are one: a vector pass over a quiet block costs less than a new run.
MAX_GAP = 2
CHANGES = types.Array(types.uint8, 3, "C")
FLAGS = types.Array(types.uint8, 2, "C")
Q0, Q1 = np.uint8(0), np.uint8(1)


@njit
def flag_blocks(words, flags):  # type: ignore[no-untyped-def]  # numba types it
    """flags[b] = 1 if block b of `words` has any bit; True if one has."""
    any_bits = U0
    for b in range(flags.shape[0]):
        k = b * BLOCK
        upper = words[k] | words[k + 1] | words[k + 2] | words[k + 3]
        lower = words[k + 4] | words[k + 5] | words[k + 6] | words[k + 7]
        flags[b] = np.uint8((upper | lower) != U0)
        any_bits |= upper | lower
    return any_bits != U0


@njit(types.void(WORK, CHANGES), cache=True, nogil=True)
def start_changes(columns, changed):  # type: ignore[no-untyped-def]  # numba types it
    """Mark every block with a solid pixel as changed in every phase: each must look at it once."""
    changed[:] = Q0
    for w in range(1, columns.shape[0] - 1):
        for phase in range(3):
            flag_blocks(columns[w, 1 : columns.shape[1] - 1], changed[phase, w])


@njit(types.void(WORK, WORK, WORK, CHANGES), cache=True, nogil=True)
def flag_free(columns, anchor, protected, changed):  # type: ignore[no-untyped-def]  # numba types it
    """changed[FREE] = the blocks with a pixel that is not both anchored and protected: others can lose none."""
    height = columns.shape[1]
    line = np.empty(height - 2, np.uint64)
    for w in range(1, columns.shape[0] - 1):
        here, fixed, kept = columns[w][1:], anchor[w][1:], protected[w][1:]
        for i in range(height - 2):
            line[i] = here[i] & ~(fixed[i] & kept[i])
        flag_blocks(line, changed[FREE, w])


@njit(types.void(CHANGES, FLAGS), cache=True, nogil=True)
def find_active(changed, active):  # type: ignore[no-untyped-def]  # numba types it
    """active[w, b]: whether any of the nine blocks around block b of column w changed in any phase."""
    words, blocks = active.shape
    near = np.zeros(blocks + 2, np.uint8)
    for w in range(1, words - 1):
        for b in range(blocks):
            seen = Q0
            for phase in range(3):
                seen |= changed[phase, w - 1, b] | changed[phase, w, b] | changed[phase, w + 1, b]
            near[b + 1] = seen
        line = active[w]
        for b in range(blocks):
            line[b] = near[b] | near[b + 1] | near[b + 2]
        if changed.shape[0] > FREE:
            free = changed[FREE, w]
            for b in range(blocks):
                line[b] &= free[b]


@njit
def _next_run(flags, start):  # type: ignore[no-untyped-def]  # numba types it
    """(first, past the last) block of the next run of set flags from `start`; first = len(flags) if none."""
    blocks = flags.shape[0]
    while start < blocks and flags[start] == Q0:
        start += 1
    stop, quiet = start, 0
    while stop + quiet < blocks and quiet <= MAX_GAP:
        if flags[stop + quiet] != Q0:
            stop += quiet + 1
            quiet = 0
        else:
            quiet += 1
    return start, stop


@njit
def _apply(column, gone, flags):  # type: ignore[no-untyped-def]  # numba types it
    """column &= ~gone in the flagged blocks.

    Bridged blocks are harmless: the run that computed `gone` bridged the same gaps, so there it is 0, not old.
    """
    start, stop = _next_run(flags, 0)
    while start < stop:
        here = column[1 + start * BLOCK : 1 + stop * BLOCK]
        dead = gone[1 + start * BLOCK : 1 + stop * BLOCK]
        for i in range(here.shape[0]):
            here[i] &= ~dead[i]
        start, stop = _next_run(flags, stop)


@njit
def _deletable(x1, x2, x3, x4, x5, x6, x7, x8):  # type: ignore[no-untyped-def]  # numba types it
    """Conditions (a) and (b) for 64 pixels at once."""
    p12, p34, p56, p78 = x1 | x2, x3 | x4, x5 | x6, x7 | x8  # the terms of n1
    p23, p45, p67, p81 = x2 | x3, x4 | x5, x6 | x7, x8 | x1  # the terms of n2
    b1, b2, b3, b4 = ~x1 & p23, ~x3 & p45, ~x5 & p67, ~x7 & p81
    crossing_is_1 = (b1 ^ b2 ^ b3 ^ b4) & ~((b1 & b2) | (b3 & b4))
    n1_at_least_2 = (p12 & p34) | (p56 & p78) | ((p12 | p34) & (p56 | p78))
    n2_at_least_2 = (p23 & p45) | (p67 & p81) | ((p23 | p45) & (p67 | p81))
    both_are_4 = p12 & p34 & p56 & p78 & p23 & p45 & p67 & p81
    return crossing_is_1 & n1_at_least_2 & n2_at_least_2 & ~both_are_4


# The loops below run down three columns; x1 … x8 are the neighbours of the 64 pixels of word i + 1.
@njit
def _first_pass(west, here, east, anchor, gone):  # type: ignore[no-untyped-def]  # numba types it
    for i in range(gone.shape[0]):
        x3, c, x7 = here[i], here[i + 1], here[i + 2]
        x4, x5, x6 = (
            (x3 << U1) | (west[i] >> U63),
            (c << U1) | (west[i + 1] >> U63),
            (x7 << U1) | (west[i + 2] >> U63),
        )
        x2, x1, x8 = (
            (x3 >> U1) | (east[i] << U63),
            (c >> U1) | (east[i + 1] << U63),
            (x7 >> U1) | (east[i + 2] << U63),
        )
        gone[i] = c & ~anchor[i] & ~((x2 | x3 | ~x8) & x1) & _deletable(x1, x2, x3, x4, x5, x6, x7, x8)


@njit
def _second_pass(west, here, east, anchor, gone):  # type: ignore[no-untyped-def]  # numba types it
    for i in range(gone.shape[0]):
        x3, c, x7 = here[i], here[i + 1], here[i + 2]
        x4, x5, x6 = (
            (x3 << U1) | (west[i] >> U63),
            (c << U1) | (west[i + 1] >> U63),
            (x7 << U1) | (west[i + 2] >> U63),
        )
        x2, x1, x8 = (
            (x3 >> U1) | (east[i] << U63),
            (c >> U1) | (east[i + 1] << U63),
            (x7 >> U1) | (east[i + 2] << U63),
        )
        gone[i] = c & ~anchor[i] & ~((x6 | x7 | ~x4) & x5) & _deletable(x1, x2, x3, x4, x5, x6, x7, x8)


@njit(types.boolean(WORK, WORK, types.int64, CHANGES, FLAGS, WORK), cache=True, nogil=True)
def sub_iteration(columns, anchor, phase, changed, active, gone):  # type: ignore[no-untyped-def]  # numba types it
    """One Guo–Hall sub-iteration (phase FIRST or SECOND) in place; True if a pixel was deleted.

    columns, anchor: (words, height); changed: (3, words, blocks) uint8; active: (words, blocks) uint8 and
    gone: (2, height), scratch.
    """
    words = columns.shape[0]
    find_active(changed, active)
    any_deleted = False
    for w in range(1, words - 1):
        found = changed[phase, w]
        found[:] = Q0
        start, stop = _next_run(active[w], 0)
        while start < stop:
            first, last = 1 + start * BLOCK, 1 + stop * BLOCK
            west = columns[w - 1, first - 1 : last + 1]
            here = columns[w, first - 1 : last + 1]
            east = columns[w + 1, first - 1 : last + 1]
            dead = gone[w & 1, first:last]
            if phase == FIRST:
                _first_pass(west, here, east, anchor[w, first:last], dead)
            else:
                _second_pass(west, here, east, anchor[w, first:last], dead)
            any_deleted |= flag_blocks(dead, found[start:stop])
            start, stop = _next_run(active[w], stop)
        _apply(columns[w - 1], gone[(w - 1) & 1], changed[phase, w - 1])
    _apply(columns[words - 2], gone[words & 1], changed[phase, words - 2])
    return any_deleted


@njit
def _end_points(west, here, east, anchor, ends, gone):  # type: ignore[no-untyped-def]  # numba types it
    """End points (exactly one 8-neighbour): `gone` if it lies E, NE, N or NW, `ends` otherwise."""
    for i in range(gone.shape[0]):
        x3, c, x7 = here[i], here[i + 1], here[i + 2]
        x4, x5, x6 = (
            (x3 << U1) | (west[i] >> U63),
            (c << U1) | (west[i + 1] >> U63),
            (x7 << U1) | (west[i + 2] >> U63),
        )
        x2, x1, x8 = (
            (x3 >> U1) | (east[i] << U63),
            (c >> U1) | (east[i + 1] << U63),
            (x7 >> U1) | (east[i + 2] << U63),
        )
        # Per row, and for the three sides: at least one, at least two.
        up, up_two = x2 | x3 | x4, (x2 & x3) | ((x2 | x3) & x4)
        down, down_two = x6 | x7 | x8, (x6 & x7) | ((x6 | x7) & x8)
        beside, beside_two = x1 | x5, x1 & x5
        two = up_two | down_two | beside_two | (up & down) | ((up | down) & beside)
        end = c & ~anchor[i] & (up | down | beside) & ~two
        upper = end & (up | x1)
        gone[i] = upper
        ends[i] = end & ~upper


@njit
def _still_ends(west, here, east, ends, gone):  # type: ignore[no-untyped-def]  # numba types it
    """The end points left over that still have their one neighbour."""
    for i in range(gone.shape[0]):
        column = here[i] | here[i + 1] | here[i + 2]
        left = west[i] | west[i + 1] | west[i + 2]
        right = east[i] | east[i + 1] | east[i + 2]
        around = here[i] | here[i + 2] | (column << U1) | (left >> U63) | (column >> U1) | (right << U63)
        gone[i] = ends[i] & here[i + 1] & around


@njit(types.boolean(WORK, WORK, CHANGES, FLAGS, WORK, WORK), cache=True, nogil=True)
def remove_spurs(columns, anchor, changed, active, gone, ends):  # type: ignore[no-untyped-def]  # numba types it
    """The paper's spur removal, one pixel per call, in place; True if a pixel was deleted.

    Of the end points at the start, first those go whose only neighbour lies E, NE, N or NW, then those of
    the others that still are end points. (Deleting all at once erases two-pixel components: it changed the
    topology of 263 of 300 random images.) Arguments as in `sub_iteration`; ends: (words, height), scratch.
    """
    words = columns.shape[0]
    find_active(changed, active)
    any_deleted, any_left = False, False
    for w in range(1, words - 1):
        found, left = changed[SPURS, w], active[w]
        found[:] = Q0
        start, stop = _next_run(left, 0)
        while start < stop:
            first, last = 1 + start * BLOCK, 1 + stop * BLOCK
            west = columns[w - 1, first - 1 : last + 1]
            here = columns[w, first - 1 : last + 1]
            east = columns[w + 1, first - 1 : last + 1]
            dead, rest = gone[w & 1, first:last], ends[w, first:last]
            _end_points(west, here, east, anchor[w, first:last], rest, dead)
            any_deleted |= flag_blocks(dead, found[start:stop])
            any_left |= flag_blocks(rest, left[start:stop])  # from here on: blocks with ends left to try
            start, stop = _next_run(left, stop)
        _apply(columns[w - 1], gone[(w - 1) & 1], changed[SPURS, w - 1])
    _apply(columns[words - 2], gone[words & 1], changed[SPURS, words - 2])
    if not any_left:
        return any_deleted

    # `ends` is that of this call also in bridged blocks: the first half's run, which these are part of, bridged them.
    found_before = np.zeros(active.shape[1], np.uint8)
    found = np.zeros(active.shape[1], np.uint8)
    for w in range(1, words - 1):
        found[:] = Q0
        start, stop = _next_run(active[w], 0)
        while start < stop:
            first, last = 1 + start * BLOCK, 1 + stop * BLOCK
            west = columns[w - 1, first - 1 : last + 1]
            here = columns[w, first - 1 : last + 1]
            east = columns[w + 1, first - 1 : last + 1]
            dead = gone[w & 1, first:last]
            _still_ends(west, here, east, ends[w, first:last], dead)
            any_deleted |= flag_blocks(dead, found[start:stop])
            start, stop = _next_run(active[w], stop)
        _apply(columns[w - 1], gone[(w - 1) & 1], found_before)
        for b in range(found.shape[0]):
            changed[SPURS, w, b] |= found[b]
        found, found_before = found_before, found
    _apply(columns[words - 2], gone[words & 1], found_before)
    return any_deleted
