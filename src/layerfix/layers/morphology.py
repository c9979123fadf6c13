"""Erosion and dilation of packed rows by the disc F, exact to the pixel.

F is the set of offsets with (dx/rx)² + (dy/ry)² ≤ 1 (+1e-9); rx and ry differ when pixels are not square.
Outside the frame is empty.

Both operations spread the disc from boundary pixels only. A pixel of S ⊕ F outside S is reached from a pixel
of S with a 4-neighbour outside S: on a monotone path from a centre to that pixel |dx| and |dy| only shrink,
and F holds every offset with smaller |dx| and |dy|. Solid interiors and empty space so cost next to nothing.
The kernels work on `layerfix.layers.columns`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, U63, WORK
from layerfix.errors import InputError
from layerfix.kernels import njit
from layerfix.layers.columns import BLOCK, BOX, bounding_box, to_columns, to_rows, with_border

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

HALF_WIDTHS = types.Array(types.int64, 1, "C", readonly=True)


@lru_cache(maxsize=1000)
def disc_half_widths(rx_px: float, ry_px: float) -> NDArray[np.int64]:
    """Half the width of F in each row: entry |dy| is the largest |dx| in F; (floor(ry) + 1,) int64, read-only.

    Raises InputError unless both radii are above 0 and finite.
    """
    if not (math.isfinite(rx_px) and math.isfinite(ry_px) and rx_px > 0 and ry_px > 0):
        raise InputError(f"radius ({rx_px}, {ry_px}) px: both radii must be above 0")
    rows = np.arange(math.floor(ry_px * (1 + 1e-9)) + 1)
    room = np.maximum(1 + 1e-9 - (rows / ry_px) ** 2, 0)
    guess = np.floor(rx_px * np.sqrt(room)).astype(np.int64) + 1
    inside = (guess / rx_px) ** 2 + (rows / ry_px) ** 2 <= 1 + 1e-9
    half_widths = np.where(inside, guess, guess - 1)
    half_widths.flags.writeable = False
    return half_widths


@njit
def _or_shifted(grown, columns, w, first, stop, k):  # type: ignore[no-untyped-def]  # numba types it
    """grown |= column w shifted by k pixels to either side, rows first … stop - 1."""
    words, n = columns.shape[0], stop - first
    far, near = k >> 6, np.uint64(k & 63)
    rest = np.uint64(64) - near
    for side in (-1, 1):
        a, b = w + side * far, w + side * (far + 1)  # the words the k-th pixel to that side lies in
        if 0 <= a < words:
            here = columns[a, first:stop]
            if side < 0:
                for i in range(n):
                    grown[i] |= here[i] << near
            else:
                for i in range(n):
                    grown[i] |= here[i] >> near
        if near != U0 and 0 <= b < words:
            here = columns[b, first:stop]
            if side < 0:
                for i in range(n):
                    grown[i] |= here[i] >> rest
            else:
                for i in range(n):
                    grown[i] |= here[i] << rest


@njit
def _or_both_shifted(grown, west, here, east, k):  # type: ignore[no-untyped-def]  # numba types it
    """The same for 0 < k < 64 in one pass: three columns, and no tests."""
    near, rest = np.uint64(k), np.uint64(64 - k)
    for i in range(grown.shape[0]):
        grown[i] |= (here[i] << near) | (west[i] >> rest) | (here[i] >> near) | (east[i] << rest)


@njit
def _block_has_bits(columns, first, last, y):  # type: ignore[no-untyped-def]  # numba types it
    """True if columns first … last have a bit in the block that begins at row y."""
    seen = U0
    for w in range(first, last + 1):
        for i in range(y, min(y + BLOCK, columns.shape[1])):
            seen |= columns[w, i]
    return seen != U0


@njit
def _copy(target, words):  # type: ignore[no-untyped-def]  # numba types it
    """target[:] = words. (As a loop: numba's slice assignment takes a second to compile, for its errors.)"""
    for i in range(words.shape[0]):
        target[i] = words[i]


@njit
def _or_into(target, words):  # type: ignore[no-untyped-def]  # numba types it
    """target |= words. (Slices start at 0: with an offset in the index, numba's test for negative indices
    keeps LLVM from vectorising the loop.)"""
    for i in range(words.shape[0]):
        target[i] |= words[i]


@njit(types.void(WORK, WORK, HALF_WIDTHS), cache=True, nogil=True)
def spread(source, target, half_widths):  # type: ignore[no-untyped-def]  # numba types it
    """target |= the disc around every bit of `source`, clipped to the arrays; both (words, height).

    Per column of words and run of rows with bits near it: the rows are grown sideways, one pixel at a time
    from the disc's top to its middle, and ORed into the rows at that distance above and below.
    """
    words, height = source.shape
    top = half_widths.shape[0] - 1
    reach = (half_widths[0] + 63) >> 6
    grown = np.empty(height, np.uint64)
    for w in range(words):
        west, east = max(w - reach, 0), min(w + reach, words - 1)
        start = 0
        while start < height:
            if not _block_has_bits(source, west, east, start):
                start += BLOCK
                continue
            stop = start + BLOCK
            quiet = 0
            while stop + quiet < height and quiet <= 2 * BLOCK:  # bridge small gaps: a run has a fixed cost
                if _block_has_bits(source, west, east, stop + quiet):
                    stop += quiet + BLOCK
                    quiet = 0
                else:
                    quiet += BLOCK
            stop = min(stop, height)
            run = grown[: stop - start]
            _copy(run, source[w, start:stop])
            width = 0
            for dy in range(top, -1, -1):
                while width < half_widths[dy]:
                    width += 1
                    if width < 64 and 0 < w < words - 1:
                        _or_both_shifted(
                            run, source[w - 1, start:stop], source[w, start:stop], source[w + 1, start:stop], width
                        )
                    else:
                        _or_shifted(run, source, w, start, stop, width)
                above = max(start - dy, 0)
                _or_into(target[w, above : max(stop - dy, 0)], run[above - start + dy :])
                if dy > 0:
                    below = min(stop + dy, height)
                    if start + dy < below:
                        _or_into(target[w, start + dy : below], run[: below - start - dy])
            start = stop


@njit(types.void(WORK, types.boolean, WORK), cache=True, nogil=True)
def boundary(columns, of_void, out):  # type: ignore[no-untyped-def]  # numba types it
    """Solid pixels with a 4-neighbour in the void, or (`of_void`) void pixels with one in the solid.

    columns, out: (words, height) with an empty border; `out` is written everywhere.
    """
    words, height = columns.shape
    out[0] = U0
    out[words - 1] = U0
    if of_void:  # the border words touch the solid too
        for y in range(height):
            out[0, y] = columns[1, y] << U63
            out[words - 1, y] = columns[words - 2, y] >> U63
    for w in range(1, words - 1):
        west, here, east, line = columns[w - 1], columns[w], columns[w + 1], out[w]
        for i in range(height - 2):
            c = here[i + 1]
            left = (c << U1) | (west[i + 1] >> U63)
            right = (c >> U1) | (east[i + 1] << U63)
            if of_void:
                line[i + 1] = ~c & (left | right | here[i] | here[i + 2])
            else:
                line[i + 1] = c & ~(left & right & here[i] & here[i + 2])
        line[0] = here[1] if of_void else U0
        line[height - 1] = here[height - 2] if of_void else U0


@njit(types.void(WORK, HALF_WIDTHS, WORK, WORK), cache=True, nogil=True)
def erode_columns(columns, half_widths, out, scratch):  # type: ignore[no-untyped-def]  # numba types it
    """out = columns ⊖ F: the pixels whose disc meets no void pixel."""
    boundary(columns, True, scratch)
    out[:] = U0
    spread(scratch, out, half_widths)
    for w in range(columns.shape[0]):
        solid, line = columns[w], out[w]
        for i in range(columns.shape[1]):
            line[i] = solid[i] & ~line[i]


@njit(types.void(WORK, HALF_WIDTHS, WORK, WORK), cache=True, nogil=True)
def dilate_columns(columns, half_widths, out, scratch):  # type: ignore[no-untyped-def]  # numba types it
    """out = columns ⊕ F; the border must be wide enough to hold it (`with_border`)."""
    boundary(columns, False, scratch)
    for w in range(columns.shape[0]):
        _copy(out[w], columns[w])
    spread(scratch, out, half_widths)


@njit(BOX(ROWS, HALF_WIDTHS), cache=True, nogil=True)
def working_box(rows, half_widths):  # type: ignore[no-untyped-def]  # numba types it
    """The box around the solid with room for a dilation; zeros if the layer is empty."""
    box = bounding_box(rows)
    return box if box[1] == 0 else with_border(box, half_widths[0], half_widths.shape[0] - 1)


def dilate(rows: Rows, width: int, radius_px: tuple[float, float]) -> Rows:
    """(H, words) → (H, words): S ⊕ F, clipped to the frame."""
    out, disc = np.zeros_like(rows), disc_half_widths(*radius_px)
    outer = working_box(rows, disc)
    if outer[1]:
        columns = to_columns(rows, outer)
        dilated = np.empty_like(columns)
        dilate_columns(columns, disc, dilated, np.empty_like(columns))
        to_rows(dilated, outer, width, out)
    return out


def erode(rows: Rows, width: int, radius_px: tuple[float, float]) -> Rows:
    """(H, words) → (H, words): S ⊖ F, with the outside of the frame counted as void."""
    out, disc = np.zeros_like(rows), disc_half_widths(*radius_px)
    outer = working_box(rows, disc)
    if outer[1]:
        columns = to_columns(rows, outer)
        eroded = np.empty_like(columns)
        erode_columns(columns, disc, eroded, np.empty_like(columns))
        to_rows(eroded, outer, width, out)
    return out


def opened(rows: Rows, width: int, radius_px: tuple[float, float]) -> Rows:
    """(H, words) → (H, words): S ∘ F, what an uncorrected print keeps (paper, equation 2)."""
    return dilate(erode(rows, width, radius_px), width, radius_px)
