"""Guo–Hall thinning and spur removal of packed rows, one sub-iteration at a time.

Source: Guo and Hall 1989, as equation 3 of Ulu et al. states it: neighbours x1 = east, then
counter-clockwise (x3 = north, the row above). A pixel goes when
  (a)   its crossing number X_H is 1: b1 + b2 + b3 + b4 = 1, b_k = ¬x_{2k-1} ∧ (x_{2k} ∨ x_{2k+1}),
  (b)   2 ≤ min(n1, n2) ≤ 3,
  (c.1) (x2 ∨ x3 ∨ ¬x8) ∧ x1 = 0 in the first sub-iteration, (c.2) (x6 ∨ x7 ∨ ¬x4) ∧ x5 = 0 in the second.
Anchored pixels are never deleted. Thinning, spurs and anchoring know nothing of each other but this.

Each phase works in place on a padded array (`layerfix.morphology`): row y's deletions are computed from
unchanged rows and applied once row y + 1 has been, so no second image is written. A phase revisits only
words near a change: `changed[phase][y]` holds one bit per group of words that changed when the phase last
ran, and a word can only behave differently if one of the nine groups around it did in some phase since.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types

from layerfix.bits import ALL, ROW_BITS, U0, U1, U63, WORK, lowest_bit

FIRST, SECOND, SPURS = 0, 1, 2
# Runs of words closer than this are done as one: a vector pass over a few quiet words is cheaper than a new run.
MAX_GAP = 8
CHANGES = types.Array(types.uint64, 2, "C")


@njit(inline="always")
def _without(bits, stop):  # type: ignore[no-untyped-def]
    """`bits` with everything below bit `stop` cleared."""
    return U0 if stop >= 64 else bits & (ALL << np.uint64(stop))


@njit(inline="always")
def _group_size(padded):  # type: ignore[no-untyped-def]
    """Words per change bit: 1 up to 4096 px, so that 64 bits always span the row."""
    return (padded.shape[1] - 2 + 63) // 64


@njit(types.void(CHANGES, ROW_BITS), cache=True, nogil=True)
def active_groups(changed, active):  # type: ignore[no-untyped-def]
    """active[y]: groups of row y with a change, in any phase, in the nine groups around them."""
    height = active.shape[0] - 2
    above = U0
    here = changed[0, 1] | changed[1, 1] | changed[2, 1]
    for y in range(1, height + 1):
        below = changed[0, y + 1] | changed[1, y + 1] | changed[2, y + 1]
        bits = above | here | below
        active[y] = bits | (bits << U1) | (bits >> U1)
        above, here = here, below


@njit(inline="always")
def _groups_with_bits(line, group, size):  # type: ignore[no-untyped-def]
    """One bit per group of words with any bit set, for words that start with those of group `group`."""
    found = U0
    if size == 1:
        for i in range(line.shape[0]):
            found |= np.uint64(line[i] != U0) << np.uint64(group + i)
    else:
        for i in range(line.shape[0]):
            found |= np.uint64(line[i] != U0) << np.uint64(group + i // size)
    return found


@njit(inline="always")
def _words(groups, size, words):  # type: ignore[no-untyped-def]
    """The lowest run of set bits, small gaps bridged: (group, past the last, word, past the last word)."""
    first = lowest_bit(groups)
    rest = ~(groups >> np.uint64(first))
    stop = 64 if rest == U0 else min(first + lowest_bit(rest), 64)
    groups = _without(groups, stop)
    while groups != U0:
        start = lowest_bit(groups)
        if (start - stop) * size > MAX_GAP:
            break
        rest = ~(groups >> np.uint64(start))
        stop = 64 if rest == U0 else min(start + lowest_bit(rest), 64)
        groups = _without(groups, stop)
    return first, stop, 1 + first * size, min(1 + stop * size, 1 + words)


@njit(inline="always")
def _apply(line, deleted, groups, size, words):  # type: ignore[no-untyped-def]
    """line &= ~deleted in the given groups of words."""
    while groups != U0:
        _, stop, first, last = _words(groups, size, words)
        groups = _without(groups, stop)
        here, gone = line[first:last], deleted[first:last]
        for i in range(here.shape[0]):
            here[i] &= ~gone[i]


@njit(types.void(WORK, CHANGES), cache=True, nogil=True)
def start_changes(padded, changed):  # type: ignore[no-untyped-def]
    """Mark every group with a solid pixel as changed in every phase: each must look at it once."""
    size = _group_size(padded)
    changed[:] = U0
    for y in range(1, padded.shape[0] - 1):
        changed[:, y] = _groups_with_bits(padded[y, 1 : padded.shape[1] - 1], 0, size)


@njit(inline="always")
def _first_line(north, here, south, anchor, deleted):  # type: ignore[no-untyped-def]
    for i in range(deleted.shape[0]):
        w = i + 1
        x3, c, x7 = north[w], here[w], south[w]
        x4 = (x3 << U1) | (north[i] >> U63)
        x2 = (x3 >> U1) | (north[i + 2] << U63)
        x5 = (c << U1) | (here[i] >> U63)
        x1 = (c >> U1) | (here[i + 2] << U63)
        x6 = (x7 << U1) | (south[i] >> U63)
        x8 = (x7 >> U1) | (south[i + 2] << U63)
        deleted[i] = c & ~anchor[i] & ~((x2 | x3 | ~x8) & x1) & _deletable(x1, x2, x3, x4, x5, x6, x7, x8)


@njit(inline="always")
def _second_line(north, here, south, anchor, deleted):  # type: ignore[no-untyped-def]
    for i in range(deleted.shape[0]):
        w = i + 1
        x3, c, x7 = north[w], here[w], south[w]
        x4 = (x3 << U1) | (north[i] >> U63)
        x2 = (x3 >> U1) | (north[i + 2] << U63)
        x5 = (c << U1) | (here[i] >> U63)
        x1 = (c >> U1) | (here[i + 2] << U63)
        x6 = (x7 << U1) | (south[i] >> U63)
        x8 = (x7 >> U1) | (south[i + 2] << U63)
        deleted[i] = c & ~anchor[i] & ~((x6 | x7 | ~x4) & x5) & _deletable(x1, x2, x3, x4, x5, x6, x7, x8)


@njit(inline="always")
def _deletable(x1, x2, x3, x4, x5, x6, x7, x8):  # type: ignore[no-untyped-def]
    """Conditions (a) and (b) for 64 pixels at once."""
    p12, p34, p56, p78 = x1 | x2, x3 | x4, x5 | x6, x7 | x8  # the terms of n1
    p23, p45, p67, p81 = x2 | x3, x4 | x5, x6 | x7, x8 | x1  # the terms of n2
    b1, b2, b3, b4 = ~x1 & p23, ~x3 & p45, ~x5 & p67, ~x7 & p81
    crossing_is_1 = (b1 ^ b2 ^ b3 ^ b4) & ~((b1 & b2) | (b3 & b4))
    n1_at_least_2 = (p12 & p34) | (p56 & p78) | ((p12 | p34) & (p56 | p78))
    n2_at_least_2 = (p23 & p45) | (p67 & p81) | ((p23 | p45) & (p67 | p81))
    both_are_4 = p12 & p34 & p56 & p78 & p23 & p45 & p67 & p81
    return crossing_is_1 & n1_at_least_2 & n2_at_least_2 & ~both_are_4


@njit(types.boolean(WORK, WORK, types.int64, CHANGES, ROW_BITS, WORK), cache=True, nogil=True)
def sub_iteration(padded, anchor, phase, changed, active, deleted):  # type: ignore[no-untyped-def]
    """One Guo–Hall sub-iteration (phase FIRST or SECOND) in place; True if a pixel was deleted.

    padded, anchor: (h + 2, words + 2); changed: (3, h + 2); active: (h + 2,) and deleted: (2, words + 2),
    scratch.
    """
    height, words = padded.shape[0] - 2, padded.shape[1] - 2
    size = _group_size(padded)
    active_groups(changed, active)
    before, any_deleted = U0, U0
    for y in range(1, height + 1):
        groups, found = active[y], U0
        while groups != U0:
            group, stop, first, last = _words(groups, size, words)
            groups = _without(groups, stop)
            north = padded[y - 1, first - 1 : last + 1]
            here = padded[y, first - 1 : last + 1]
            south = padded[y + 1, first - 1 : last + 1]
            gone = deleted[y & 1, first:last]
            if phase == FIRST:
                _first_line(north, here, south, anchor[y, first:last], gone)
            else:
                _second_line(north, here, south, anchor[y, first:last], gone)
            found |= _groups_with_bits(gone, group, size)
        _apply(padded[y - 1], deleted[1 - (y & 1)], before, size, words)
        changed[phase, y] = found
        before = found
        any_deleted |= found
    _apply(padded[height], deleted[height & 1], before, size, words)
    return any_deleted != U0


@njit(inline="always")
def _end_line(north, here, south, anchor, ends, deleted):  # type: ignore[no-untyped-def]
    """End points (exactly one 8-neighbour): `deleted` if it lies E, NE, N or NW, `ends` otherwise."""
    for i in range(deleted.shape[0]):
        w = i + 1
        x3, c, x7 = north[w], here[w], south[w]
        x4 = (x3 << U1) | (north[i] >> U63)
        x2 = (x3 >> U1) | (north[i + 2] << U63)
        x5 = (c << U1) | (here[i] >> U63)
        x1 = (c >> U1) | (here[i + 2] << U63)
        x6 = (x7 << U1) | (south[i] >> U63)
        x8 = (x7 >> U1) | (south[i + 2] << U63)
        upper = x1 | x2 | x3 | x4
        one, two = x1, U0
        two |= one & x2
        one |= x2
        two |= one & x3
        one |= x3
        two |= one & x4
        one |= x4
        two |= one & x5
        one |= x5
        two |= one & x6
        one |= x6
        two |= one & x7
        one |= x7
        two |= one & x8
        one |= x8
        end = c & ~anchor[i] & one & ~two
        ends[i] = end & ~upper
        deleted[i] = end & upper


@njit(inline="always")
def _still_ends(north, here, south, ends, deleted):  # type: ignore[no-untyped-def]
    """The end points left over that still have their one neighbour."""
    for i in range(deleted.shape[0]):
        w = i + 1
        x3, c, x7 = north[w], here[w], south[w]
        upper = x3 | (x3 << U1) | (north[i] >> U63) | (x3 >> U1) | (north[i + 2] << U63)
        lower = x7 | (x7 << U1) | (south[i] >> U63) | (x7 >> U1) | (south[i + 2] << U63)
        sides = (c << U1) | (here[i] >> U63) | (c >> U1) | (here[i + 2] << U63)
        deleted[i] = ends[i] & c & (upper | lower | sides)


@njit(types.boolean(WORK, WORK, CHANGES, ROW_BITS, WORK, WORK), cache=True, nogil=True)
def remove_spurs(padded, anchor, changed, active, deleted, ends):  # type: ignore[no-untyped-def]
    """The paper's spur removal, one pixel per call, in place; True if a pixel was deleted.

    Of the end points at the start, first those go whose only neighbour lies E, NE, N or NW, then those of
    the others that still are end points. (Deleting all at once erases two-pixel components: it changed the
    topology of 263 of 300 random images.) Arguments as in `sub_iteration`; ends: (h + 2, words + 2), scratch.
    """
    height, words = padded.shape[0] - 2, padded.shape[1] - 2
    size = _group_size(padded)
    active_groups(changed, active)
    before, any_deleted, any_left = U0, U0, U0
    for y in range(1, height + 1):
        groups, found, left = active[y], U0, U0
        while groups != U0:
            group, stop, first, last = _words(groups, size, words)
            groups = _without(groups, stop)
            north = padded[y - 1, first - 1 : last + 1]
            here = padded[y, first - 1 : last + 1]
            south = padded[y + 1, first - 1 : last + 1]
            gone = deleted[y & 1, first:last]
            _end_line(north, here, south, anchor[y, first:last], ends[y, first:last], gone)
            found |= _groups_with_bits(gone, group, size)
            left |= _groups_with_bits(ends[y, first:last], group, size)
        _apply(padded[y - 1], deleted[1 - (y & 1)], before, size, words)
        changed[SPURS, y] = before = found
        active[y] = left  # done with as input; from here on the groups the second half looks at
        any_deleted |= found
        any_left |= left
    _apply(padded[height], deleted[height & 1], before, size, words)
    if any_left == U0:
        return any_deleted != U0

    before = U0
    for y in range(1, height + 1):
        groups, found = active[y], U0
        while groups != U0:
            group, stop, first, last = _words(groups, size, words)
            groups = _without(groups, stop)
            north = padded[y - 1, first - 1 : last + 1]
            here = padded[y, first - 1 : last + 1]
            south = padded[y + 1, first - 1 : last + 1]
            gone = deleted[y & 1, first:last]
            _still_ends(north, here, south, ends[y, first:last], gone)
            found |= _groups_with_bits(gone, group, size)
        _apply(padded[y - 1], deleted[1 - (y & 1)], before, size, words)
        changed[SPURS, y] |= found
        before = found
        any_deleted |= found
    _apply(padded[height], deleted[height & 1], before, size, words)
    return any_deleted != U0
