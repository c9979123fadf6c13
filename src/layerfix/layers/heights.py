"""Features of too few layers: what is solid at a pixel for fewer than n layers in a row becomes n layers high.

The method works in the plane of a layer; in z the smallest feature is a number of layers. A run of L < n layers at a
pixel grows by n - L: downwards where its part of the lowest layer stands on something (shares a pixel or an edge with
the layer below), so that nothing is added on top of what is flush; upwards where it begins on nothing, or on the
plate. What has no room that way grows the other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.layers.flood import flood
from layerfix.layers.morphology import dilate
from layerfix.stack import Layer, LayerStack
from layerfix.threads import Remembered

if TYPE_CHECKING:
    from collections.abc import Callable

    from layerfix.bits import Rows

MOST_LAYERS = 100


def with_min_layers(stack: LayerStack, min_layers: int) -> LayerStack:
    """The stack in which everything is at least so many layers high; each layer says what it got (`Layer.raised_px`).

    A stack of fewer layers is filled from the bottom to the top where something is in any of them.
    Raises InputError for a number that is not 1 … MOST_LAYERS.
    """
    if not 1 <= min_layers <= MOST_LAYERS or int(min_layers) != min_layers:
        raise InputError(f"min layers {min_layers}: a whole number from 1 to {MOST_LAYERS}")
    least = min(int(min_layers), len(stack))
    return stack if least < 2 else replace(stack, make=Raised(stack.make, len(stack), least), repeats=None)


@dataclass(frozen=True, eq=False)
class Raised:
    """`make` of a stack that is raised. What is pickled is how its layers are made."""

    make: Callable[[int], Layer]
    count: int
    least: int
    _layers: Remembered[Layer] = field(init=False)
    _standing: Remembered[Rows] = field(init=False)

    def __post_init__(self) -> None:
        """Set up what is remembered."""
        keep = 6 * self.least + 16
        object.__setattr__(self, "_layers", Remembered(self.make, keep))
        object.__setattr__(self, "_standing", Remembered(self._stands, keep))

    def __reduce__(self) -> tuple[type[Raised], tuple[Callable[[int], Layer], int, int]]:
        return Raised, (self.make, self.count, self.least)

    def _rows(self, index: int) -> Rows:
        """What of a layer counts: all but specks that are to be left as they are; nothing outside the stack."""
        layer = self._layers(min(max(index, 0), self.count - 1))
        if not 0 <= index < self.count:
            return np.zeros_like(layer.rows)
        return layer.rows if layer.specks is None else layer.rows & ~layer.specks

    def _stands(self, index: int) -> Rows:
        """The parts of a layer that touch the one below."""
        rows, below = self._rows(index), self._rows(index - 1)
        if not below.any():
            return np.zeros_like(rows)
        return flood(rows & dilate(below, self._layers(index).width, (1.0, 1.0)), rows)

    def __call__(self, index: int) -> Layer:
        layer, n = self._layers(index), self.least
        rows = layer.rows.copy()
        for first in range(max(index - 2 * n + 2, 0), min(index + n, self.count)):
            begun = self._rows(first) & ~self._rows(first - 1)
            for length in range(1, n):
                if not begun.any():
                    break
                ended = begun & ~self._rows(first + length)
                begun = begun & ~ended
                if not ended.any():
                    continue
                missing, below, above = n - length, first, self.count - first - length
                down = min(missing, below)
                up = min(missing, above)
                # (how many layers go down, how many up) for what stands on something and for what does not.
                for chosen, (lower, upper) in (
                    (True, (down, min(missing - down, above))),
                    (False, (min(missing - up, below), up)),
                ):
                    reaches = first - lower <= index < first or first + length <= index < first + length + upper
                    if reaches:
                        stands = self._standing(first)
                        rows |= ended & (stands if chosen else ~stands)
        raised_px = int(np.bitwise_count(rows & ~layer.rows).sum())
        return replace(layer, rows=rows, raised_px=raised_px) if raised_px else layer
