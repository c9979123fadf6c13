"""The greys that a layer comes from, kept for a writer of greys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import mirrored
from layerfix.layers.grey_image import GreyImage, Greys

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer


@dataclass(frozen=True, eq=False)
class GreySource:
    """What of a layer of greys was solid, from above, and the greys.

    seen       packed rows, from above
    held       the greys, (H, W), as the file has them, mirrored along the axes in `mirror`; None if it has no greys
    dimmed     what of it is a dimmed interior, packed, as the file has it; None if nothing
    threshold  grey value that is solid
    """

    seen: Rows
    held: GreyImage | None
    dimmed: Rows | None
    threshold: int
    mirror: str

    @property
    def grey(self) -> NDArray[np.uint8] | None:
        """The greys written out, (H, W) uint8."""
        return None if self.held is None else np.asarray(self.held)

    @property
    def dimmed_px(self) -> int:
        """Pixels of dimmed interiors."""
        return 0 if self.dimmed is None else int(np.bitwise_count(self.dimmed).sum())

    def corrected(self, layer: Layer) -> Greys | None:
        """The greys with a layer's correction drawn in, as the file has them; None if there are none."""
        if self.held is None:
            return None
        if np.array_equal(layer.rows, self.seen):
            return self.held
        from layerfix.layers.greys import corrected_greys

        change = layer.change
        paths = np.zeros_like(layer.rows) if change is None or change.paths is None else change.paths
        before, after, drawn = (mirrored(rows, layer.width, self.mirror) for rows in (self.seen, layer.rows, paths))
        x, y = change.offset_px if change else (0.0, 0.0)
        offset_px = -x if "x" in self.mirror else x, -y if "y" in self.mirror else y
        radius_px = change.radius_px if change else (0.5, 0.5)
        return corrected_greys(self.held, before, after, drawn, radius_px, self.threshold,
                                     offset_px=offset_px, dimmed=self.dimmed)  # fmt: skip

    def from_above(self, layer: Layer, bits: int = 8) -> Greys | None:
        """The same from above, in so many bits; None if there are no greys."""
        image = self.corrected(layer)
        return None if image is None else image.mirrored(self.mirror).in_bits(bits)


def has_greys(layer: Layer) -> bool:
    """Whether a layer comes from an image with greys."""
    return isinstance(layer.source, GreySource) and layer.source.held is not None


def greys_of(layer: Layer, bits: int = 8) -> Greys | None:
    """A layer's greys from above, (H, W) in so many bits, if it comes from any; None if not, or for one bit."""
    if bits < 2 or not isinstance(layer.source, GreySource):
        return None
    return layer.source.from_above(layer, bits)


def seen_from_above(
    rows: Rows, grey: NDArray[np.uint8] | GreyImage | None, width: int, threshold: int, grey_floor: int, mirror: str
) -> tuple[Rows, GreyImage | None, Rows | None]:
    """(what is solid, from above; the greys and what of them is dimmed, as they are). rows: what is solid without
    greys; they may be written to.
    """
    dimmed = None
    if grey is not None:
        from layerfix.layers.greys import solid_rows

        grey = GreyImage.of(grey)
        rows, dimmed = solid_rows(grey, threshold, grey_floor)
    return mirrored(rows, width, mirror, out=rows), grey, dimmed
