"""Flood fill on packed rows: what of a mask hangs together with a seed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import ROWS, U0, U1, U63, WORK
from layerfix.kernels import njit

if TYPE_CHECKING:
    from layerfix.bits import Rows


@njit
def _smear_up(seed, mask):  # type: ignore[no-untyped-def]  # numba types it
    """Spread set bits to higher ones as far as `mask` goes on."""
    for shift in (1, 2, 4, 8, 16, 32):
        seed |= mask & (seed << np.uint64(shift))
        mask &= mask << np.uint64(shift)
    return seed


@njit
def _smear_down(seed, mask):  # type: ignore[no-untyped-def]  # numba types it
    """Spread set bits to lower ones as far as `mask` goes on."""
    for shift in (1, 2, 4, 8, 16, 32):
        seed |= mask & (seed >> np.uint64(shift))
        mask &= mask >> np.uint64(shift)
    return seed


@njit
def _fill_row(line, mask, beside):  # type: ignore[no-untyped-def]  # numba types it
    """Take in what touches the row `beside`, then spread along the row. True if anything was added."""
    words = line.shape[0]
    changed = U0
    carry = U0
    for w in range(words):
        old = line[w]
        if old == mask[w]:  # nothing left to take in, as in most words
            carry = old >> U63
            continue
        near = beside[w] | (beside[w] << U1) | (beside[w] >> U1)
        if w:
            near |= beside[w - 1] >> U63
        if w + 1 < words:
            near |= beside[w + 1] << U63
        new = _smear_up((old | near | carry) & mask[w], mask[w])
        carry = new >> U63
        line[w] = new
        changed |= new ^ old
    carry = U0
    for w in range(words - 1, -1, -1):
        old = line[w]
        if old == mask[w]:
            carry = (old & U1) << U63
            continue
        new = _smear_down(old | (carry & mask[w]), mask[w])
        carry = (new & U1) << U63
        line[w] = new
        changed |= new ^ old
    return changed != U0


@njit(WORK(ROWS, ROWS), cache=True, nogil=True)
def _flood(seed, mask):  # type: ignore[no-untyped-def]  # numba types it
    height, words = mask.shape
    out = np.empty(mask.shape, np.uint64)
    for y in range(height):
        for w in range(words):
            out[y, w] = seed[y, w] & mask[y, w]
    nothing = np.zeros(words, np.uint64)
    again = height > 0
    while again:
        again = False
        for y in range(height):
            if _fill_row(out[y], mask[y], out[y - 1] if y else nothing):
                again = True
        for y in range(height - 1, -1, -1):
            if _fill_row(out[y], mask[y], out[y + 1] if y + 1 < height else nothing):
                again = True
    return out


def flood(seed: Rows, mask: Rows) -> Rows:
    """(H, words): the pixels of `mask` in the 8-connected components that hold a pixel of `seed`."""
    filled: Rows = _flood(seed, mask)
    return filled
