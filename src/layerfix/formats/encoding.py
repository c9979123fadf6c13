"""What every writer of layers does: encode them in the stack's threads, in order, and tell who watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from layerfix.errors import OutputError
from layerfix.layers.grey_source import greys_of, has_greys

if TYPE_CHECKING:
    from layerfix.formats.options import Watch, WriteOptions
    from layerfix.layers.grey_image import Greys
    from layerfix.printers import Printer
    from layerfix.stack import Layer, LayerStack

Data = TypeVar("Data")


def encoded(stack: LayerStack, encode: Callable[[Layer], Data], watch: Watch | None, *, once: bool) -> Iterator[Data]:
    """Yield `encode` of every layer. once: layers that repeat the one below are not encoded again."""

    def work(layer: Layer) -> tuple[Data, Layer]:
        return encode(layer), layer.without_pixels()

    for index, (data, facts) in enumerate(stack.each(work, once=once)):
        if watch is not None:
            bottom, top = stack.z_mm[index].tolist()
            watch(index, facts.at((bottom, top)))
        yield data


class PanelGreys:
    """The greys of layers as a printer's panel shows them; those that it cannot show are told."""

    def __init__(self, printer: Printer, options: WriteOptions) -> None:
        self._printer, self._options = printer, options
        self._lost: set[float] = set()  # bottoms of layers

    def __call__(self, layer: Layer) -> Greys | None:
        """A layer's greys from above, as `greys_of`; None for a panel of one bit."""
        bits = self._printer.antialias_bits or 8
        if bits < 2 and has_greys(layer):
            self._lost.add(layer.z_mm[0])
        return greys_of(layer, bits)

    def tell(self) -> None:
        """A word about greys that are black and white now, after all layers."""
        if self._lost and self._options.tell is not None:
            first = f"greys, the first at z = {min(self._lost):.3f} mm"  # layers that repeat are not asked again
            self._options.tell(f"{first}, are black and white now: {self._printer.title} shows no others")


def checked_printer(path: Path, stack: LayerStack, options: WriteOptions, suffixes: tuple[str, ...]) -> Printer:
    """The printer a new job is for.

    Raises OutputError without a printer, for one that takes other jobs or whose file
    lacks exposures, and for layers that are not the size of its panel.
    """
    printer = options.printer
    if printer is None:
        raise OutputError(f"{path}: a new job needs the printer's exposure and panel; give --printer")
    if printer.format not in suffixes:
        raise OutputError(f"{path}: {printer.name} takes {printer.format or 'other'} jobs, not {' '.join(suffixes)}")
    missing = [
        key for key in ("exposure_s", "bottom_exposure_s", "pixels", "build_mm") if getattr(printer, key) is None
    ]
    if missing:
        raise OutputError(f"{path}: the file of printer {printer.name} lacks {', '.join(missing)}")
    if printer.pixels != (stack.width, stack.height):
        raise OutputError(
            f"{path}: the layers are {stack.width} × {stack.height} px, the panel of {printer.name} has"
            f" {' × '.join(map(str, printer.pixels or ()))}; slice for this printer (without --pixel)"
        )
    return printer
