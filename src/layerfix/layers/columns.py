"""The working layout of the field algorithms: a layer's bounding box as columns of words.

``columns[w, y]`` holds 64 pixels of row y, and ``columns[w]`` is one column of words, contiguous from top to
bottom. A kernel's inner loop runs down a column: north, here and south are one array read at i, i + 1 and
i + 2, west and east are the columns beside it. However narrow the layer, the loops are as long as it is tall,
so they vectorise without a rest (with row-major loops, 40 % of a 1,417 px wide layer's time was overhead).

Around the box lies an empty border, wide enough for whatever will be written there (`reach`) and at least one
word and one row, so that no neighbour needs a test. Rows come in blocks of BLOCK.
"""

from __future__ import annotations

from threading import local
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, WORK
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK = 8  # rows; the unit in which kernels note what changed or is empty
BOX = types.UniTuple(types.int64, 4)


@njit(BOX(ROWS), cache=True, nogil=True)
def bounding_box(rows):  # type: ignore[no-untyped-def]  # numba types it
    """(first row, past the last row, first word, past the last word) of what is solid; zeros if empty."""
    height, words = rows.shape
    y0, y1, w0, w1 = height, 0, words, 0
    for y in range(height):
        line = rows[y]
        seen = U0
        for w in range(words):
            seen |= line[w]
        if seen == U0:
            continue
        y0 = min(y0, y)
        y1 = y + 1
        w = 0
        while w < w0 and line[w] == U0:
            w += 1
        w0 = min(w0, w)
        w = words
        while w > w1 and line[w - 1] == U0:
            w -= 1
        w1 = max(w1, w)
    if y1 == 0:
        return 0, 0, 0, 0
    return y0, y1, w0, w1


@njit(BOX(BOX, types.int64, types.int64), cache=True, nogil=True)
def with_border(box, reach_x, reach_y):  # type: ignore[no-untyped-def]  # numba types it
    """The box grown by `reach_x` px (in whole words) and `reach_y` rows, and at least one word and row;
    it may begin before the frame and end after it."""
    y0, y1, w0, w1 = box
    words = (reach_x + 63) // 64 + 1
    rows = reach_y + 1
    whole = (y1 - y0 + 2 * rows - 2 + BLOCK - 1) // BLOCK * BLOCK + 2  # blocks between an outer row each
    return y0 - rows, y0 - rows + whole, w0 - words, w1 + words


class Room:
    """Working memory that each thread keeps from one layer to the next: 20 MB of fresh memory for a 12K layer cost
    9 ms, half as much as its correction."""

    def __init__(self) -> None:
        self._local = local()

    def __reduce__(self) -> tuple[type[Room], tuple[()]]:
        """A pickled one is empty."""
        return Room, ()

    def columns(self, outer: tuple[int, int, int, int], count: int) -> NDArray[np.uint64]:
        """(count, words, height): columns of a box, with anything in them; they are good until the next call."""
        y0, y1, w0, w1 = outer
        words, height = w1 - w0, y1 - y0
        needed = count * words * height
        kept: NDArray[np.uint64] = getattr(self._local, "kept", np.empty(0, np.uint64))
        if len(kept) < needed:
            self._local.kept = kept = np.empty(needed + needed // 4, np.uint64)
        return kept[:needed].reshape(count, words, height)

    def zeros(self, needed: int) -> NDArray[np.uint64]:
        """(n,) uint64, at least so many, all 0, to be given back by `emptied`, all 0 again."""
        kept: NDArray[np.uint64] | None = getattr(self._local, "zeros", None)
        self._local.zeros = None  # whoever has it may break off
        if kept is None or len(kept) < needed:
            kept = np.zeros(needed + needed // 4, np.uint64)
        return kept

    def emptied(self, zeros: NDArray[np.uint64]) -> None:
        """Take back what `zeros` gave."""
        self._local.zeros = zeros


@njit(WORK(ROWS, BOX), cache=True, nogil=True)
def to_columns(rows, outer):  # type: ignore[no-untyped-def]  # numba types it
    """What lies in `outer` as columns; empty where that is outside the frame."""
    y0, y1, w0, w1 = outer
    out = np.empty((w1 - w0, y1 - y0), np.uint64)
    fill_columns(rows, outer, out)
    return out


@njit(types.void(ROWS, BOX, WORK), cache=True, nogil=True)
def fill_columns(rows, outer, out):  # type: ignore[no-untyped-def]  # numba types it
    """The same into an array that is there, written everywhere."""
    y0, y1, w0, w1 = outer
    first, stop = max(w0, 0), min(w1, rows.shape[1])
    for w in range(w0, w1):
        inside = first <= w < stop
        for y in range(y0, y1):
            if not (inside and 0 <= y < rows.shape[0]):
                out[w - w0, y - y0] = U0
    for group in range(first, stop, 8):  # eight words are a cache line
        for y in range(max(y0, 0), min(y1, rows.shape[0])):
            for w in range(group, min(group + 8, stop)):
                out[w - w0, y - y0] = rows[y, w]


@njit(types.void(WORK, BOX, types.int64, WORK), cache=True, nogil=True)
def to_rows(columns, outer, width, rows):  # type: ignore[no-untyped-def]  # numba types it
    """OR columns back into a frame `width` pixels wide, leaving out what lies beyond it."""
    y0, y1, w0, w1 = outer
    first, stop = max(w0, 0), min(w1, rows.shape[1])
    top, bottom = max(y0, 0), min(y1, rows.shape[0])
    for group in range(first, stop, 8):
        for y in range(top, bottom, BLOCK):
            for w in range(group, min(group + 8, stop)):
                part = columns[w - w0, y - y0 : min(y + BLOCK, bottom) - y0]
                for i in range(part.shape[0]):
                    if part[i] != U0:
                        rows[y + i, w] |= part[i]
    if width & 63:
        keep = (U1 << np.uint64(width & 63)) - U1
        last = rows.shape[1] - 1
        for y in range(max(y0, 0), min(y1, rows.shape[0])):
            rows[y, last] &= keep
