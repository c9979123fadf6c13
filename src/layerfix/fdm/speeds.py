"""How fast a printer lays beads, and how long that takes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from layerfix.fdm.beads import (
    BRIDGE,
    EXTERNAL,
    GAP_FILL,
    KINDS,
    PERIMETER,
    SKIRT,
    SOLID,
    SPARSE,
    TOP,
    overlap_mm,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.widths import Widths
    from layerfix.printers import Printer

    Floats = NDArray[np.float64]

# What a printer's file may leave out, with values that any hobby printer takes.
USUAL = {
    "external_perimeter_mm_s": 30.0,
    "perimeter_mm_s": 45.0,
    "infill_mm_s": 60.0,
    "solid_infill_mm_s": 60.0,
    "top_infill_mm_s": 40.0,
    "gap_fill_mm_s": 40.0,
    "bridge_mm_s": 25.0,
    "bridge_flow": 1.0,
    "first_layer_mm_s": 20.0,
    "travel_mm_s": 120.0,
    "acceleration_mm_s2": 1000.0,
    "retract_mm": 0.8,
    "retract_mm_s": 35.0,
    "retract_lift_mm": 0.0,
    "retract_before_travel_mm": 2.0,
    "filament_mm": 1.75,
}
KEY_OF = {
    EXTERNAL: "external_perimeter_mm_s",
    PERIMETER: "perimeter_mm_s",
    SPARSE: "infill_mm_s",
    SOLID: "solid_infill_mm_s",
    TOP: "top_infill_mm_s",
    GAP_FILL: "gap_fill_mm_s",
    SKIRT: "first_layer_mm_s",
    BRIDGE: "bridge_mm_s",
}


@dataclass(frozen=True)
class Speeds:
    """A printer's speeds and what limits them; `value` gives any key of `USUAL`."""

    printer: Printer

    def value(self, key: str) -> float:
        """The printer's, else the usual one."""
        known = getattr(self.printer, key)
        return float(USUAL[key] if known is None else known)

    @property
    def travel_mm_s2(self) -> float:
        """Acceleration of travels: another one only in dialects that can tell it apart."""
        own = self.printer.travel_acceleration_mm_s2
        apart = self.printer.gcode_flavor in ("marlin2", "reprap")
        return own if own and apart else self.value("acceleration_mm_s2")

    def flow(self, kind: str) -> float:
        """Material of a kind of bead, as a share of the usual."""
        return self.value("bridge_flow") if kind == BRIDGE else 1.0

    def bead_mm_s(self, kind: NDArray[np.int64], section_mm2: Floats, *, first_layer: bool) -> Floats:
        """(n,) speeds of beads of these kinds (numbers in KINDS) and cross-sections: slower on the first layer and
        where more would have to melt than can."""
        usual = np.array([self.value(KEY_OF[name]) for name in KINDS])
        if first_layer:
            usual = np.minimum(usual, self.value("first_layer_mm_s"))
        most = self.printer.max_volumetric_speed_mm3_s or math.inf
        speeds: Floats = np.minimum(usual[kind], most / section_mm2)
        return speeds

    def by_area(
        self,
        widths: Widths,
        width_mm: Floats,
        *,
        perimeters: int = 2,
        density: float = 0.2,
        shells: tuple[int, int] = (4, 4),
    ) -> ByArea:
        """What all layers take with these widths, (layers,), before anything is planned.

        A layer's beads are `perimeters` loops along its outlines and infill of `density` in the rest of its area;
        solid is what of its area is more than that of the layers over it and under it (shells: how many of them count
        at the top, at the bottom).
        """
        layer_mm = widths.z_mm[:, 1] - widths.z_mm[:, 0]
        spacing = width_mm - overlap_mm(1.0) * layer_mm
        section = spacing * layer_mm
        loops = np.minimum(perimeters * widths.outline_mm, widths.area_mm2 / spacing)
        outer = np.minimum(widths.outline_mm, loops)
        rest = np.maximum(widths.area_mm2 - loops * spacing, 0)
        solid = np.minimum(rest, widths.area_mm2 - _covered_mm2(widths.area_mm2, *shells))
        first = np.arange(len(widths)) == 0
        most = (self.printer.max_volumetric_speed_mm3_s or math.inf) / section
        total, melting, mm3 = 0.0, 0.0, 0.0
        for kind, length in (
            (EXTERNAL, outer),
            (PERIMETER, loops - outer),
            (SOLID, solid / spacing),
            (SPARSE, (rest - solid) / spacing * density),
        ):
            usual = self.value(KEY_OF[kind])
            wanted = np.where(first, min(usual, self.value("first_layer_mm_s")), usual)
            seconds = length / np.minimum(wanted, most)
            total += float(seconds.sum())
            melting += float(seconds[most < wanted].sum())
            mm3 += float((length * section).sum())
        return ByArea(total, melting, mm3, mm3 / (math.pi * self.value("filament_mm") ** 2 / 4))


@dataclass(frozen=True)
class ByArea:
    """Of laying all beads, without travels, corners and slow small layers: how long, how much of that melting sets
    the pace, material, and length of filament."""

    seconds: float
    melting_s: float
    volume_mm3: float
    filament_mm: float


def _covered_mm2(area_mm2: Floats, above: int, below: int) -> Floats:
    """(layers,) the least area of each layer and so many over and under it; nothing is beyond the ends."""
    padded = np.concatenate([np.zeros(below), area_mm2, np.zeros(above)])
    around = np.lib.stride_tricks.sliding_window_view(padded, above + below + 1)
    covered: Floats = around.min(axis=1) if len(area_mm2) else area_mm2
    return covered


def written_time(seconds: float) -> str:
    """As slicers write it: ``1h 4m 9s``."""
    whole = round(seconds)
    days, hours, minutes = whole // 86400, whole // 3600 % 24, whole // 60 % 60
    parts = [(days, "d"), (hours, "h"), (minutes, "m")]
    first = next((k for k, (n, _) in enumerate(parts) if n), len(parts))
    return " ".join([f"{n}{unit}" for n, unit in parts[first:]] + [f"{whole % 60}s"])
