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
CHANGES = types.Array(types.uint64, 2, "C")


@njit(inline="always")
def _run(bits):  # type: ignore[no-untyped-def]
    """(first, past the last) of the lowest run of set bits of a word that is not 0."""
    first = lowest_bit(bits)
    rest = ~(bits >> np.uint64(first))
    return first, 64 if rest == U0 else min(first + lowest_bit(rest), 64)


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
def _groups_with_bits(line, first, last, size):  # type: ignore[no-untyped-def]
    """One bit per group of words, set if the group has any bit of `line[first:last]`."""
    found = U0
    if size == 1:
        for w in range(first, last):
            found |= np.uint64(line[w] != U0) << np.uint64(w - 1)
    else:
        for w in range(first, last):
            found |= np.uint64(line[w] != U0) << np.uint64((w - 1) // size)
    return found


@njit(inline="always")
def _apply(line, deleted, groups, size, words):  # type: ignore[no-untyped-def]
    """line &= ~deleted in the given groups of words."""
    while groups != U0:
        a, b = _run(groups)
        groups = _without(groups, b)
        for w in range(1 + a * size, min(1 + b * size, 1 + words)):
            line[w] &= ~deleted[w]


@njit(types.void(WORK, CHANGES), cache=True, nogil=True)
def start_changes(padded, changed):  # type: ignore[no-untyped-def]
    """Mark every group with a solid pixel as changed in every phase: each must look at it once."""
    size = _group_size(padded)
    changed[:] = U0
    for y in range(1, padded.shape[0] - 1):
        changed[:, y] = _groups_with_bits(padded[y], 1, padded.shape[1] - 1, size)


@njit(inline="always")
def _first_line(north, here, south, anchor, deleted, first, last):  # type: ignore[no-untyped-def]
    for w in range(first, last):
        x3, c, x7 = north[w], here[w], south[w]
        x4 = (x3 << U1) | (north[w - 1] >> U63)
        x2 = (x3 >> U1) | (north[w + 1] << U63)
        x5 = (c << U1) | (here[w - 1] >> U63)
        x1 = (c >> U1) | (here[w + 1] << U63)
        x6 = (x7 << U1) | (south[w - 1] >> U63)
        x8 = (x7 >> U1) | (south[w + 1] << U63)
        deleted[w] = c & ~anchor[w] & ~((x2 | x3 | ~x8) & x1) & _deletable(x1, x2, x3, x4, x5, x6, x7, x8)


@njit(inline="always")
def _second_line(north, here, south, anchor, deleted, first, last):  # type: ignore[no-untyped-def]
    for w in range(first, last):
        x3, c, x7 = north[w], here[w], south[w]
        x4 = (x3 << U1) | (north[w - 1] >> U63)
        x2 = (x3 >> U1) | (north[w + 1] << U63)
        x5 = (c << U1) | (here[w - 1] >> U63)
        x1 = (c >> U1) | (here[w + 1] << U63)
        x6 = (x7 << U1) | (south[w - 1] >> U63)
        x8 = (x7 >> U1) | (south[w + 1] << U63)
        deleted[w] = c & ~anchor[w] & ~((x6 | x7 | ~x4) & x5) & _deletable(x1, x2, x3, x4, x5, x6, x7, x8)


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
        line = deleted[y & 1]
        groups, found = active[y], U0
        while groups != U0:
            a, b = _run(groups)
            groups = _without(groups, b)
            first, last = 1 + a * size, min(1 + b * size, 1 + words)
            if phase == FIRST:
                _first_line(padded[y - 1], padded[y], padded[y + 1], anchor[y], line, first, last)
            else:
                _second_line(padded[y - 1], padded[y], padded[y + 1], anchor[y], line, first, last)
            found |= _groups_with_bits(line, first, last, size)
        _apply(padded[y - 1], deleted[1 - (y & 1)], before, size, words)
        changed[phase, y] = found
        before = found
        any_deleted |= found
    _apply(padded[height], deleted[height & 1], before, size, words)
    return any_deleted != U0


@njit(inline="always")
def _end_line(north, here, south, anchor, ends, deleted, first, last):  # type: ignore[no-untyped-def]
    """End points (exactly one 8-neighbour): `deleted` if it lies E, NE, N or NW, `ends` otherwise."""
    for w in range(first, last):
        x3, c, x7 = north[w], here[w], south[w]
        x4 = (x3 << U1) | (north[w - 1] >> U63)
        x2 = (x3 >> U1) | (north[w + 1] << U63)
        x5 = (c << U1) | (here[w - 1] >> U63)
        x1 = (c >> U1) | (here[w + 1] << U63)
        x6 = (x7 << U1) | (south[w - 1] >> U63)
        x8 = (x7 >> U1) | (south[w + 1] << U63)
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
        end = c & ~anchor[w] & one & ~two
        ends[w] = end & ~upper
        deleted[w] = end & upper


@njit(inline="always")
def _still_ends(north, here, south, ends, deleted, first, last):  # type: ignore[no-untyped-def]
    """The end points left over that still have their one neighbour."""
    for w in range(first, last):
        x3, c, x7 = north[w], here[w], south[w]
        upper = x3 | (x3 << U1) | (north[w - 1] >> U63) | (x3 >> U1) | (north[w + 1] << U63)
        lower = x7 | (x7 << U1) | (south[w - 1] >> U63) | (x7 >> U1) | (south[w + 1] << U63)
        sides = (c << U1) | (here[w - 1] >> U63) | (c >> U1) | (here[w + 1] << U63)
        deleted[w] = ends[w] & c & (upper | lower | sides)


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
        line = deleted[y & 1]
        groups, found, left = active[y], U0, U0
        while groups != U0:
            a, b = _run(groups)
            groups = _without(groups, b)
            first, last = 1 + a * size, min(1 + b * size, 1 + words)
            _end_line(padded[y - 1], padded[y], padded[y + 1], anchor[y], ends[y], line, first, last)
            found |= _groups_with_bits(line, first, last, size)
            left |= _groups_with_bits(ends[y], first, last, size)
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
        line = deleted[y & 1]
        groups, found = active[y], U0
        while groups != U0:
            a, b = _run(groups)
            groups = _without(groups, b)
            first, last = 1 + a * size, min(1 + b * size, 1 + words)
            _still_ends(padded[y - 1], padded[y], padded[y + 1], ends[y], line, first, last)
            found |= _groups_with_bits(line, first, last, size)
        _apply(padded[y - 1], deleted[1 - (y & 1)], before, size, words)
        changed[SPURS, y] |= found
        before = found
        any_deleted |= found
    _apply(padded[height], deleted[height & 1], before, size, words)
    return any_deleted != U0
