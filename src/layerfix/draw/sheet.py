"""Pictures of a layer from all sides, and of many layers at once: for those who look before they print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from layerfix.bits import unpack
from layerfix.draw.before_after import INK, SOLID, WHITE, painted, scaled
from layerfix.errors import InputError
from layerfix.units import format_mm

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

    from layerfix.bits import Image, Rows
    from layerfix.stack import Layer

PANEL_PX, THUMB_PX, GAP_PX, CAPTION_PX = 760, 300, 24, 40
PATHS = (17, 17, 17)
MOST_THUMBS = 24


class Pair(NamedTuple):
    """A layer before and after correction, and which it is."""

    number: int
    before: Layer
    after: Layer


def four_panels(pair: Pair, pixel_mm: tuple[float, float]) -> Picture:
    """Before, after, difference and skeleton (where F was drawn), at one scale, with a bar of a round length."""
    from PIL import Image, ImageDraw

    was, now, paths = _cropped(pair, _box([pair]))
    before, after = painted(was, was), painted(now, now)
    difference = painted(was, now)
    skeleton = painted(was, was)
    skeleton[paths] = PATHS
    size, scale = _size(was.shape, pixel_mm, PANEL_PX)
    bottom, top = pair.after.z_mm
    titles = ("before", "after", "difference: added red, removed blue", "skeleton, where it is too thin")
    width = 2 * max(size[0], 420) + 3 * GAP_PX
    height = 2 * (size[1] + CAPTION_PX) + 2 * GAP_PX + 2 * CAPTION_PX
    sheet = Image.new("RGB", (width, height), WHITE)
    pen = ImageDraw.Draw(sheet)
    pen.text((GAP_PX, 12), f"layer {pair.number}, z {bottom:.3f} to {top:.3f} mm", fill=INK, font_size=26)
    for k, (panel, title) in enumerate(zip((before, after, difference, skeleton), titles, strict=True)):
        x = GAP_PX + (k % 2) * (max(size[0], 420) + GAP_PX)
        y = CAPTION_PX + GAP_PX + (k // 2) * (size[1] + CAPTION_PX + GAP_PX)
        pen.text((x, y), title, fill=INK, font_size=22)
        sheet.paste(scaled(panel, size), (x, y + CAPTION_PX - 8))
        pen.rectangle((x - 1, y + CAPTION_PX - 9, x + size[0], y + CAPTION_PX - 8 + size[1]), outline=SOLID)
    length_mm = _round_length(size[0] / scale / 3)
    y = height - 16
    pen.rectangle((GAP_PX, y - 4, GAP_PX + round(length_mm * scale), y), fill=INK)
    pen.text((GAP_PX + round(length_mm * scale) + 10, y - 18), format_mm(length_mm), fill=INK, font_size=20)
    return sheet


def contact_sheet(pairs: Sequence[Pair], pixel_mm: tuple[float, float]) -> Picture:
    """The difference of many layers, small, all at one scale and crop, from the bottom up, row by row.

    Pairs are asked for twice, one after the other, and not kept: 24 layers of 12K would be gigabytes.
    Raises InputError if there are none.
    """
    from PIL import Image, ImageDraw

    if not len(pairs):
        raise InputError("no layers to show")
    box = _box(pairs)
    y0, y1, x0, x1 = box
    size, _ = _size((y1 - y0, x1 - x0), pixel_mm, THUMB_PX)
    columns = min(len(pairs), max(1, math.isqrt(len(pairs) * 2)))
    rows = math.ceil(len(pairs) / columns)
    step = max(size[0], 150) + GAP_PX, size[1] + CAPTION_PX + GAP_PX
    sheet = Image.new("RGB", (columns * step[0] + GAP_PX, rows * step[1] + GAP_PX), WHITE)
    pen = ImageDraw.Draw(sheet)
    for k, pair in enumerate(pairs):
        was, now, _ = _cropped(pair, box)
        x, y = GAP_PX + (k % columns) * step[0], GAP_PX + (k // columns) * step[1]
        pen.text((x, y), f"layer {pair.number}, z {pair.after.z_mm[0]:.2f}", fill=INK, font_size=18)
        sheet.paste(scaled(painted(was, now), size), (x, y + 28))
        pen.rectangle((x - 1, y + 27, x + size[0], y + 28 + size[1]), outline=SOLID)
    return sheet


def _box(pairs: Sequence[Pair]) -> tuple[int, int, int, int]:
    """(first row, past the last, first column, past the last) around what is solid in any, with a little air."""
    solid: Rows | None = None
    width, height = pairs[0].after.width, pairs[0].after.height
    for _, before, after in pairs:
        if (before.width, before.height) != (after.width, after.height):
            raise InputError(f"layers of {before.width} × {before.height} and {after.width} × {after.height} px")
        if solid is None:
            solid = before.rows | after.rows
        else:
            solid |= before.rows
            solid |= after.rows
    assert solid is not None
    down = np.flatnonzero(solid.any(axis=1))
    if not len(down):
        return 0, height, 0, width
    across = np.flatnonzero(unpack(np.bitwise_or.reduce(solid, axis=0)[None], width)[0])
    (y0, y1), (x0, x1) = down[[0, -1]].tolist(), across[[0, -1]].tolist()
    air = 2 + max(x1 - x0, y1 - y0) // 50
    return max(y0 - air, 0), min(y1 + air + 1, height), max(x0 - air, 0), min(x1 + air + 1, width)


def _cropped(pair: Pair, box: tuple[int, int, int, int]) -> tuple[Image, Image, Image]:
    """(before, after, paths) in that box."""
    y0, y1, x0, x1 = box
    _, before, after = pair
    change = after.change
    paths = change.paths if change is not None else None
    was, now = (unpack(layer.rows[y0:y1], layer.width)[:, x0:x1] for layer in (before, after))
    return was, now, np.zeros_like(was) if paths is None else unpack(paths[y0:y1], after.width)[:, x0:x1]


def _size(shape: tuple[int, ...], pixel_mm: tuple[float, float], most_px: int) -> tuple[tuple[int, int], float]:
    """(width and height in px of the picture, px a mm)."""
    width_mm, height_mm = shape[1] * pixel_mm[0], shape[0] * pixel_mm[1]
    scale = most_px / max(width_mm, height_mm)
    return (max(round(width_mm * scale), 1), max(round(height_mm * scale), 1)), scale


def _round_length(most_mm: float) -> float:
    """The largest of 1, 2, 5, 10 … at most so long."""
    power: float = 10.0 ** math.floor(math.log10(most_mm))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= most_mm * (1 + 1e-9))
