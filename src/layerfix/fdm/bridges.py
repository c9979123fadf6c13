"""What of a layer lies over air: bridges, with the direction in which they are laid, ledges and islands.

A bead over air holds if both its ends lie on something, and sags the less the shorter it is. So for each region
without anything below, lines are tried in all directions (every 5°): the best has most of its length in lines that
are held at both ends, and among those that are about as good, the one with the shortest spans.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ROWS, U0, U1
from layerfix.fdm.beads import Hanging
from layerfix.kernels import njit
from layerfix.layers.components import smaller_than
from layerfix.layers.flood import flood
from layerfix.layers.morphology import dilate, erode, opened

if TYPE_CHECKING:
    from layerfix.bits import Rows
    from layerfix.stack import Layer, LayerStack

DIRECTIONS = 36
LEAST_BEADS = 1.5  # wide is what counts as over air: overhangs that lie on half a bead hold by themselves
RIM_PX = 2.0, 2.0  # half of 0.25 mm on the usual raster: what is narrower is no bridge, and no island that is laid
ANCHOR_BEADS = 2.0  # by which a bridge reaches over what holds it
ALIKE = 1.02  # spans that differ by less are told apart by chance; 10° off a rectangle's side they are 1.5 % longer
HELD = 0.05  # of its length may be held less well, if the spans are shorter
# What is told: shorter ones come out well without care (the roof of the 3DBenchy, made to print without supports,
# spans 13.7 mm); a ledge of 2 mm droops.
TOLD_BRIDGE_MM, TOLD_LEDGE_MM = 15.0, 2.0
REGION = types.Tuple((types.float64, types.float64, types.float64, types.float64))


@dataclass(frozen=True, eq=False)
class Bridge:
    """Where beads are laid over air in one direction: rows packed, with what holds their ends; angle in radians from
    x to y of the image."""

    rows: Rows
    over_air: Rows
    angle: float


@dataclass(frozen=True, eq=False)
class OverAir:
    """What of a layer has nothing below it."""

    bridges: tuple[Bridge, ...] = ()
    hanging: tuple[Hanging, ...] = ()


@njit
def _at(rows, x, y):  # type: ignore[no-untyped-def]  # numba types it
    i, j = math.floor(x), math.floor(y)
    if i < 0 or j < 0 or j >= rows.shape[0] or i >= rows.shape[1] * 64:
        return False
    return (rows[j, i >> 6] >> np.uint64(i & 63)) & U1 != U0


@njit
def _held(held, x, y, dx, dy, reach):  # type: ignore[no-untyped-def]  # numba types it
    """Whether something holds a bead within `reach` px of its end."""
    found = False
    for k in range(1, reach + 1):
        found = found or _at(held, x + k * dx, y + k * dy)
    return found


@njit
def _lines(region, held, angle, step, reach):  # type: ignore[no-untyped-def]  # numba types it
    """(length in all, of lines held at both ends, at one; how long they are, the long ones counting most; the longest
    held at both, at one) of lines `step` px apart through a region."""
    height, width = region.shape[0], region.shape[1] * 64
    dx, dy = math.cos(angle), math.sin(angle)
    half = math.hypot(width, height) / 2
    total, both, one, longest_both, longest_one = 0.0, 0.0, 0.0, 0.0, 0.0
    fifth, sixth = 0.0, 0.0  # their plain mean would be less for lines aslant, which cut corners short
    for line in range(-int(half / step), int(half / step) + 1):
        px, py = width / 2 - line * step * dy, height / 2 + line * step * dx
        t0, t1 = -half, half
        for p, d, size in ((px, dx, float(width)), (py, dy, float(height))):
            if abs(d) > 1e-9:
                t0, t1 = max(t0, min(-p / d, (size - p) / d)), min(t1, max(-p / d, (size - p) / d))
            elif p < 0 or p > size:
                t1 = t0 - 1
        length, t = 0, t0
        while t <= t1 + 1:
            x, y = px + t * dx, py + t * dy
            if t <= t1 and _at(region, x, y):
                length += 1
            elif length:
                ends = int(_held(held, x - dx, y - dy, dx, dy, reach))
                ends += int(_held(held, x - length * dx, y - length * dy, -dx, -dy, reach))
                total += length
                fifth += float(length) ** 5
                sixth += float(length) ** 6
                if ends == 2:
                    both += length
                    longest_both = max(longest_both, float(length))
                elif ends == 1:
                    one += length
                    longest_one = max(longest_one, float(length))
                length = 0
            t += 1.0
    return total, both, one, sixth / fifth if fifth else 0.0, longest_both, longest_one


@njit(REGION(ROWS, ROWS, types.float64, types.int64), cache=True, nogil=True)
def best_direction(region, held, step, reach):  # type: ignore[no-untyped-def]  # numba types it
    """(angle, share of the length in lines held at both ends, longest line held at both, at one end), in px.

    region  packed rows over air
    held    packed rows that lie on something
    step    px between the lines that are tried
    reach   px beyond a line's end within which it is held
    """
    score, span = np.zeros(DIRECTIONS), np.zeros(DIRECTIONS)
    found = np.zeros((DIRECTIONS, 3))
    for k in range(DIRECTIONS):
        total, both, one, long, longest_both, longest_one = _lines(
            region, held, k * math.pi / DIRECTIONS, step, reach
        )
        if total:
            score[k], span[k] = (both + 0.3 * one) / total, long
            found[k, 0], found[k, 1], found[k, 2] = both / total, longest_both, longest_one
    highest = 0.0  # (score.max() would load scipy.linalg, by way of numba: 0.3 s)
    for k in range(DIRECTIONS):
        highest = max(highest, score[k])
    chosen = -1
    for k in range(DIRECTIONS):
        if span[k] and score[k] >= highest - HELD and (chosen < 0 or span[k] < span[chosen]):
            chosen = k
    if chosen < 0:
        return 0.0, 0.0, 0.0, 0.0
    run = np.zeros(2)  # of directions about as good, down and up from there: the middle one is meant
    for side in range(2):
        for k in range(1, DIRECTIONS // 4):
            other = (chosen + (k if side else -k)) % DIRECTIONS
            if not span[other] or score[other] < highest - HELD or span[other] > ALIKE * span[chosen]:
                break
            run[side] = k
    angle = (chosen + (run[1] - run[0]) / 2) % DIRECTIONS * math.pi / DIRECTIONS
    return angle, found[chosen, 0], found[chosen, 1], found[chosen, 2]


def over_air(below: Layer | None, layer: Layer, stack: LayerStack, bead_mm: float) -> OverAir:
    """Bridges, ledges and islands of a layer.

    below  the layer that it lies on; None if there is only air (not for the first layer, which lies on the bed)
    """
    lower = np.zeros_like(layer.rows) if below is None else below.rows
    air = layer.rows & ~lower
    if not air.any() or not erode(air, layer.width, RIM_PX).any():  # a slope's rim, on most layers
        return OverAir()
    islands = layer.rows & ~flood(lower, layer.rows)
    bead_px = bead_mm / stack.pixel_mm[0]
    radius = (LEAST_BEADS / 2 * bead_px,) * 2
    wide = opened(air & ~islands, layer.width, radius)
    hanging = [_island(part, stack) for part in _parts(islands)]
    if not wide.any():
        return OverAir((), tuple(hanging))
    wide &= ~smaller_than(wide, (2 * bead_px) ** 2)
    held = layer.rows & lower
    by_angle: dict[float, Rows] = {}
    for part in _parts(wide):
        y0, y1, w0, w1 = _room(part)
        angle, both, longest, longest_one = best_direction(
            np.ascontiguousarray(part[y0:y1, w0:w1]), np.ascontiguousarray(held[y0:y1, w0:w1]), bead_px / 2,
            math.ceil(bead_px),
        )  # fmt: skip
        by_angle[angle] = by_angle[angle] | part if angle in by_angle else part
        kind, length_mm = ("bridge", longest) if both >= 0.5 else ("ledge", longest_one)
        length_mm *= stack.pixel_mm[0]
        if length_mm > (TOLD_BRIDGE_MM if kind == "bridge" else TOLD_LEDGE_MM):
            hanging.append(Hanging(kind, *_middle_mm(part, stack), length_mm))
    reach = (ANCHOR_BEADS * bead_px,) * 2
    bridges = tuple(
        Bridge(dilate(rows, layer.width, reach) & layer.rows, rows, angle) for angle, rows in by_angle.items()
    )
    return OverAir(bridges, tuple(hanging))


def _parts(rows: Rows) -> list[Rows]:
    """Each component of packed rows by itself."""
    parts, rest = [], rows
    while rest.any():
        y = int(np.flatnonzero(rest.any(axis=1))[0])
        w = int(np.flatnonzero(rest[y])[0])
        seed = np.zeros_like(rows)
        seed[y, w] = rest[y, w] & (~rest[y, w] + U1)
        part = flood(seed, rest)
        parts.append(part)
        rest = rest & ~part
    return parts


def _room(rows: Rows) -> tuple[int, int, int, int]:
    """(first row, past the last, first word, past the last) round the solid, with a word at each side where there is
    one, and as many rows."""
    y, w = np.flatnonzero(rows.any(axis=1)), np.flatnonzero(rows.any(axis=0))
    height, words = rows.shape
    return max(int(y[0]) - 64, 0), min(int(y[-1]) + 65, height), max(int(w[0]) - 1, 0), min(int(w[-1]) + 2, words)


def _box_px(rows: Rows) -> tuple[float, float, float, float]:
    """(x0, y0, x1, y1) round the solid."""
    y = np.flatnonzero(rows.any(axis=1))
    bits = np.bitwise_or.reduce(rows, axis=0).astype("<u8").view(np.uint8)
    x = np.flatnonzero(np.unpackbits(bits, bitorder="little"))
    return float(x[0]), float(y[0]), float(x[-1] + 1), float(y[-1] + 1)


def _middle_mm(rows: Rows, stack: LayerStack) -> tuple[float, float]:
    x0, y0, x1, y1 = _box_px(rows)
    (px, py), (ox, oy) = stack.pixel_mm, stack.origin_mm
    return ox + (x0 + x1) / 2 * px, oy - (y0 + y1) / 2 * py


def _island(rows: Rows, stack: LayerStack) -> Hanging:
    x0, y0, x1, y1 = _box_px(rows)
    size_mm = max((x1 - x0) * stack.pixel_mm[0], (y1 - y0) * stack.pixel_mm[1])
    return Hanging("island", *_middle_mm(rows, stack), size_mm)
