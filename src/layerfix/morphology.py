"""Erosion and dilation of packed rows by the disc F, exact to the pixel.

F is the set of offsets with (dx/rx)² + (dy/ry)² ≤ 1 (+1e-9); rx and ry differ when pixels are not square.
Outside the frame is empty. Both operations work from the boundary only: a pixel of S ⊕ F outside S is
reached from a pixel of S with a 4-neighbour outside S, because on a monotone path from a centre to that
pixel |dx| and |dy| only shrink, and F holds every offset with smaller |dx| and |dy|. Solid interiors and
empty space so cost one load a word.

Working arrays are a layer's bounding box with one empty row above and below and one empty word left and
right ("padded"), so that no neighbour needs a test for the border.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit, types

from layerfix.bits import ROWS, U0, U1, U63, WORK
from layerfix.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

# Runs of words closer than this are grown as one: a pass over a few empty words costs less than a new run.
MAX_GAP = 32
HALF_WIDTHS = types.Array(types.int64, 1, "C", readonly=True)


def disc_half_widths(rx_px: float, ry_px: float) -> NDArray[np.int64]:
    """Half the width of F in each row: entry |dy| is the largest |dx| in F; (floor(ry) + 1,) int64."""
    if not (math.isfinite(rx_px) and math.isfinite(ry_px) and rx_px > 0 and ry_px > 0):
        raise InputError(f"radius ({rx_px}, {ry_px}) px: both radii must be above 0")
    rows = np.arange(math.floor(ry_px * (1 + 1e-9)) + 1)
    room = np.maximum(1 + 1e-9 - (rows / ry_px) ** 2, 0)
    guess = np.floor(rx_px * np.sqrt(room)).astype(np.int64) + 1
    inside = (guess / rx_px) ** 2 + (rows / ry_px) ** 2 <= 1 + 1e-9
    return np.where(inside, guess, guess - 1)


@njit(inline="always")
def _or_into(line, words):  # type: ignore[no-untyped-def]
    """line |= words. (Slices start at 0: with an offset in the index numba's test for negative indices
    keeps LLVM from vectorising the loop.)"""
    for i in range(words.shape[0]):
        line[i] |= words[i]


@njit(types.void(WORK, WORK, types.int64, types.int64, HALF_WIDTHS), cache=True, nogil=True)
def spread(source, target, row_offset, word_offset, half_widths):  # type: ignore[no-untyped-def]
    """OR the disc around every bit of `source` into `target`, clipped to `target`.

    source's row y, word w lies on target's row y + row_offset, word w + word_offset. Each run of words is
    grown sideways one pixel at a time, from the disc's top row to its middle, and ORed into the two rows
    at that distance: (rx + 2·ry) passes over the run.
    """
    height, words = source.shape
    top = half_widths.shape[0] - 1
    reach = (half_widths[0] + 63) >> 6
    grown = np.empty(words + 2 * reach + 2, np.uint64)
    other = np.empty(words + 2 * reach + 2, np.uint64)
    for y in range(height):
        start = 0
        while start < words:
            if source[y, start] == U0:
                start += 1
                continue
            stop = start + 1
            for w in range(start + 1, words):
                if source[y, w] != U0:
                    if w - stop > MAX_GAP:
                        break
                    stop = w + 1
            length = stop - start + 2 * reach  # words 1 … length of the buffers; 0 and length + 1 stay empty
            grown[: length + 2] = U0
            other[: length + 2] = U0
            grown[1 + reach : 1 + reach + stop - start] = source[y, start:stop]
            first = start - reach + word_offset  # target word of buffer word 1
            low = max(0, -first)
            high = min(length, target.shape[1] - first)
            width = 0
            for dy in range(top, -1, -1):
                while width < half_widths[dy]:
                    for i in range(length):
                        v = grown[i + 1]
                        other[i + 1] = v | (v << U1) | (grown[i] >> U63) | (v >> U1) | (grown[i + 2] << U63)
                    grown, other = other, grown
                    width += 1
                above = y - dy + row_offset
                if 0 <= above < target.shape[0]:
                    _or_into(target[above, first + low : first + high], grown[1 + low : 1 + high])
                below = y + dy + row_offset
                if dy > 0 and 0 <= below < target.shape[0]:
                    _or_into(target[below, first + low : first + high], grown[1 + low : 1 + high])
            start = stop


@njit(types.void(WORK, types.boolean, WORK), cache=True, nogil=True)
def boundary(padded, of_void, out):  # type: ignore[no-untyped-def]
    """Solid pixels with a 4-neighbour in the void, or (`of_void`) void pixels with one in the solid.

    padded, out: (h + 2, words + 2); out is written everywhere.
    """
    height, words = padded.shape
    out[0] = U0
    out[height - 1] = U0
    for y in range(height):
        here = padded[y]
        up = padded[max(y - 1, 0)]
        down = padded[min(y + 1, height - 1)]
        line = out[y]
        for i in range(words - 2):
            w = i + 1
            c = here[w]
            west, east = (c << U1) | (here[i] >> U63), (c >> U1) | (here[i + 2] << U63)
            if of_void:
                line[w] = ~c & (west | east | up[w] | down[w])
            else:
                line[w] = c & ~(west & east & up[w] & down[w])
        line[0] = (here[1] << U63) if of_void else U0
        line[words - 1] = (here[words - 2] >> U63) if of_void else U0


@njit(types.void(WORK, HALF_WIDTHS, WORK, WORK), cache=True, nogil=True)
def erode_padded(padded, half_widths, out, scratch):  # type: ignore[no-untyped-def]
    """out = padded ⊖ F: the pixels whose disc meets no void pixel. All arrays (h + 2, words + 2)."""
    boundary(padded, True, scratch)
    out[:] = U0
    spread(scratch, out, 0, 0, half_widths)
    for y in range(padded.shape[0]):
        for w in range(padded.shape[1]):
            out[y, w] = padded[y, w] & ~out[y, w]


@njit(types.UniTuple(types.int64, 4)(ROWS), cache=True, nogil=True)
def bounding_box(rows):  # type: ignore[no-untyped-def]
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


@njit(WORK(ROWS, types.UniTuple(types.int64, 4)), cache=True, nogil=True)
def padded_crop(rows, box):  # type: ignore[no-untyped-def]
    """The box of `bounding_box` with an empty row above and below and an empty word left and right."""
    y0, y1, w0, w1 = box
    out = np.empty((y1 - y0 + 2, w1 - w0 + 2), np.uint64)
    out[0] = U0
    out[y1 - y0 + 1] = U0
    for y in range(y0, y1):
        line = out[y - y0 + 1]
        line[0] = U0
        for w in range(w0, w1):
            line[w - w0 + 1] = rows[y, w]
        line[w1 - w0 + 1] = U0
    return out


@njit(types.void(WORK, types.UniTuple(types.int64, 4), WORK), cache=True, nogil=True)
def paste(padded, box, target):  # type: ignore[no-untyped-def]
    """OR a padded crop back into the frame it was cut from."""
    y0, y1, w0, w1 = box
    for y in range(y0, y1):
        for w in range(w0, w1):
            target[y, w] |= padded[y - y0 + 1, w - w0 + 1]


@njit(types.void(WORK, types.int64), cache=True, nogil=True)
def clear_past(rows, width):  # type: ignore[no-untyped-def]
    """Clear the bits at or past `width` in the last word of each row."""
    if width & 63:
        keep = (U1 << np.uint64(width & 63)) - U1
        last = rows.shape[1] - 1
        for y in range(rows.shape[0]):
            rows[y, last] &= keep


@njit(
    types.void(WORK, types.UniTuple(types.int64, 4), HALF_WIDTHS, types.int64, WORK, WORK),
    cache=True,
    nogil=True,
)
def dilate_into(padded, box, half_widths, width, target, scratch):  # type: ignore[no-untyped-def]
    """target |= padded ⊕ F, where `padded` was cut at `box` from a frame `width` pixels wide."""
    boundary(padded, False, scratch)
    paste(padded, box, target)
    spread(scratch, target, box[0] - 1, box[2] - 1, half_widths)
    clear_past(target, width)


def dilate(rows: Rows, width: int, radius_px: tuple[float, float]) -> Rows:
    """(H, words) → (H, words): S ⊕ F, clipped to the frame."""
    out = np.zeros_like(rows)
    box = bounding_box(rows)
    if box[1]:
        padded = padded_crop(rows, box)
        dilate_into(padded, box, disc_half_widths(*radius_px), width, out, np.empty_like(padded))
    return out


def erode(rows: Rows, radius_px: tuple[float, float]) -> Rows:
    """(H, words) → (H, words): S ⊖ F, with the outside of the frame counted as void."""
    out = np.zeros_like(rows)
    box = bounding_box(rows)
    if box[1]:
        padded = padded_crop(rows, box)
        eroded = np.empty_like(padded)
        erode_padded(padded, disc_half_widths(*radius_px), eroded, np.empty_like(padded))
        paste(eroded, box, out)
    return out


def opened(rows: Rows, width: int, radius_px: tuple[float, float]) -> Rows:
    """(H, words) → (H, words): S ∘ F, what an uncorrected print keeps (paper, equation 2)."""
    return dilate(erode(rows, radius_px), width, radius_px)
