"""What a user may say about a file that is read or written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from layerfix.fdm import PathSettings
    from layerfix.formats.encoding import Watch
    from layerfix.printers import Printer


@dataclass(frozen=True)
class Hints:
    """What a container may not say about its layers. What is given here wins over the file, and the file over
    the printer.

    threshold   grey value from which a pixel counts as solid
    grey_floor  grey value from which a stroke counts that never reaches `threshold`; 0 to ignore such strokes
    """

    printer: Printer | None = None
    pixel_mm: tuple[float, float] | None = None
    layer_mm: float | None = None
    first_layer_mm: float | None = None
    threshold: int = 128
    grey_floor: int = 32


@dataclass(frozen=True)
class WriteOptions:
    """How to write: for which printer, over an existing target or not, PNG bits a pixel, and who watches.

    tolerance_mm  of outlines (`trace_contours`); None is half a pixel
    ascii         the readable form of a format that has a binary one, too
    paths         how G-code lays its beads; None is as the printer's file says
    width_mm      extrusion width of each layer, (layers,), instead of one for all
    tell          told in a sentence what a user should know of what was written
    """

    printer: Printer | None = None
    force: bool = False
    bits: int = 8
    watch: Watch | None = None
    tolerance_mm: float | None = None
    ascii: bool = False
    paths: PathSettings | None = None
    width_mm: NDArray[np.float64] | None = None
    tell: Callable[[str], None] | None = None
