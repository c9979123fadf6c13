"""G-code → the beads of its layers: our own, and that of PrusaSlicer, OrcaSlicer, slic3r and Cura.

Widths come from `;WIDTH:` comments, else from E: its volume over the length is the bead's cross-section.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path as FilePath

import numpy as np

from layerfix.errors import InputError
from layerfix.fdm.beads import LayerPaths, Path, overlap_mm
from layerfix.files import reading

WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
REST = re.compile(r"\([^)]*\)|\*\s*\d+|N\d+|\s")  # what else a move may hold: remarks, a checksum, its line's number
LARGEST = 1e9  # mm: of more, no square is taken
INCH_MM, LENGTHS = 25.4, "XYZEIJR"  # what G20 makes inches of
UNPRINTED = ("custom",)
ARC_STEP = math.pi / 18  # radians
LAYER_MARKS = (";LAYER_CHANGE", ";LAYER:")  # what comes before the first is the start code, with its priming line


@dataclass
class _Laid:
    """A path whose widths may not be known before its layer's height is; nan until then."""

    points: list[tuple[float, float]]
    widths: list[float]
    sections_mm2: list[float]
    kind: str

    def path(self, layer_mm: float) -> Path:
        """Widths that no comment gave follow from the cross-section."""
        widths, sections = np.array(self.widths), np.array(self.sections_mm2)
        known = np.where(np.isnan(widths), sections / layer_mm + overlap_mm(layer_mm), widths)
        return Path(np.array(self.points), known, self.kind)


