"""How long a printer takes for a G-code file, written anew for the tests: a reader of moves, and look-ahead in plain
Python. It knows nothing of the package."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from itertools import pairwise

AXES = "XYZE"


@dataclass
class Timed:
    """Moves of X, Y, Z and E, each with its feedrate (mm/s) and acceleration; and the limits that the file sets."""

    moves: list[list[float]] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    accelerations: list[float] = field(default_factory=list)
    most: dict[str, list[float]] = field(default_factory=lambda: {code: [math.inf] * 4 for code in LIMITS})

    def seconds(self, most: dict[str, list[float]] | None = None) -> float:
        """From standstill to standstill with the limits of M203, M201 and M205."""
        limits = most or self.most
        return sum(slow_seconds(self.moves, self.speeds, self.accelerations, *(limits[code] for code in LIMITS)))


LIMITS = ("M203", "M201", "M205")  # feedrate, acceleration, jerk of each axis


def timed(text: str, acceleration: float = 1000.0) -> Timed:
    """All G0 and G1 of a file for Marlin: M204 S is of printing and travel, its R of the filament alone."""
    at, out = dict.fromkeys((*AXES, "F"), 0.0), Timed()
    absolute, absolute_e = True, True
    printing = travel = filament = acceleration
    for line in text.splitlines():
        words = line.partition(";")[0].split()
        if not words:
            continue
        given = {w[0]: float(w[1:]) for w in words[1:] if re.fullmatch(r"[A-Z]-?\d*\.?\d+", w)}
        if words[0] in ("M82", "M83"):
            absolute_e = words[0] == "M82"
        elif words[0] in ("G90", "G91"):
            absolute = words[0] == "G90"
        elif words[0] == "G92":
            at.update(given)
        elif words[0] in LIMITS:
            for k, axis in enumerate(AXES):
                out.most[words[0]][k] = given.get(axis, out.most[words[0]][k])
        elif words[0] == "M204":
            printing = given.get("P", given.get("S", printing))
            travel = given.get("T", given.get("S", travel)) if "R" in given or "P" in given else printing
            filament = given.get("R", filament)
        elif words[0] in ("G0", "G1"):
            before = dict(at)
            for axis, number in given.items():
                counts = axis == "F" or (absolute_e if axis == "E" else absolute)
                at[axis] = number if counts else at[axis] + number
            move = [at[axis] - before[axis] for axis in AXES]
            if any(move):
                out.moves.append(move)
                out.speeds.append(at["F"] / 60)
                out.accelerations.append(filament if not any(move[:3]) else printing if move[3] else travel)
    return out


def slow_seconds(moves, speeds, accelerations, most_speed, most_acceleration, jerk, deviation=0.0) -> list[float]:
    """Seconds of each move: what `layerfix.fdm.motion` computes, one formula at a time."""
    ways = [math.hypot(*move[:3]) or abs(move[3]) for move in moves]
    units = [[part / way if way else 0.0 for part in move] for move, way in zip(moves, ways, strict=True)]

    def within(value: float, unit: list[float], most: list[float]) -> float:
        return min([value, *(limit / abs(part) for part, limit in zip(unit, most, strict=True) if part)])

    cruise = [within(s, u, most_speed) for s, u in zip(speeds, units, strict=True)]
    steep = [within(a, u, most_acceleration) for a, u in zip(accelerations, units, strict=True)]
    kept = [k for k, way in enumerate(ways) if way >= 1e-9]
    at_once = {k: 0.0 if deviation else within(cruise[k], units[k], jerk) for k in kept}

    def corner(a: int, b: int) -> float:
        slower = min(cruise[a], cruise[b])
        jumps = []
        for into, out, limit in zip(units[a], units[b], jerk, strict=True):
            jump = max(abs(into), abs(out)) if into * out < 0 else abs(out - into)
            jumps.append(jump * slower / limit)
        if not deviation:
            return max(slower / max(1.0, *jumps), min(at_once[a], at_once[b]))
        slower /= max(1.0, abs(units[a][3] - units[b][3]) * slower / jerk[3])
        cosine = -sum(p * q for p, q in zip(units[a][:3], units[b][:3], strict=True))
        half = math.sqrt(max((1 - cosine) / 2, 0.0))
        if cosine > 0.999999 or half > 0.999999:
            return 0.0 if cosine > 0 else slower
        return min(slower, math.sqrt(min(steep[a], steep[b]) * deviation * half / (1 - half)))

    if not kept:
        return [0.0] * len(moves)
    ends = [at_once[kept[0]], *(corner(a, b) for a, b in pairwise(kept)), at_once[kept[-1]]]
    for n, k in reversed(list(enumerate(kept))):
        ends[n] = min(ends[n], math.sqrt(ends[n + 1] ** 2 + 2 * steep[k] * ways[k]))
    out = [0.0] * len(moves)
    for n, k in enumerate(kept):
        ends[n + 1] = min(ends[n + 1], math.sqrt(ends[n] ** 2 + 2 * steep[k] * ways[k]))
        top = min(cruise[k], math.sqrt(steep[k] * ways[k] + (ends[n] ** 2 + ends[n + 1] ** 2) / 2))
        ramps = ((top**2 - ends[n] ** 2) + (top**2 - ends[n + 1] ** 2)) / (2 * steep[k])
        out[k] = (2 * top - ends[n] - ends[n + 1]) / steep[k] + max(ways[k] - ramps, 0.0) / top
    return out
