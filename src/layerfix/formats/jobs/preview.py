"""A picture of a whole stack for the thumbnails of job files: the part from above, lit from the side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import unpack

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

    from layerfix.bits import Image
    from layerfix.stack import Layer, LayerStack

LONGEST_PX = 640
BACKGROUND, MATERIAL = (24, 26, 30), (236, 140, 52)
LIGHT = np.array([-0.5, 0.5, 0.7]) / np.linalg.norm([-0.5, 0.5, 0.7])  # from the back left, above


class Preview:
    """Collects the height of the part over blocks of pixels, layer by layer from below."""

    def __init__(self, stack: LayerStack) -> None:
        self.block = max(1, -(-max(stack.width, stack.height) // LONGEST_PX))
        self.pitch_mm = stack.pixel_mm[0] * self.block, stack.pixel_mm[1] * self.block
        self.heights = np.full((-(-stack.height // self.block), -(-stack.width // self.block)), -1.0)

    def reduce(self, layer: Layer) -> Image:
        """Which blocks hold a solid pixel; safe in threads."""
        starts = np.arange(0, layer.height, self.block)
        rows = np.bitwise_or.reduceat(layer.rows, starts, axis=0)
        image = unpack(rows, layer.width)
        padded = np.zeros((len(starts), self.heights.shape[1] * self.block), np.bool_)
        padded[:, : layer.width] = image
        return np.asarray(padded.reshape(len(starts), -1, self.block).any(axis=2))

    def add(self, blocks: Image, top_mm: float) -> None:
        """Take in one layer; in order from below."""
        self.heights[blocks] = top_mm

    def picture(self, size: tuple[int, int]) -> Picture:
        """The part, shaded, in the middle of a picture of `size` (width, height)."""
        import PIL.Image

        solid = self.heights >= 0
        heights = np.where(solid, self.heights, 0.0)
        down, right = (np.zeros_like(heights), np.zeros_like(heights))
        if min(heights.shape) > 1:
            down, right = np.gradient(heights, self.pitch_mm[1], self.pitch_mm[0])
        normal = np.stack([-right, down, np.ones_like(heights)])
        normal /= np.linalg.norm(normal, axis=0)
        shade = 0.35 + 0.65 * np.clip(np.tensordot(LIGHT, normal, 1), 0, 1)
        image = np.where(solid[..., None], shade[..., None] * MATERIAL, BACKGROUND).astype(np.uint8)
        rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
        if len(rows):
            image = image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        wide, high = image.shape[1] * self.pitch_mm[0], image.shape[0] * self.pitch_mm[1]
        scale = 0.9 * min(size[0] / wide, size[1] / high)
        part = PIL.Image.fromarray(image).resize((max(round(wide * scale), 1), max(round(high * scale), 1)))
        canvas = PIL.Image.new("RGB", size, BACKGROUND)
        canvas.paste(part, ((size[0] - part.width) // 2, (size[1] - part.height) // 2))
        return canvas