@dataclass
class _State:
    """The machine, and the path being laid."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    e: float = 0.0
    absolute: bool = True
    absolute_e: bool = True
    kind: str = ""
    width: float | None = None
    height: float | None = None
    layer_z: float | None = None
    printing: bool = True
    points: list[tuple[float, float]] = field(default_factory=list)
    widths: list[float] = field(default_factory=list)
    sections_mm2: list[float] = field(default_factory=list)


def read_gcode(path: str | FilePath, *, filament_mm: float = 1.75) -> list[LayerPaths]:
    """The layers of a G-code file from the bottom up, with the paths in the order they are laid.

    filament_mm  for files without widths that do not say their `filament_diameter`
    Raises InputError for a file that is missing, unreadable, or lays nothing.
    """
    path = FilePath(path)
    with reading(path):
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    filament_mm2 = math.pi * (_filament_mm(path, lines) or filament_mm) ** 2 / 4
    state = _State()
    found: dict[float, list[_Laid]] = {}
    heights: dict[float, float] = {}
    unit_mm = 1.0
    begun = not any(line.startswith(LAYER_MARKS) for line in lines)
    for number, line in enumerate(lines, 1):
        begun = begun or line.startswith(LAYER_MARKS)
        code, _, comment = line.partition(";")
        if comment:
            _comment(state, comment.strip(), found)
        state.printing = begun
        code = code.upper()
        values = {key: float(value) for key, value in WORD.findall(code)}
        if any(abs(value) > LARGEST for value in values.values()):
            raise InputError(f"{path}: line {number} holds a number that is too large")
        if values.get("G") in (0, 1, 2, 3, 92) and REST.sub("", WORD.sub("", code)):
            raise InputError(f"{path}: line {number} is no move that can be read: {_short(code)}")
        if values.get("G") in (20, 21):
            unit_mm = INCH_MM if values["G"] == 20 else 1.0
        elif values:
            measured = {key: value * unit_mm if key in LENGTHS else value for key, value in values.items()}
            _move(state, measured, filament_mm2, found, heights)
    _finish(state, found)
    if not found:
        raise InputError(f"{path}: lays nothing; is it G-code?")
    layers, below = [], 0.0
    for z in sorted(found):
        bottom = z - heights[z] if z in heights else below
        if z <= bottom:
            raise InputError(f"{path}: lays beads at z = {z:g} mm, where there is no room for a layer's height")
        layers.append(LayerPaths((bottom, z), tuple(laid.path(z - bottom) for laid in found[z])))
        below = z
    return layers


def _filament_mm(path: FilePath, lines: list[str]) -> float | None:
    """The diameter that a slicer says among its settings at the end, of the first extruder; None if it does not."""
    line = next((line for line in reversed(lines[-400:]) if "filament_diameter =" in line), None)
    if line is None:
        return None
    text = line.partition("filament_diameter =")[2].partition(",")[0].strip()
    if not re.fullmatch(r"\d{0,6}\.?\d{1,9}|\d{1,6}\.", text) or not float(text):
        raise InputError(f"{path}: filament_diameter = {_short(text)} is no length in mm")
    return float(text)


def _short(text: str) -> str:
    """Not all of a line that somebody has made long."""
    text = text.strip()
    return text if len(text) <= 60 else f"{text[:57]}..."


def _comment(state: _State, text: str, found: dict[float, list[_Laid]]) -> None:
    key, _, value = text.partition(":")
    if key == "TYPE":
        _finish(state, found)
        state.kind = value
    elif key in ("WIDTH", "HEIGHT"):
        try:
            length = float(value)
        except ValueError:
            return
        setattr(state, key.lower(), length if 0 < length < math.inf else None)  # neither nan nor a width below 0


def _move(
    state: _State,
    words: dict[str, float],
    filament_mm2: float,
    found: dict[float, list[_Laid]],
    heights: dict[float, float],
) -> None:
    command = ("G", words["G"]) if "G" in words else ("M", words.get("M", -1))
    if command[0] == "M":
        state.absolute_e = {82: True, 83: False}.get(int(command[1]), state.absolute_e)
        return
    if command[1] in (90, 91):
        state.absolute = command[1] == 90
    elif command[1] == 92:
        state.e = words.get("E", state.e)
        state.x, state.y, state.z = (words.get(k, v) for k, v in zip("XYZ", (state.x, state.y, state.z), strict=True))
    if command[1] not in (0, 1, 2, 3):
        return
    base = (0.0, 0.0, 0.0) if state.absolute else (state.x, state.y, state.z)
    x, y, z = (
        b + words[k] if k in words else v for k, b, v in zip("XYZ", base, (state.x, state.y, state.z), strict=True)
    )
    extruded = (words["E"] - state.e if state.absolute_e else words["E"]) if "E" in words else 0.0
    if state.absolute_e and "E" in words:
        state.e = words["E"]
    stops = [(x, y)] if command[1] < 2 else _arc(state, (x, y), words, clockwise=command[1] == 2)
    length = sum(math.dist(a, b) for a, b in pairwise([(state.x, state.y), *stops]))
    if extruded > 0 and length > 1e-6 and state.printing and state.kind.lower() not in UNPRINTED:
        if state.layer_z != round(z, 4):
            _finish(state, found)
            state.layer_z = round(z, 4)
        if state.height:
            heights[state.layer_z] = state.height
        if not state.points:
            state.points.append((state.x, state.y))
        state.points += stops
        state.sections_mm2 += [extruded * filament_mm2 / length] * len(stops)
        state.widths += [state.width or math.nan] * len(stops)
    elif length > 1e-6:
        _finish(state, found)
    state.x, state.y, state.z = x, y, z


def _arc(
    state: _State, end: tuple[float, float], words: dict[str, float], *, clockwise: bool
) -> list[tuple[float, float]]:
    """Points along G2 or G3, ARC_STEP apart at most, the end the last; straight there without a centre."""
    start = state.x, state.y
    if "R" in words:
        half = math.dist(start, end) / 2
        rise = math.sqrt(max(words["R"] ** 2 - half**2, 0.0)) * (-1 if clockwise == (words["R"] > 0) else 1)
        along = ((end[0] - start[0]) / (2 * half or 1), (end[1] - start[1]) / (2 * half or 1))
        centre = start[0] + along[0] * half - along[1] * rise, start[1] + along[1] * half + along[0] * rise
    else:
        centre = start[0] + words.get("I", 0.0), start[1] + words.get("J", 0.0)
    radius = math.dist(centre, start)
    if radius < 1e-6:
        return [end]
    first = math.atan2(start[1] - centre[1], start[0] - centre[0])
    turn = (math.atan2(end[1] - centre[1], end[0] - centre[0]) - first) % math.tau
    turn = turn or math.tau  # back to where it began: a whole circle
    if clockwise:
        turn -= math.tau if turn < math.tau else 2 * math.tau
    steps = max(math.ceil(abs(turn) / ARC_STEP), 1)
    angles = [first + turn * k / steps for k in range(1, steps)]
    return [*((centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in angles), end]


def _finish(state: _State, found: dict[float, list[_Laid]]) -> None:
    if state.points and state.layer_z is not None:
        laid = _Laid(state.points, state.widths, state.sections_mm2, state.kind or "Unknown")
        found.setdefault(state.layer_z, []).append(laid)
    state.points, state.widths, state.sections_mm2 = [], [], []
