"""How beads are laid: widths, perimeters, infill."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack, get_args

from layerfix.errors import InputError
from layerfix.units import format_mm

if TYPE_CHECKING:
    from layerfix.printers import Printer

Seam = Literal["nearest", "rear", "random"]
SEAMS: tuple[Seam, ...] = get_args(Seam)
# A bead is laid well from 0.85 to 2 nozzle widths (measured by the slicers' makers; Arachne's lower limit).
NARROWEST, WIDEST = 0.85, 2.0


@dataclass(frozen=True)
class PathSettings:
    """What `plan_toolpaths` needs to know.

    nozzle_mm             bore of the nozzle
    width_mm              extrusion width; `first_layer_width_mm` on the first layer if it differs
    width_range_mm        narrowest and widest bead; a bead adapts to a thin place within it
    perimeters            closed loops along the outline
    density               of the sparse infill, 0 to 1
    top_layers, bottom_layers   layers of solid infill under and over whatever is open
    seam                  where loops start: "nearest" to the nozzle, at the "rear", or "random"
    skirt_loops, skirt_gap_mm   loops round the first layer, and how far from it
    """

    nozzle_mm: float
    width_mm: float
    first_layer_width_mm: float | None = None
    width_range_mm: tuple[float, float] | None = None
    perimeters: int = 2
    density: float = 0.2
    top_layers: int = 4
    bottom_layers: int = 4
    seam: Seam = "nearest"
    skirt_loops: int = 1
    skirt_gap_mm: float = 3.0

    def __post_init__(self) -> None:
        """Raises InputError for what no nozzle can do."""
        if not 0 < self.nozzle_mm < math.inf:
            raise InputError(f"nozzle {self.nozzle_mm} mm: it must be above 0")
        for width in (self.width_mm, *([] if self.first_layer_width_mm is None else [self.first_layer_width_mm])):
            self.check_width(width)
        low, high = self.range_mm
        if not 0 < low <= high < math.inf:
            raise InputError(f"widths from {low} to {high} mm: both are above 0, the narrowest first")
        if not 0 <= self.skirt_gap_mm < math.inf:
            raise InputError(f"skirt gap {self.skirt_gap_mm} mm: it is 0 or more")
        if not 0 <= self.density <= 1:
            raise InputError(f"infill density {self.density:g}: it is 0 to 1 (0 % to 100 %)")
        for name in ("perimeters", "top_layers", "bottom_layers", "skirt_loops"):
            if not hasattr(getattr(self, name), "__index__") or getattr(self, name) < 0:
                raise InputError(f"{name.replace('_', ' ')} {getattr(self, name)}: a whole number, 0 or more")
        if self.perimeters < 1:
            raise InputError("perimeters 0: at least one, or nothing holds the outline")
        if self.seam not in SEAMS:
            raise InputError(f"seam='{self.seam}' is not known; choose from {', '.join(SEAMS)}")

    @property
    def range_mm(self) -> tuple[float, float]:
        """Narrowest and widest bead."""
        return self.width_range_mm or (NARROWEST * self.nozzle_mm, WIDEST * self.nozzle_mm)

    def check_width(self, width_mm: float) -> None:
        """Raises InputError for a width that the nozzle cannot lay."""
        low, high = self.range_mm
        if not low - 1e-9 <= width_mm <= high + 1e-9:
            raise InputError(
                f"extrusion width {format_mm(width_mm)}: a nozzle of {format_mm(self.nozzle_mm)} lays"
                f" {format_mm(low)} to {format_mm(high)}"
            )

    def check_layer(self, layer_mm: float) -> None:
        """Raises InputError for a layer too high for the nozzle, or for the narrowest bead."""
        if layer_mm > self.nozzle_mm * (1 + 1e-9):
            raise InputError(
                f"layer height {format_mm(layer_mm)}: it is above the nozzle's {format_mm(self.nozzle_mm)};"
                f" use at most {format_mm(0.75 * self.nozzle_mm)}"
            )
        if layer_mm > self.range_mm[0]:
            raise InputError(
                f"layer height {format_mm(layer_mm)}: it is above the narrowest bead,"
                f" {format_mm(self.range_mm[0])}, which would then be taller than wide"
            )


class PathChanges(TypedDict, total=False):
    """What `settings_for` may change, by the names of `PathSettings`."""

    nozzle_mm: float
    width_mm: float
    first_layer_width_mm: float | None
    width_range_mm: tuple[float, float] | None
    perimeters: int
    density: float
    top_layers: int
    bottom_layers: int
    seam: Seam
    skirt_loops: int
    skirt_gap_mm: float


def settings_for(printer: Printer, **changes: Unpack[PathChanges]) -> PathSettings:
    """The settings a printer's file says, with changes. Raises InputError for a printer without a nozzle."""
    if printer.nozzle_mm is None:
        raise InputError(f"printer {printer.name} ({printer.process}) has no nozzle; choose an FDM printer")
    known: dict[str, object] = {
        "nozzle_mm": printer.nozzle_mm,
        "width_mm": printer.extrusion_width_mm or 1.125 * printer.nozzle_mm,
        "first_layer_width_mm": printer.first_layer_width_mm,
        "width_range_mm": printer.width_range_mm,
    }
    return PathSettings(**{**known, **changes})  # type: ignore[arg-type]  # checked when made
