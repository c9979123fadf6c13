"""What a user should know of the G-code that was written, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from layerfix.fdm.speeds import written_time
from layerfix.units import format_mm

if TYPE_CHECKING:
    from layerfix.fdm.beads import Hanging

SHOWN = 3  # places in a sentence; the others are counted


def amounts(seconds: float, filament_mm: float) -> str:
    """How long it takes and how much filament."""
    return f"printing takes about {written_time(seconds)} and {filament_mm / 1000:.3g} m of filament"


def small_parts(count: int, first_z_mm: float) -> str:
    """That there are parts smaller than a bead."""
    return (
        f"{count} parts of layers are smaller than a bead and come out larger, the first at z ="
        f" {format_mm(first_z_mm)}"
    )


def over_air(places: Sequence[tuple[float, Hanging]]) -> list[str]:
    """A sentence each for islands, bridges and ledges, the longest first; places are (top of layer in mm, place)."""
    said = {
        "island": ("begins in mid-air, with nothing below it", "begin in mid-air, with nothing below them"),
        "bridge": ("spans air", "span air"),
        "ledge": ("reaches out over air, held at one side", "reach out over air, held at one side"),
    }
    out = []
    for kind, (one, many) in said.items():
        chosen = sorted((item for item in places if item[1].kind == kind), key=lambda item: -item[1].length_mm)
        if chosen:
            shown = "; ".join(_place(z, place) for z, place in chosen[:SHOWN])
            more = f"; and {len(chosen) - SHOWN} more" if len(chosen) > SHOWN else ""
            what = f"1 {kind} {one}" if len(chosen) == 1 else f"{len(chosen)} {kind}s {many}"
            help = " (no supports are laid)" if kind != "bridge" else ""
            out.append(f"{what}{help}: {shown}{more}")
    return out


def _place(z_mm: float, place: Hanging) -> str:
    x_mm, y_mm = round(place.x_mm, 2) + 0.0, round(place.y_mm, 2) + 0.0  # and no -0
    return f"{place.length_mm:.3g} mm at z = {z_mm:.4g}, x = {x_mm:g}, y = {y_mm:g} mm"
