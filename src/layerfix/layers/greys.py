"""Layers with greys (anti-aliased): what of them is solid, and how a correction is drawn into them.

A pixel is solid from `threshold` on. A stroke so thin that it gets there only in places, or never, is a feature all
the same, by its coverage. What is drawn has at least the coverage of F's disc; every other pixel keeps its value, and
in mode "add_only" none gets darker.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1, U63, WORK, lowest_bit, words_for
from layerfix.kernels import njit
from layerfix.layers.flood import flood
from layerfix.layers.grey_image import IMAGE, TARGET, GreyImage, Greys, bands_of
from layerfix.layers.morphology import HALF_WIDTHS, dilate, disc_half_widths, opened
from layerfix.layers.neighbours import around, bit_at, is_simple

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from layerfix.bits import Rows

    Values = NDArray[np.uint8]

U8 = np.uint8(1)
BROAD_PX = 5.0  # what is faint and so wide is no stroke, not even where strokes cross
PATTERN_PX = 16  # dim pixels: fewer are no pattern
SUBSTEPS = 64  # columns a pixel is cut into for its coverage; each is exact in y


@njit(types.void(IMAGE, types.uint8, WORK), cache=True, nogil=True)
def _pack_from(image, threshold, rows):  # type: ignore[no-untyped-def]  # numba types it
    height, width = image.shape
    for y in range(height):
        for w in range(rows.shape[1]):
            part = image[y, w * 64 : min(w * 64 + 64, width)]
            word = U0
            for i in range(part.shape[0]):
                word |= np.uint64(part[i] >= threshold) << np.uint64(i)
            rows[y, w] = word


def pack_from(image: Values, threshold: int) -> Rows:
    """(H, W) uint8 → (H, words): solid where the value is at least `threshold`, 1 … 255."""
    rows = np.empty((image.shape[0], words_for(image.shape[1])), np.uint64)
    _pack_from(np.ascontiguousarray(image), threshold, rows)
    return rows


@njit(WORK(IMAGE, ROWS), cache=True, nogil=True)
def _ridges(image, dim):  # type: ignore[no-untyped-def]  # numba types it
    """Of the pixels in `dim`, those brighter than both neighbours above and below, or to both sides: the crest of a
    stroke. Of two equal ones side by side it is the lower (right) one."""
    height, width = image.shape
    out = np.zeros(dim.shape, np.uint64)
    for y in range(height):
        for w in range(dim.shape[1]):
            word = dim[y, w]
            while word != U0:
                x = w * 64 + lowest_bit(word)
                word &= word - U1
                g = image[y, x]
                for dy, dx in ((1, 0), (0, 1)):
                    after = image[y + dy, x + dx] if y + dy < height and x + dx < width else np.uint8(0)
                    before = image[y - dy, x - dx] if y >= dy and x >= dx else np.uint8(0)
                    farther = image[y - 2 * dy, x - 2 * dx] if y >= 2 * dy and x >= 2 * dx else np.uint8(0)
                    if g > after and (g > before or (g == before and g > farther)):
                        out[y, w] |= U1 << np.uint64(x & 63)
    return out


@njit(types.void(WORK, ROWS), cache=True, nogil=True)
def _prune(solid, doubtful):  # type: ignore[no-untyped-def]  # numba types it
    """Take doubtful pixels away as long as that parts nothing."""
    again = True
    while again:
        again = False
        for y in range(doubtful.shape[0]):
            for w in range(doubtful.shape[1]):
                word = doubtful[y, w] & solid[y, w]
                while word != U0:
                    x = w * 64 + lowest_bit(word)
                    word &= word - U1
                    near = around(solid, y, x)
                    if near == 0 or is_simple(near):
                        solid[y, w] &= ~(U1 << np.uint64(x & 63))
                        again = True


@njit(types.void(ROWS, WORK), cache=True, nogil=True)
def _around(rows, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = rows ⊕ the 3 × 3 square; bits past the width are as they come."""
    height, words = rows.shape
    for y in range(height):
        west = U0
        for w in range(words):
            here = rows[y, w]
            if y > 0:
                here |= rows[y - 1, w]
            if y + 1 < height:
                here |= rows[y + 1, w]
            out[y, w] = here | (here << U1) | (west >> U63)
            if w > 0:
                out[y, w - 1] |= here << U63
            out[y, w] |= here >> U1
            west = here


def around_px(rows: Rows, within: Rows) -> Rows:
    """(H, words): the pixels of `within` that are, or have around them, a pixel of `rows`."""
    out = np.empty_like(rows)
    _around(rows, out)
    out &= within
    return out


