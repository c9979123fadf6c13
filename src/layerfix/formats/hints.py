"""What a user may say of a file of layers that it does not say itself, or says wrongly."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from layerfix.errors import InputError
from layerfix.stack import layer_bounds_mm
from layerfix.units import format_mm

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from layerfix.printers import Printer

ALIKE = 0.01  # of a pitch or a height: what a file rounds


@dataclass(frozen=True)
class Hints:
    """What is given here wins over the file, and the file over the printer.

    threshold   grey value from which a pixel counts as solid
    grey_floor  grey value from which a stroke counts that never reaches `threshold`; 0 to ignore such strokes
    told        sentences about what was given and is not what the file says
    """

    printer: Printer | None = None
    pixel_mm: tuple[float, float] | None = None
    layer_mm: float | None = None
    first_layer_mm: float | None = None
    threshold: int = 128
    grey_floor: int = 32
    told: list[str] = field(default_factory=list, compare=False)

    def pitch(self, said: tuple[float, float] | None) -> tuple[float, float] | None:
        """The pixels' pitch: given, else the file's, else the printer's."""
        given = self.pixel_mm
        if given and said and any(abs(g - s) > ALIKE * s for g, s in zip(given, said, strict=True)):
            self.told.append(f"the file says pixels of {_pitch(said)}; counted as {_pitch(given)}, as asked")
        return given or said or (self.printer.pixel_mm if self.printer else None)

    def layer(self, said: float | None) -> float | None:
        """The layers' height: given, else the file's, else the printer's."""
        self._compare("layers", said, self.layer_mm)
        return self.layer_mm or said or (self.printer.layer_mm if self.printer else None)

    def first_layer(self, said: float) -> float:
        """The first layer's height: given, else the file's."""
        self._compare("a first layer", said, self.first_layer_mm)
        return self.first_layer_mm or said

    def bounds(self, where: Path | str, said: NDArray[np.float64]) -> NDArray[np.float64]:
        """(layers, 2): bottom and top of each, of a file that says them of every layer.

        where  the file, for messages

        Raises InputError for a first layer's height alone: the others would stay where they are.
        """
        if self.layer_mm is None:
            first = float(said[0, 1] - said[0, 0])
            if self.first_layer_mm is not None and abs(self.first_layer_mm - first) > ALIKE * first:
                raise InputError(
                    f"{where}: a first layer of {format_mm(self.first_layer_mm)}: the file says where every layer is,"
                    f" the first {format_mm(first)} high; give the layer height, too (--layer)"
                )
            return said
        found = layer_bounds_mm(len(said), self.layer_mm, self.first_layer_mm)
        self._compare("a part", float(said[-1, 1]), float(found[-1, 1]))
        return found

    def _compare(self, what: str, said: float | None, given: float | None) -> None:
        if said and given and abs(given - said) > ALIKE * said:
            self.told.append(f"the file says {what} of {format_mm(said)}; counted as {format_mm(given)}, as asked")


def _pitch(pixel_mm: tuple[float, float]) -> str:
    x, y = pixel_mm
    return format_mm(x) if abs(x - y) <= ALIKE * x else f"{format_mm(x)} × {format_mm(y)}"
