"""Layers as run lengths, small enough for a page: docs/report.md has the format.

A layer is cut to the frame that all of them need, reduced if it is larger than a screen can use, and written as
the lengths of its runs, empty and solid in turn, as varints; layers are deflated in chunks. On real parts that is
half the size of packed rows, deflated, and a quarter of PNG.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, lowest_bit
from layerfix.kernels import njit

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from layerfix.bits import Rows

    Spans = NDArray[np.int32]

CHUNK_LAYERS = 32
LEVEL = 9
SPANS = types.Array(types.int32, 2, "C")


@njit(types.int64(ROWS, SPANS), cache=True, nogil=True)
def _list_spans(rows, out):  # type: ignore[no-untyped-def]  # numba types it
    """Row, first column, and the one past the last, of every run; how many. Written as far as `out` reaches."""
    n = 0
    for y in range(rows.shape[0]):
        inside = False
        for w in range(rows.shape[1]):
            word = rows[y, w]
            # A bit where a run begins or ends.
            turns = word ^ ((word << U1) | (U1 if inside else U0))
            while turns != U0:
                x = 64 * w + lowest_bit(turns)
                turns &= turns - U1
                if inside:
                    if n < out.shape[0]:
                        out[n, 2] = x
                    n += 1
                elif n < out.shape[0]:
                    out[n, 0], out[n, 1] = y, x
                inside = not inside
        if inside:
            if n < out.shape[0]:
                out[n, 2] = 64 * rows.shape[1]
            n += 1
    return n


def spans_of(rows: Rows) -> Spans:
    """(n, 3) int32: row, first column, past the last column, of each run of packed rows, from the top."""
    out = np.empty((_list_spans(rows, np.empty((0, 3), np.int32)), 3), np.int32)
    _list_spans(rows, out)
    return out


@dataclass(frozen=True)
class Window:
    """What of the frame is shown: its corner and size in pixels, and how many of them become one on each axis."""

    left: int
    top: int
    width: int
    height: int
    step: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) that are stored."""
        return -(-self.height // self.step), -(-self.width // self.step)


def window_of(layers: Iterable[Spans], air_px: int, most_px: int) -> Window:
    """The window that holds all layers with some air, reduced to at most `most_px` pixels."""
    boxes = [(s[:, 1].min(), s[0, 0], s[:, 2].max(), s[-1, 0] + 1) for s in layers if len(s)] or [(0, 0, 1, 1)]
    low, high = np.min(boxes, axis=0), np.max(boxes, axis=0)
    left, top = int(low[0]) - air_px, int(low[1]) - air_px
    width, height = int(high[2]) + air_px - left, int(high[3]) + air_px - top
    step = 1
    while -(-width // step) * -(-height // step) > most_px:
        step += 1
    return Window(left, top, width, height, step)


def cut(spans: Spans, window: Window) -> NDArray[np.int64]:
    """(m, 2) first and past-the-last of each run of the layer as one line of stored pixels, row after row.

    A stored pixel is solid if any of those that it stands for is: nothing thin disappears.
    """
    _, columns = window.shape
    rows = (spans[:, 0].astype(np.int64) - window.top) // window.step
    first = (spans[:, 1].astype(np.int64) - window.left) // window.step
    past = (spans[:, 2].astype(np.int64) - window.left - 1) // window.step + 1
    runs = np.column_stack([rows * columns + first, rows * columns + past])
    if len(runs) == 0:
        return runs
    if window.step > 1:
        runs = runs[np.argsort(runs[:, 0], kind="stable")]
    reach = np.maximum.accumulate(runs[:, 1])
    begins = np.concatenate([[True], runs[1:, 0] > reach[:-1]])
    ends = np.concatenate([np.flatnonzero(begins)[1:] - 1, [len(runs) - 1]])
    return np.column_stack([runs[begins, 0], reach[ends]])


def varints(values: NDArray[np.int64]) -> bytes:
    """LEB128 of numbers from 0: seven bits a byte, the lowest first."""
    values = np.asarray(values, np.uint64)
    size = np.ones(len(values), np.int64)
    for bits in (7, 14, 21, 28):
        size += values >= (1 << bits)
    out = np.empty((len(values), 5), np.uint8)
    for k in range(5):
        out[:, k] = ((values >> np.uint64(7 * k)) & np.uint64(127)) | np.where(size > k + 1, 128, 0).astype(np.uint64)
    return out[np.arange(5) < size[:, None]].tobytes()


def deflated(data: bytes) -> bytes:
    """Raw deflate, as a browser's DecompressionStream takes it."""
    packer = zlib.compressobj(LEVEL, zlib.DEFLATED, -15)
    return packer.compress(data) + packer.flush()


def encoded(layers: Sequence[Spans], window: Window) -> tuple[bytes, list[int]]:
    """(chunks of CHUNK_LAYERS layers one after the other, where each begins and where the last ends)."""
    chunks: list[bytes] = []
    offsets = [0]
    for start in range(0, len(layers), CHUNK_LAYERS):
        lines = [cut(spans, window) for spans in layers[start : start + CHUNK_LAYERS]]
        lengths = [np.diff(line.ravel(), prepend=0) for line in lines]
        chunks.append(deflated(b"".join(varints(np.concatenate([[len(run)], run])) for run in lengths)))
        offsets.append(offsets[-1] + len(chunks[-1]))
    return b"".join(chunks), offsets
