"""How long moves take: the look-ahead of a printer's firmware, move by move.

Every move speeds up, cruises and slows down (a trapezoid), within the limits of each axis. Between two moves the
nozzle may be as fast as the corner allows:

  classic jerk        (Marlin 1, Prusa's firmware) no axis may change its speed at once by more than its jerk; the
                      speeds compared are those at the slower of the two feedrates
  junction deviation  (Marlin 2, Klipper) as fast as a circle that touches both moves and stays that far inside the
                      corner could be driven at the acceleration: v² = a·d·s / (1 − s), s = sin(half the angle)

Then a backward pass over all moves keeps every speed low enough to stop in time, and a forward pass reachable. Axes
are X, Y, Z and E (the filament). Sources: Marlin's planner documentation; S. Jeon, "Improving Grbl's cornering
algorithm" (2011); Klipper's "Kinematics" page.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.printers import Printer

    Floats = NDArray[np.float64]

MOVES = types.Array(types.float64, 2, "C", readonly=True)
NUMBERS = types.Array(types.float64, 1, "C", readonly=True)
OUT = types.Array(types.float64, 1, "C")
# What a printer's file may leave out: those of an unmodified Marlin for a small printer.
USUAL_MM_S = (200.0, 200.0, 12.0, 60.0)
USUAL_MM_S2 = (3000.0, 3000.0, 200.0, 5000.0)
USUAL_JERK_MM_S = (8.0, 8.0, 0.4, 5.0)


@dataclass(frozen=True)
class Limits:
    """Of X, Y, Z and E: fastest, steepest, and what they may change at once; with a junction deviation the last is
    that of E only."""

    mm_s: tuple[float, ...] = USUAL_MM_S
    mm_s2: tuple[float, ...] = USUAL_MM_S2
    jerk_mm_s: tuple[float, ...] = USUAL_JERK_MM_S
    junction_deviation_mm: float = 0.0


def limits_of(printer: Printer) -> Limits:
    """A printer's limits, or the usual ones where its file does not say."""
    return Limits(
        printer.axis_mm_s or USUAL_MM_S,
        printer.axis_mm_s2 or USUAL_MM_S2,
        printer.axis_jerk_mm_s or USUAL_JERK_MM_S,
        printer.junction_deviation_mm or 0.0,
    )


@njit
def _by_jerk(unit, speed, i, jerk):  # type: ignore[no-untyped-def]  # numba types it
    """Speed from move i − 1 into move i: as much of the slower cruise as no axis' jerk forbids. An axis that turns
    round stops in between, so each of its two speeds counts by itself."""
    slower = min(speed[i - 1], speed[i])
    share = 1.0
    for k in range(4):
        out, into = unit[i - 1, k] * slower, unit[i, k] * slower
        change = max(abs(out), abs(into)) if out * into < 0 else abs(out - into)
        if change * share > jerk[k]:
            share = jerk[k] / change
    return slower * share


@njit
def _by_deviation(unit, speed, i, deviation, acceleration, jerk_e):  # type: ignore[no-untyped-def]  # numba types it
    """Speed from move i − 1 into move i by the circle inside the corner, and by the jerk of E."""
    slower = min(speed[i - 1], speed[i])
    change = abs(unit[i, 3] - unit[i - 1, 3]) * slower
    if change > jerk_e:
        slower *= jerk_e / change
    cosine = 0.0
    for k in range(3):
        cosine -= unit[i - 1, k] * unit[i, k]
    if cosine > 0.999999:  # back where it came from
        return 0.0
    half_sine = math.sqrt(max(0.5 * (1 - cosine), 0.0))  # of half the angle between the moves
    if half_sine > 0.999999:
        return slower
    return min(slower, math.sqrt(acceleration * deviation * half_sine / (1 - half_sine)))


@njit
def _safe(unit, speed, i, jerk):  # type: ignore[no-untyped-def]  # numba types it
    """Speed that a move may have from standstill at once."""
    safe = speed[i]
    for k in range(4):
        if abs(unit[i, k]) * safe > jerk[k]:
            safe = jerk[k] / abs(unit[i, k])
    return safe


@njit(OUT(MOVES, NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS, types.float64), cache=True, nogil=True)
def _seconds(delta, mm_s, mm_s2, most_mm_s, most_mm_s2, jerk, deviation):  # type: ignore[no-untyped-def]  # numba types it
    n = delta.shape[0]
    out, unit = np.zeros(n), np.zeros((n, 4))
    length, speed, slope, entry = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n + 1)
    last = -1
    kept = np.empty(n, np.int64)  # moves that go anywhere
    m = 0
    for i in range(n):
        way = math.sqrt(delta[i, 0] ** 2 + delta[i, 1] ** 2 + delta[i, 2] ** 2)
        if way < 1e-9:
            way = abs(delta[i, 3])
        if way < 1e-9:
            continue
        kept[m], length[m], speed[m], slope[m] = i, way, mm_s[i], mm_s2[i]
        for k in range(4):
            unit[m, k] = delta[i, k] / way
            share = abs(unit[m, k])
            if share > 0:
                speed[m] = min(speed[m], most_mm_s[k] / share)
                slope[m] = min(slope[m], most_mm_s2[k] / share)
        m += 1
    for i in range(m):
        safe = _safe(unit, speed, i, jerk) if deviation == 0 else 0.0
        if i == 0:
            entry[i] = safe
        elif deviation == 0:
            entry[i] = max(_by_jerk(unit, speed, i, jerk), min(safe, _safe(unit, speed, i - 1, jerk)))
        else:
            entry[i] = _by_deviation(unit, speed, i, deviation, min(slope[i - 1], slope[i]), jerk[3])
        last = i
    if last >= 0:
        entry[m] = _safe(unit, speed, m - 1, jerk) if deviation == 0 else 0.0
    for i in range(m - 1, -1, -1):
        entry[i] = min(entry[i], math.sqrt(entry[i + 1] ** 2 + 2 * slope[i] * length[i]))
    for i in range(m):
        entry[i + 1] = min(entry[i + 1], math.sqrt(entry[i] ** 2 + 2 * slope[i] * length[i]))
        top = min(speed[i], math.sqrt((2 * slope[i] * length[i] + entry[i] ** 2 + entry[i + 1] ** 2) / 2))
        ramps = (2 * top * top - entry[i] ** 2 - entry[i + 1] ** 2) / (2 * slope[i])
        out[kept[i]] = (2 * top - entry[i] - entry[i + 1]) / slope[i] + max(length[i] - ramps, 0.0) / top
    return out


def move_seconds(delta_mm: Floats, mm_s: Floats, mm_s2: Floats, limits: Limits) -> Floats:
    """(n,) seconds of each of n moves in a row, from standstill to standstill.

    delta_mm  (n, 4) X, Y, Z and E of each move; a move of nothing takes no time
    mm_s      (n,) feedrates along X, Y, Z, or E where nothing else moves
    mm_s2     (n,) accelerations wanted
    """
    seconds: Floats = _seconds(
        np.ascontiguousarray(delta_mm, np.float64),
        np.ascontiguousarray(mm_s, np.float64),
        np.ascontiguousarray(mm_s2, np.float64),
        np.array(limits.mm_s, np.float64),
        np.array(limits.mm_s2, np.float64),
        np.array(limits.jerk_mm_s, np.float64),
        limits.junction_deviation_mm,
    )
    return seconds
