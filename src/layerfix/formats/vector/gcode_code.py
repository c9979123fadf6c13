"""A printer's start and end code: with its temperatures in it, and which moves it makes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from layerfix.printers import GCODE_PLACEHOLDERS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.printers import Printer

    Floats = NDArray[np.float64]

WORD = re.compile(r"([XYZEF])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
USUAL_MM_S = 25.0  # of moves before any feedrate is said


def filled(text: str, printer: Printer) -> str:
    """Start or end G-code with the printer's temperatures in it.

    A line whose temperature the printer's file does not say is left out, with a word.
    """
    lines = []
    for line in text.splitlines():
        for placeholder in GCODE_PLACEHOLDERS:
            value = getattr(printer, placeholder.strip("{}"))
            if placeholder in line:
                line = f"; {line} (unknown)" if value is None else line.replace(placeholder, f"{value:g}")
        lines.append(line)
    return "\n".join(lines)


def moves_of_code(text: str, at_mm: Floats) -> tuple[Floats, Floats, Floats]:
    """((n, 4) X, Y, Z and E of each G0 and G1, (n,) their feedrates in mm/s, (3,) where they end).

    at_mm  (3,) where the nozzle is before. What else the code does (homing, levelling, heating) moves nothing here.
    """
    at = dict(zip("XYZE", [*at_mm.tolist(), 0.0], strict=True))
    speed, absolute, absolute_e = USUAL_MM_S, True, True
    deltas, speeds = [], []
    for line in text.upper().splitlines():
        code = line.partition(";")[0]
        command = (code.split() or [""])[0]
        words = {key: float(value) for key, value in WORD.findall(code[len(command) :])}
        if command in ("G90", "G91"):
            absolute = command == "G90"
            absolute_e = absolute if command == "G91" else absolute_e
        elif command in ("M82", "M83"):
            absolute_e = command == "M82"
        elif command == "G92":
            at.update({key: value for key, value in words.items() if key in at})
        elif command in ("G0", "G1", "G00", "G01"):
            speed = words.pop("F", 60 * speed) / 60 or USUAL_MM_S
            after = {key: value + (0.0 if (absolute_e if key == "E" else absolute) else at[key])
                     for key, value in words.items()}  # fmt: skip
            deltas.append([after.get(key, value) - value for key, value in at.items()])
            speeds.append(speed)
            at.update(after)
    return np.array(deltas).reshape(-1, 4), np.array(speeds), np.array([at[key] for key in "XYZ"])