@njit
def _in_cross(rows, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Whether pixel (y, x) lies in a cross of five pixels of `rows`."""
    if not bit_at(rows, y, x):
        return False
    for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)):
        v, u = y + dy, x + dx
        if (
            bit_at(rows, v, u)
            and bit_at(rows, v, u + 1)
            and bit_at(rows, v, u - 1)
            and bit_at(rows, v + 1, u)
            and bit_at(rows, v - 1, u)
        ):
            return True
    return False


@njit(types.void(WORK, ROWS, HALF_WIDTHS), cache=True, nogil=True)
def _near_wide(pixels, solid, half_widths):  # type: ignore[no-untyped-def]  # numba types it
    """Of `pixels`, keep those with a pixel of what is wider than two pixels (S opened by a cross) in the disc around
    them."""
    height, words = pixels.shape
    reach = half_widths.shape[0] - 1
    for y in range(height):
        for w in range(words):
            left = pixels[y, w]
            while left != U0:
                x = w * 64 + lowest_bit(left)
                left &= left - U1
                found = False
                dy = -reach
                while dy <= reach and not found:
                    half = half_widths[abs(dy)]
                    for u in range(x - half, x + half + 1):
                        if _in_cross(solid, y + dy, u):
                            found = True
                            break
                    dy += 1
                if not found:
                    pixels[y, w] &= ~(U1 << np.uint64(x & 63))


class Seen(NamedTuple):
    """What of a grey layer is solid, and which of it is a dimmed interior, to be left as it is; packed."""

    rows: Rows
    dimmed: Rows | None


def solid_rows(image: Values | GreyImage, threshold: int, grey_floor: int) -> Seen:
    """What of a grey layer is solid: (H, W) uint8 → (H, words).

    Pixels from `threshold` on. From `grey_floor` on (0: none), also
    - what nowhere touches those: strokes, and areas, which are dimmed as a whole;
    - the crest of strokes so thin that they reach the threshold only here and there. Near what is wider than three
      pixels, where a crest may be the tip of a corner, only what holds parts together;
    - what is dim inside of what is bright: a pattern that dims the exposure, not walls and gaps.
    """
    image = GreyImage.of(image)
    solid = image.at_least(threshold)
    if not 0 < grey_floor < threshold:
        return Seen(solid, None)
    faint = image.at_least(grey_floor)
    dim = faint & ~solid
    if not dim.any():
        return Seen(solid, None)
    width = image.shape[1]
    # No more images at once than need be: each is 7 MB of a 12K layer.
    dimmed = _dimmed(dim, faint, width)
    crest = _crests(image, dim)
    del dim
    lone = flood(solid, faint)
    np.invert(lone, out=lone)
    lone &= faint
    del faint
    dimmed = _with_broad(dimmed, lone, width)
    doubtful = crest.copy()
    _near_wide(doubtful, solid, disc_half_widths(4.0, 4.0))
    found = solid
    found |= crest
    del crest
    _prune(found, doubtful)
    found |= lone
    return Seen(found if dimmed is None else found | dimmed, dimmed)


def _crests(image: GreyImage, dim: Rows) -> Rows:
    """`_ridges` of the image, a band at a time: it looks two rows up and one down."""
    height, width = image.shape
    crest, room = np.zeros_like(dim), None
    for first, stop in bands_of(height, width):
        if dim[first:stop].any():
            top, bottom = max(first - 2, 0), min(stop + 1, height)
            room = np.empty((stop - first + 3, width), np.uint8) if room is None else room
            found = _ridges(image.rows(top, bottom, room), dim[top:bottom])
            crest[first:stop] = found[first - top : stop - top]
    return crest


def _dimmed(dim: Rows, faint: Rows, width: int) -> Rows | None:
    """Dim pixels that bright ones shut off from the void, and the bright ones between, where they fill an area."""
    inside = flood(around_px(~faint, dim), dim)
    np.invert(inside, out=inside)
    inside &= dim
    if int(np.bitwise_count(inside).sum()) < PATTERN_PX:
        return None
    found = opened(dilate(inside, width, (1.5, 1.5)), width, (2.5, 2.5)) & faint
    return found if found.any() else None


def _with_broad(dimmed: Rows | None, lone: Rows, width: int) -> Rows | None:
    """What is dimmed, and parts that nowhere reach the threshold though they are wider than any stroke is."""
    if not lone.any():
        return dimmed
    broad = opened(lone, width, (BROAD_PX / 2, BROAD_PX / 2))
    if not broad.any():
        return dimmed
    broad = flood(broad, lone)
    return broad if dimmed is None else broad | dimmed


def disc_coverage(rx_px: float, ry_px: float, offset_px: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
    """How much of each pixel a disc covers, 0 … 1: (2·Ry + 1, 2·Rx + 1), the disc's own pixel in the middle.

    offset_px  (x, y) of the disc's middle, from the centre of its pixel
    Integrated over SUBSTEPS columns a pixel, exactly in y, so that the rim has no steps of its own.
    """
    reach_x, reach_y = (int(np.ceil(r + abs(o) + 0.5)) for r, o in zip((rx_px, ry_px), offset_px, strict=True))
    x = np.arange(-reach_x, reach_x + 1)[:, None] + (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS - 0.5 - offset_px[0]
    half = ry_px * np.sqrt(np.maximum(1 - (x / rx_px) ** 2, 0))  # (columns, substeps)
    y = np.arange(-reach_y, reach_y + 1)[:, None, None] - offset_px[1]
    covered = np.minimum(y + 0.5, half) - np.maximum(y - 0.5, -half)
    share: NDArray[np.float64] = np.clip(covered, 0, 1).mean(axis=2)
    return share


@njit(types.void(TARGET, ROWS, ROWS, ROWS, IMAGE, types.uint8), cache=True, nogil=True)
def _draw(image, paths, drawn, rim, stencil, threshold):  # type: ignore[no-untyped-def]  # numba types it
    """image = max(image, stencil) around every path pixel, where `drawn` or (below threshold) `rim` is set."""
    height, width = image.shape
    reach_y, reach_x = stencil.shape[0] // 2, stencil.shape[1] // 2
    for y in range(height):
        for w in range(paths.shape[1]):
            word = paths[y, w]
            bit = 0
            while word != U0:
                if word & U1:
                    x = w * 64 + bit
                    for v in range(max(y - reach_y, 0), min(y + reach_y + 1, height)):
                        for u in range(max(x - reach_x, 0), min(x + reach_x + 1, width)):
                            value = stencil[v - y + reach_y, u - x + reach_x]
                            if value <= image[v, u]:
                                continue
                            shift = np.uint64(u & 63)
                            if (drawn[v, u >> 6] >> shift) & U1:
                                image[v, u] = value
                            elif (rim[v, u >> 6] >> shift) & U1:
                                image[v, u] = max(image[v, u], min(value, threshold - U8))  # not solid itself
                word >>= U1
                bit += 1


@njit(types.void(TARGET, ROWS, types.uint8, types.boolean), cache=True, nogil=True)
def _set_where(image, rows, value, raise_only):  # type: ignore[no-untyped-def]  # numba types it
    """image = value where a bit is set (only where it is lower, if `raise_only`)."""
    height, width = image.shape
    for y in range(height):
        for w in range(rows.shape[1]):
            word = rows[y, w]
            if word == U0:
                continue
            for bit in range(min(64, width - w * 64)):
                if (word >> np.uint64(bit)) & U1 and not (raise_only and image[y, w * 64 + bit] >= value):
                    image[y, w * 64 + bit] = value


def corrected_greys(
    image: GreyImage,
    before: Rows,
    after: Rows,
    paths: Rows,
    radius_px: tuple[float, float],
    threshold: int,
    *,
    offset_px: tuple[float, float] = (0.0, 0.0),
    dimmed: Rows | None = None,
) -> Greys:
    """A grey layer with its correction drawn in: (H, W) → (H, W), made in bands when asked for.

    before, after  what was solid (`solid_rows`) and what is, packed
    paths          where F was drawn, packed
    radius_px      (rx, ry) of F; offset_px: of its middle from a path pixel's centre, half a pixel where F is even
    dimmed         what is left as it is, packed
    """
    stencil = np.round(255 * disc_coverage(*radius_px, offset_px)).astype(np.uint8)
    return Greys(image.shape, partial(_corrected_bands, image, before, after, paths, dimmed, stencil, threshold))


def _corrected_bands(
    image: GreyImage,
    before: Rows,
    after: Rows,
    paths: Rows,
    dimmed: Rows | None,
    stencil: Values,
    threshold: int,
) -> Iterator[Values]:
    """The bands of `corrected_greys`, each made with the rows around it that the stencil and the rim reach."""
    height, width = image.shape
    reach, room = len(stencil) // 2 + 1, None
    for first, stop in bands_of(height, width):
        top, bottom = max(first - reach, 0), min(stop + reach, height)
        room = np.empty((stop - first + 2 * reach, width), np.uint8) if room is None else room
        band, now = image.rows(top, bottom, room), after[top:bottom]
        bright = image.at_least(threshold, top, bottom)
        kept = bright if dimmed is None else bright | dimmed[top:bottom]
        added = now & ~kept
        _set_where(band, before[top:bottom] & ~now, 0, False)
        if added.any():
            rim = around_px(added, ~now & ~kept)
            drawn = now if dimmed is None else now & ~dimmed[top:bottom]
            _draw(band, paths[top:bottom], drawn, rim, stencil, threshold)
            _set_where(band, added, threshold, True)  # of F, whose disc covers a little less than half
        yield band[first - top : stop - top]
