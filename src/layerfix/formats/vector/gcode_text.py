"""Moves → lines of G-code, with the comments that PrusaSlicer writes, in the printer's dialect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from layerfix.fdm.beads import BRIDGE, KINDS
from layerfix.formats.vector.gcode_lines import lines_of_moves

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.fdm.moves import Moves
    from layerfix.printers import Printer

    Indices = NDArray[np.int64]

BRIDGE_KIND = KINDS.index(BRIDGE)


@dataclass
class Text:
    """What the printer was told last, and the lines that follow from that."""

    printer: Printer
    e_mm: float = 0.0
    kind: int = -1
    fan: float = 0.0  # percent
    usual_fan: float = 0.0

    @property
    def relative(self) -> bool:
        return bool(self.printer.relative_extrusion)

    def layer(self, moves: Moves, z_mm: tuple[float, float]) -> bytes:
        """All lines of a layer; `;TYPE:`, `;WIDTH:`, the feedrate and the fan where they change."""
        bottom, top = z_mm
        head = f";LAYER_CHANGE\n;Z:{top:.6g}\n;HEIGHT:{top - bottom:.6g}\n"
        if not self.relative:
            head += "G92 E0\n"
            self.e_mm = 0.0
        e = moves.e_mm if self.relative else self.e_mm + np.cumsum(moves.e_mm)
        self.e_mm = float(e[-1])
        feedrate = np.rint(60 * moves.mm_s)
        data, starts = lines_of_moves(moves.kind, moves.to_mm, e, feedrate)
        lines, pieces, written = data.tobytes(), [head.encode()], 0
        for k, before in self._told(moves, feedrate):
            pieces += [lines[written : starts[k]], before.encode()]
            written = starts[k]
        return b"".join([*pieces, lines[written:]])

    def _told(self, moves: Moves, feedrate: NDArray[np.float64]) -> list[tuple[int, str]]:
        """(move, lines before it) of all beads before which something changes."""
        laid = np.flatnonzero(moves.lays)
        kind, width = moves.kind[laid], moves.width_mm[laid]
        new_kind = np.diff(kind, prepend=self.kind) != 0
        new_width = np.diff(width, prepend=0.0) != 0  # said again on every layer
        new_speed = feedrate[laid] != np.where(laid > 0, feedrate[laid - 1], np.nan)
        out = []
        for k in np.flatnonzero(new_kind | new_width | new_speed).tolist():
            text = f";TYPE:{KINDS[kind[k]]}\n" if new_kind[k] else ""
            text += self._fan_for(int(kind[k])) if new_kind[k] else ""
            text += f";WIDTH:{width[k]:.6g}\n" if new_width[k] else ""
            out.append((int(laid[k]), text + (f"G1 F{feedrate[laid[k]]:.0f}\n" if new_speed[k] else "")))
        self.kind = int(kind[-1])
        return out

    def _fan_for(self, kind: int) -> str:
        """Full on bridges and back after them; a printer that is not to use its fan does not."""
        wanted = 100.0 if kind == BRIDGE_KIND and self.printer.fan_percent else self.usual_fan
        if wanted == self.fan:
            return ""
        self.fan = wanted
        return f"{fan(self.printer, wanted)}\n"

    def after_first_layer(self) -> str:
        """The temperatures and the fan of all other layers."""
        printer, lines = self.printer, []
        if printer.nozzle_c is not None and printer.nozzle_c != printer.first_layer_nozzle_c:
            lines.append(f"M104 S{printer.nozzle_c:g}")
        if printer.bed_c is not None and printer.bed_c != printer.first_layer_bed_c:
            lines.append(f"M140 S{printer.bed_c:g}")
        if printer.fan_percent:
            lines.append(fan(printer, printer.fan_percent))
            self.fan = self.usual_fan = printer.fan_percent
        return "".join(f"{line}\n" for line in lines)


def fan(printer: Printer, percent: float) -> str:
    """M106 with the share that RepRapFirmware takes, or the 0 to 255 of the others; M107 is off."""
    if not percent:
        return "M106 S0" if printer.gcode_flavor == "reprap" else "M107"
    return f"M106 S{percent / 100:.2f}" if printer.gcode_flavor == "reprap" else f"M106 S{2.55 * percent:.0f}"


def acceleration(printer: Printer) -> str:
    """M204 in the printer's dialect: Marlin 2 and RepRapFirmware tell printing and travel apart."""
    value = printer.acceleration_mm_s2
    if value is None:
        return ""
    travel = printer.travel_acceleration_mm_s2 or value
    return f"M204 P{value:g} T{travel:g}" if printer.gcode_flavor in ("marlin2", "reprap") else f"M204 S{value:g}"
