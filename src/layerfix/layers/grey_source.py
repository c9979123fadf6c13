"""The greys that a layer comes from, kept for a writer of greys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import mirrored

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.stack import Layer


@dataclass(frozen=True, eq=False)
class GreySource:
    """What of a layer of greys was solid, from above, and the greys.

    seen       packed rows, from above
    grey       (H, W) uint8 as the file has it, mirrored along the axes in `mirror`; None if it has no greys
    dimmed     what of it is a dimmed interior, packed, as the file has it; None if nothing
    threshold  grey value that is solid
    """

    seen: Rows
    grey: NDArray[np.uint8] | None
    dimmed: Rows | None
    threshold: int
    mirror: str

    @property
    def dimmed_px(self) -> int:
        """Pixels of dimmed interiors."""
        return 0 if self.dimmed is None else int(np.bitwise_count(self.dimmed).sum())

    def corrected(self, layer: Layer) -> NDArray[np.uint8] | None:
        """The greys with a layer's correction drawn in, as the file has them; None if there are none."""
        if self.grey is None:
            return None
        if np.array_equal(layer.rows, self.seen):
            return self.grey
        from layerfix.layers.greys import corrected_greys

        change = layer.change
        paths = np.zeros_like(layer.rows) if change is None or change.paths is None else change.paths
        before, after, drawn = (mirrored(rows, layer.width, self.mirror) for rows in (self.seen, layer.rows, paths))
        x, y = change.offset_px if change else (0.0, 0.0)
        offset_px = -x if "x" in self.mirror else x, -y if "y" in self.mirror else y
        radius_px = change.radius_px if change else (0.5, 0.5)
        return corrected_greys(self.grey, before, after, drawn, radius_px, self.threshold,
                               offset_px=offset_px, dimmed=self.dimmed)  # fmt: skip

    def from_above(self, layer: Layer, bits: int = 8) -> NDArray[np.uint8] | None:
        """The same from above, in so many bits; None if there are no greys."""
        image = self.corrected(layer)
        if image is None:
            return None
        image = image[:: -1 if "y" in self.mirror else 1, :: -1 if "x" in self.mirror else 1]
        if bits < 8:
            most = (1 << bits) - 1
            levels = np.round(np.round(np.arange(256) * most / 255) * 255 / most).astype(np.uint8)
            image = levels[image]
        return np.ascontiguousarray(image)


def greys_of(layer: Layer, bits: int = 8) -> NDArray[np.uint8] | None:
    """A layer's greys from above, (H, W) uint8 in so many bits, if it comes from any; None if not, or for one bit."""
    if bits < 2 or not isinstance(layer.source, GreySource):
        return None
    return layer.source.from_above(layer, bits)


def seen_from_above(
    rows: Rows, grey: NDArray[np.uint8] | None, width: int, threshold: int, grey_floor: int, mirror: str
) -> tuple[Rows, NDArray[np.uint8] | None, Rows | None]:
    """(what is solid, from above; the greys and what of them is dimmed, as they are). rows: what is solid without
    greys; they may be written to.
    """
    dimmed = None
    if grey is not None:
        from layerfix.layers.greys import solid_rows

        rows, dimmed = solid_rows(grey, threshold, grey_floor)
    return mirrored(rows, width, mirror, out=rows), grey, dimmed
