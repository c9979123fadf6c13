"""What F is erosion, opening and drawing of, on `layerfix.layers.columns`: the method's steps but for the thinning.

A = (S ⊖ F) ⊕ block, so that A ⊕ G = S ∘ F. Of an F by size, a pixel of a skeletal path M̂ \\ A is drawn only if F
around it holds a pixel of S that S ∘ F misses: what the tool draws anyway is left as it is. (Slanted walls of half a
pixel more than F, and slots a pixel wide between thick bodies that touch in corners, have paths and need none.)
M̂ stays whole inside the result, which is S ∘ F ∪ ((drawn paths) ⊕ F). A small piece of a mesh's section that the
raster joins with another, and whose middle would not be printed, gets an F of its own.
"""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ALL, ROWS, U0, U1, U63, WORK, lowest_bit
from layerfix.kernels import njit
from layerfix.layers.columns import BOX, bounding_box, with_border
from layerfix.layers.morphology import HALF_WIDTHS, dilate_columns, erode_columns, spread

PLACES = types.Array(types.int64, 2, "C")


@njit(BOX(ROWS, types.int64, types.int64), cache=True, nogil=True)
def box_with_reach(rows, reach_x, reach_y):  # type: ignore[no-untyped-def]  # numba types it
    """The box around the solid with room for that; zeros if the layer is empty."""
    box = bounding_box(rows)
    return box if box[1] == 0 else with_border(box, reach_x, reach_y)


@njit(types.void(WORK, types.int64, types.int64, WORK), cache=True, nogil=True)
def erode_by_block(columns, bx, by, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = the pixels of `columns` whose neighbours east (bx), south (by) and south-east (both) are set, too."""
    words, height = columns.shape
    out[0] = U0
    out[words - 1] = U0
    for w in range(1, words - 1):
        here, east, line = columns[w], columns[w + 1], out[w]
        line[height - 1] = U0
        for i in range(height - 1):
            c, d = here[i], here[i + 1]
            if bx:
                c &= (c >> U1) | (east[i] << U63)
                d &= (d >> U1) | (east[i + 1] << U63)
            line[i] = c & d if by else c


@njit(types.void(WORK, types.int64, types.int64, WORK), cache=True, nogil=True)
def dilate_by_block(columns, bx, by, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = `columns` and its pixels moved east (bx), south (by) and south-east (both)."""
    words, height = columns.shape
    out[0] = U0
    for w in range(1, words):
        west, here, line = columns[w - 1], columns[w], out[w]
        line[0] = U0
        for i in range(height - 1):
            c, d = here[i + 1], here[i]
            if bx:
                c |= (c << U1) | (west[i + 1] >> U63)
                d |= (d << U1) | (west[i] >> U63)
            line[i + 1] = c | d if by else c


@njit(types.void(WORK, HALF_WIDTHS, types.int64, types.int64, WORK, WORK), cache=True, nogil=True)
def anchor_columns(columns, half_widths, bx, by, out, scratch):  # type: ignore[no-untyped-def]  # numba types it
    """out = A, the erosion by F and what the block sweeps from there."""
    erode_columns(columns, half_widths, out, scratch)
    if bx or by:
        erode_by_block(out, bx, by, scratch)
        dilate_by_block(scratch, bx, by, out)


@njit
def _any_lost(solid, kept, y, first, last):  # type: ignore[no-untyped-def]  # numba types it
    """Whether row y has a pixel of `solid` that is not in `kept` among first … last."""
    a, b = max(first, 0), min(last, 64 * solid.shape[0] - 1)
    for w in range(a >> 6, (b >> 6) + 1):
        word = solid[w, y] & ~kept[w, y]
        if w == a >> 6:
            word &= ALL << np.uint64(a & 63)
        if w == b >> 6:
            word &= ALL >> np.uint64(63 - (b & 63))
        if word != U0:
            return True
    return False


@njit
def _holds_lost(solid, kept, y, x, half_widths, bx, by):  # type: ignore[no-untyped-def]  # numba types it
    """Whether F around (y, x) holds a pixel of `solid` that is not in `kept`; the middle rows are looked at first."""
    for k in range(half_widths.shape[0]):
        first, last = x - half_widths[k], x + half_widths[k] + bx
        if y - k >= 0 and _any_lost(solid, kept, y - k, first, last):
            return True
        if y + by + k < solid.shape[1] and _any_lost(solid, kept, y + by + k, first, last):
            return True
    return False


@njit(types.boolean(WORK, WORK, WORK, WORK, HALF_WIDTHS, types.int64, types.int64, types.boolean, WORK),
      cache=True, nogil=True)  # fmt: skip
def find_paths(solid, skeleton, anchor, opened, half_widths, bx, by, where_lost, paths):  # type: ignore[no-untyped-def]  # numba types it
    """paths = the pixels of M̂ \\ A to draw (all of them unless `where_lost`); True if there are any."""
    seen = U0
    for w in range(solid.shape[0]):
        for y in range(solid.shape[1]):
            path = skeleton[w, y] & ~anchor[w, y]
            if where_lost and path != U0:
                left = path & ~(solid[w, y] & ~opened[w, y])  # a pixel that is lost itself needs no look around
                while left != U0:
                    bit = left & (U0 - left)
                    left ^= bit
                    if not _holds_lost(solid, opened, y, w * 64 + lowest_bit(bit), half_widths, bx, by):
                        path ^= bit
            paths[w, y] = path
            seen |= path
    return seen != U0


@njit(types.void(WORK, WORK, HALF_WIDTHS, types.int64, types.int64, WORK), cache=True, nogil=True)
def draw_paths(paths, target, half_widths, bx, by, scratch):  # type: ignore[no-untyped-def]  # numba types it
    """target |= paths ⊕ F; the border must be wide enough to hold it."""
    if bx or by:
        dilate_by_block(paths, bx, by, scratch)
        for w in range(target.shape[0]):
            for y in range(target.shape[1]):
                target[w, y] |= scratch[w, y]
        spread(scratch, target, half_widths)
    else:
        for w in range(target.shape[0]):
            for y in range(target.shape[1]):
                target[w, y] |= paths[w, y]
        spread(paths, target, half_widths)


@njit(types.int64(WORK, PLACES, types.int64, types.int64, WORK), cache=True, nogil=True)
def missing_places(printed, places, top, left, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = those of some pixels (row, column of the frame; the columns begin at top, left) that are not printed.

    Returns how many there are.
    """
    out[:] = U0
    count = 0
    for k in range(places.shape[0]):
        y, x = places[k, 0] - top, places[k, 1] - left
        if 0 < y < printed.shape[1] - 1 and 64 <= x < 64 * (printed.shape[0] - 1):
            bit = U1 << np.uint64(x & 63)
            if printed[x >> 6, y] & bit == U0 and out[x >> 6, y] & bit == U0:
                out[x >> 6, y] |= bit
                count += 1
    return count


@njit(types.void(WORK, HALF_WIDTHS, WORK, WORK), cache=True, nogil=True)
def open_columns(anchor, half_widths, out, scratch):  # type: ignore[no-untyped-def]  # numba types it
    """out = A ⊕ G = S ∘ F."""
    dilate_columns(anchor, half_widths, out, scratch)
