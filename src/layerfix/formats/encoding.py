"""What every writer of layers does: encode them in the stack's threads, in order, and tell who watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from layerfix.stack import Layer, LayerStack

Data = TypeVar("Data")
# Told of each layer in order as it is written: its index, and the layer without its pixels.
Watch = Callable[[int, "Layer"], None]


def encoded(stack: LayerStack, encode: Callable[[Layer], Data], watch: Watch | None, *, once: bool) -> Iterator[Data]:
    """Yield `encode` of every layer. once: layers that repeat the one below are not encoded again."""

    def work(layer: Layer) -> tuple[Data, Layer]:
        return encode(layer), replace(layer, rows=layer.rows[:0].copy(), source=None)

    for index, (data, facts) in enumerate(stack.each(work, once=once)):
        if watch is not None:
            bottom, top = stack.z_mm[index].tolist()
            watch(index, replace(facts, z_mm=(bottom, top)))
        yield data
