"""Specks: parts of a layer with nothing below and nothing above them, not even beside a pixel.

Often dirt of an export: a pixel in one layer, which correction would make a disc of F's size that hangs in the vat.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from layerfix.layers.flood import flood
from layerfix.layers.morphology import dilate
from layerfix.stack import Layer, LayerStack
from layerfix.threads import Remembered

if TYPE_CHECKING:
    from collections.abc import Callable

    from layerfix.bits import Rows

KEPT = 16  # layers that are remembered


def with_specks(stack: LayerStack) -> LayerStack:
    """The same stack, each layer of which knows its specks (`Layer.specks`). A stack of one layer has none."""
    return replace(stack, make=_Marked(stack.make, len(stack)), repeats=None) if len(stack) > 1 else stack


@dataclass(frozen=True, eq=False)
class _Marked:
    """`make` of such a stack. What is pickled is how its layers are made."""

    make: Callable[[int], Layer]
    count: int
    _layers: Remembered[Layer] = field(init=False)

    def __post_init__(self) -> None:
        """Set up what is remembered."""
        object.__setattr__(self, "_layers", Remembered(self.make, KEPT))

    def __reduce__(self) -> tuple[type[_Marked], tuple[Callable[[int], Layer], int]]:
        return _Marked, (self.make, self.count)

    def __call__(self, index: int) -> Layer:
        layer = self._layers(index)
        around: Rows = np.zeros_like(layer.rows)
        for k in (index - 1, index + 1):
            if 0 <= k < self.count:
                around = around | self._layers(k).rows
        held = flood(layer.rows & dilate(around, layer.width, (1.5, 1.5)), layer.rows)
        specks = layer.rows & ~held
        return replace(layer, specks=specks) if specks.any() else layer
