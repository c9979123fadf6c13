"""Pictures of layers for people: what was there, what correction added and removed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image as Picture

    from layerfix.bits import Image
    from layerfix.stack import Layer

WHITE, SOLID, ADDED, REMOVED, INK = (
    (255, 255, 255),
    (172, 178, 186),
    (214, 39, 40),
    (31, 95, 214),
    (40, 44, 52),
)
PANEL_PX = 900  # longest side of one layer in a picture
CAPTION_PX, CAPTION_WIDTH_PX = 56, 400


def before_after(before: Layer, after: Layer, pixel_mm: tuple[float, float], *, title: str = "") -> Picture:
    """Two panels side by side: the layer as it was, and corrected with additions in red, removals in blue.

    Both show the same crop, at the same scale in mm. Raises InputError if the layers differ in size.
    """
    from PIL import Image, ImageDraw

    if (before.width, before.height) != (after.width, after.height):
        raise InputError(f"layers of {before.width} × {before.height} and {after.width} × {after.height} px")
    was, now = _crop(before.image(), after.image())
    left = painted(was, was)
    right = painted(was, now)
    size = _panel_size(was.shape, pixel_mm)
    gap = 24
    step = max(size[0], CAPTION_WIDTH_PX) + gap
    canvas = Image.new("RGB", (2 * step + gap, size[1] + CAPTION_PX + 2 * gap), WHITE)
    pen = ImageDraw.Draw(canvas)
    for k, (panel, caption) in enumerate(((left, f"as sliced{title}"), (right, "corrected:  "))):
        x = gap + k * step
        canvas.paste(scaled(panel, size), (x, CAPTION_PX + gap))
        pen.rectangle((x - 1, CAPTION_PX + gap - 1, x + size[0], CAPTION_PX + gap + size[1]), outline=SOLID)
        pen.text((x, gap), caption, fill=INK, font_size=28)
        if k:
            x += round(pen.textlength(caption, font_size=28))
            pen.text((x, gap), "added  ", fill=ADDED, font_size=28)
            pen.text(
                (x + round(pen.textlength("added  ", font_size=28)), gap),
                "removed",
                fill=REMOVED,
                font_size=28,
            )
    return canvas


def painted(was: Image, now: Image) -> NDArray[np.uint8]:
    """(H, W, 3) uint8: kept grey, added red, removed blue."""
    picture = np.full((*was.shape, 3), 255, np.uint8)
    picture[was & now] = SOLID
    picture[now & ~was] = ADDED
    picture[was & ~now] = REMOVED
    return picture


def _crop(was: Image, now: Image) -> tuple[Image, Image]:
    """Both cut to the box around what is solid in either, with a little air."""
    solid = was | now
    if not solid.any():
        return was, now
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    air = 2 + max(len(rows), len(columns)) // 50
    box = np.s_[max(rows[0] - air, 0) : rows[-1] + air + 1, max(columns[0] - air, 0) : columns[-1] + air + 1]
    return was[box], now[box]


def _panel_size(shape: tuple[int, ...], pixel_mm: tuple[float, float]) -> tuple[int, int]:
    width_mm, height_mm = shape[1] * pixel_mm[0], shape[0] * pixel_mm[1]
    scale = PANEL_PX / max(width_mm, height_mm)
    return max(round(width_mm * scale), 1), max(round(height_mm * scale), 1)


def scaled(panel: NDArray[np.uint8], size: tuple[int, int]) -> Picture:
    """Enlarged pixels stay square; a reduced picture averages, so that thin things fade but do not vanish."""
    from PIL import Image

    picture = Image.fromarray(panel)
    enlarged = size[0] > picture.width
    return picture.resize(size, Image.Resampling.NEAREST if enlarged else Image.Resampling.BOX)
