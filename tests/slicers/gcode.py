"""G-code of PrusaSlicer, slic3r and Cura → the beads it lays, with their widths."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

WORD = re.compile(r"([A-Z])\s*(-?\d*\.?\d+)")
# Kinds of move that are no part of the model, as `;TYPE:` or (slic3r) the move's own comment begins.
NO_PART = ("custom", "skirt", "brim", "support", "prime", "wipe")
SAME_WIDTH_MM = 0.03  # moves of one path whose widths, recovered from E, differ by less are one bead
SHORT_MM = 0.1  # E has five decimals: the width of a shorter move says little


@dataclass
class Bead:
    """One path of one width; `volume_mm3` is what was pushed out along it."""

    z_mm: float
    width_mm: float
    volume_mm3: float
    points: list[tuple[float, float]]


@dataclass
class _State:
    """Where the machine is, and the path it is laying."""

    position: dict[str, float] = field(default_factory=lambda: dict.fromkeys("XYZE", 0.0))
    absolute: bool = True
    absolute_e: bool = True
    kind: str = ""
    width_mm: float | None = None
    height_mm: float | None = None
    beads: list[Bead] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)  # of each bead
    open_path: bool = False


def read_beads(path: Path, *, height_mm: float, filament_mm: float = 1.75, rectangular: bool = False) -> list[Bead]:
    """All beads of a file, in order; see `beads_of`."""
    with path.open(encoding="utf-8", errors="replace") as lines:
        return beads_of(lines, height_mm=height_mm, filament_mm=filament_mm, rectangular=rectangular)


def beads_of(
    lines: Iterable[str], *, height_mm: float, filament_mm: float = 1.75, rectangular: bool = False
) -> list[Bead]:
    """Beads of the part itself, in order.

    lines        G-code; moves are G0 and G1
    height_mm    of a layer, where no `;HEIGHT:` says
    rectangular  Cura's idea of a bead's section, width × height; the others round its two sides. Only used where
                 no `;WIDTH:` says how wide a bead is
    """
    state = _State()
    area_mm2 = math.pi * filament_mm**2 / 4
    for line in lines:
        code, _, comment = line.partition(";")
        if comment:
            _heed_comment(state, comment.strip())
        words = code.split()
        if not words:
            continue
        if words[0] in ("G0", "G1"):
            _move(state, code[len(words[0]) :], comment, area_mm2, height_mm, rectangular)
        elif words[0] in ("M82", "M83"):
            state.absolute_e = words[0] == "M82"
        elif words[0] in ("G90", "G91"):
            state.absolute = words[0] == "G90"
        elif words[0] == "G92":
            state.position.update({axis: float(value) for axis, value in WORD.findall(code) if axis in "XYZE"})
    return state.beads


def _heed_comment(state: _State, comment: str) -> None:
    """What the slicer says of the next moves; anything it says of the beads begins a new one."""
    key, colon, value = comment.partition(":")
    if not colon or key not in ("TYPE", "WIDTH", "HEIGHT", "LAYER", "LAYER_CHANGE"):
        return
    state.open_path = False
    if key == "TYPE":
        state.kind = value.strip().lower()
    elif key == "WIDTH":
        state.width_mm = float(value)
    elif key == "HEIGHT":
        state.height_mm = float(value)


def _move(state: _State, code: str, comment: str, area_mm2: float, height_mm: float, rectangular: bool) -> None:
    """One G0 or G1: a bead, part of one, or the end of one."""
    before = state.position
    after = dict(before)
    pushed = 0.0
    for axis, text in WORD.findall(code):
        value = float(text)
        if axis == "E":
            pushed = value - before["E"] if state.absolute_e else value
            after["E"] = before["E"] + pushed
        elif axis in "XYZ":
            after[axis] = value if state.absolute else before[axis] + value
    state.position = after
    start, end = (before["X"], before["Y"]), (after["X"], after["Y"])
    length = math.dist(start, end)
    kind = state.kind or comment.strip().lower()
    if pushed <= 1e-9 or length <= 1e-6 or kind.startswith(NO_PART):
        state.open_path = state.open_path and length <= 1e-6 and pushed >= 0 and after["Z"] == before["Z"]
        return
    volume = pushed * area_mm2
    width = state.width_mm or bead_width(volume / length, state.height_mm or height_mm, rectangular)
    last = state.beads[-1] if state.open_path else None
    if last is not None and (abs(width - last.width_mm) < SAME_WIDTH_MM or length < SHORT_MM):
        whole = state.lengths[-1] + length
        if state.width_mm is None:
            last.width_mm = (last.width_mm * state.lengths[-1] + width * length) / whole
        last.volume_mm3 += volume
        last.points.append(end)
        state.lengths[-1] = whole
        return
    state.beads.append(Bead(after["Z"], width, volume, [start, end]))
    state.lengths.append(length)
    state.open_path = True


def bead_width(section_mm2: float, height_mm: float, rectangular: bool) -> float:
    """How wide a bead of this section is: a rectangle, or one with half discs for sides."""
    return section_mm2 / height_mm + (0.0 if rectangular else height_mm * (1 - math.pi / 4))
