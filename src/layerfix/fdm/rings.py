"""One round of planning a layer: loops and chains of what remains, and where it is thick (see `layer_plan`)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.bits import pack, unpack
from layerfix.fdm.chains import lengths_of
from layerfix.fdm.fields import (
    NO_LEVEL,
    bits_above,
    bits_higher,
    bits_unexplained,
    half_spacings,
    middles,
    paint_balls,
    paint_ends,
    pixels_of,
    smoothed,
)
from layerfix.fdm.level_sets import level_loops
from layerfix.fdm.single_beads import bead_lines
from layerfix.layers.components import components_at, smaller_than
from layerfix.layers.flood import flood
from layerfix.layers.morphology import dilate
from layerfix.layers.skeleton import thinned_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

    Field = NDArray[np.float32]
    Floats = NDArray[np.float64]

# Loops follow the blurred distance: by itself it ripples by 0.3 px along stairs of pixels. Where it is thin blurring
# would move them.
SMOOTH_PX = 1.5
WEIGHTS = np.exp(-0.5 * (np.arange(round(4 * SMOOTH_PX) + 1) / SMOOTH_PX) ** 2).astype(np.float32)
WEIGHTS /= 2 * WEIGHTS.sum() - WEIGHTS[0]
SPOT = 25.0  # thick parts of fewer square spacings than this get no infill
# Square spacings inside a loop that is no loop where single beads come together: in walls, and in what they leave.
KNOT, SMALL_KNOT = 2.0, 1.0
SHORTEST_LOOP = 0.6  # of the narrowest spacing: a shorter one is left out
LEAST_GAP = 0.7  # of the narrowest spacing: what is thinner is left open


@dataclass(frozen=True)
class Beads:
    """The spacings of a layer in mm: usual, narrowest, widest, and what is added to a spacing for a width."""

    usual: float
    narrowest: float
    widest: float
    overlap: float

    @property
    def range(self) -> tuple[float, float]:
        """The narrowest and the widest."""
        return self.narrowest, self.widest

    @property
    def one(self) -> float:
        """Thinner places get one bead."""
        return min(2 * self.narrowest, self.widest)

    @property
    def thick(self) -> float:
        """From this thickness on, two usual beads leave room for another."""
        return 2 * self.usual + self.narrowest


@dataclass(frozen=True)
class Ring:
    """What one round of planning found: loops and chains (n, 3) of x, y in px and spacing in mm, and packed, where
    it is thick."""

    loops: list[Floats]
    chains: list[Floats]
    thick: Rows


def plan_ring(remaining: Field, half: Field, beads: Beads, pixel_mm: float, *, loops: bool, feature: bool) -> Ring:
    """One round (see the module); `half` is written. loops: False leaves thick parts to infill; feature: nothing is
    too thin to lay."""
    usual = np.float32(beads.usual / 2) if loops else NO_LEVEL
    region = bits_above(remaining, np.float32(0))
    if not region.any():
        half[:] = usual
        return Ring([], [], region)
    width, radius_px = remaining.shape[1], beads.thick / 2 / pixel_mm
    anchor = bits_above(remaining, np.float32(beads.thick / 2))
    skeleton = thinned_rows(region, anchor, width, radius_px)
    thick = dilate(anchor, width, (radius_px, radius_px)) & region
    local = np.zeros(remaining.shape, np.float32)
    chains: list[Floats] = []
    rows, columns = pixels_of(skeleton & ~anchor)
    middle = middles(remaining, skeleton, rows, columns)
    thickness = np.ascontiguousarray(middle[:, 0])
    paint_balls(local, rows, columns, thickness / np.float32(2 * pixel_mm), thickness)
    _paint_lobes(local, remaining, thick, beads, pixel_mm)
    if not loops:  # a spot a little thicker than two beads is laid with them, rather than with stubs of infill
        spots = smaller_than(thick, SPOT * (beads.usual / pixel_mm) ** 2)
        thick &= ~spots
        local[pixels_of(spots)] = beads.thick
    paint_ends(local, skeleton, rows, columns, thickness, radius_px)
    half_spacings(half, local, thick, np.float32(beads.one), np.float32(2 * beads.widest), usual)
    # Without loops no level lies where it is thick.
    reach_mm = np.float32(len(WEIGHTS) * pixel_mm)
    smooth = smoothed(remaining, half, thick, WEIGHTS, reach_mm) if loops else remaining
    inside = bits_higher(smooth, half)
    chosen = thickness < beads.one
    if chosen.any():
        knot_px = (KNOT if feature else SMALL_KNOT) * (beads.usual / pixel_mm) ** 2
        chosen |= _single_knots(inside, half, rows, columns, chosen, beads, pixel_mm, knot_px)
    points, starts = level_loops(smooth, half, inside)
    if not feature:
        chosen &= thickness >= LEAST_GAP * beads.narrowest
    if chosen.any():
        line = rows[chosen], columns[chosen], middle[chosen]
        blocked = unpack(thick | inside, width)
        chains = bead_lines(*line, np.where(blocked, 0, remaining), pixel_mm, beads.range, dots=feature)
    points[:, 2] *= 2
    long = (lengths_of(points, starts) > SHORTEST_LOOP * beads.narrowest / pixel_mm).tolist()
    bounds = zip(pairwise(starts.tolist()), long, strict=True)
    return Ring([np.concatenate([points[a:b], points[a : a + 1]]) for (a, b), kept in bounds if kept], chains, thick)


def _single_knots(
    inside: Rows,
    half: Field,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    single: NDArray[np.bool_],
    beads: Beads,
    pixel_mm: float,
    knot_px: float,
) -> NDArray[np.bool_]:
    """Which pixels of the skeleton, (n,), lie in knots: places for two beads, but so small that their loop would be a
    dot, where single ones come together. Those go on through them. `inside` and `half` forget their loops.
    """
    width = half.shape[1]
    knots = smaller_than(inside, knot_px)
    if not knots.any():
        return np.zeros(len(rows), np.bool_)
    arms = np.zeros(half.shape, np.bool_)
    arms[rows[single], columns[single]] = True
    reach = beads.one / 2 / pixel_mm + 1.5
    lines = pack(arms)
    lines &= ~smaller_than(lines, beads.usual / pixel_mm)
    knots &= flood(dilate(lines, width, (reach, reach)), knots)
    half[pixels_of(knots)] = NO_LEVEL
    inside &= ~knots
    near = unpack(dilate(knots, width, (reach, reach)), width)
    return np.asarray(near[rows, columns])


def _paint_lobes(local: Field, remaining: Field, thick: Rows, beads: Beads, pixel_mm: float) -> None:
    """Add what the skeleton does not know: lobes beyond a neck whose branch was shortened away as a spur.

    The deepest pixel of each such part tells its thickness. Corners of thick parts are none. Lobes that hold one bead
    only are reached by the neck's own.
    """
    width = remaining.shape[1]
    for _ in range(4):  # behind a lobe may be another
        parts = bits_unexplained(remaining, local, thick, np.float32(beads.one / 2), np.float32(pixel_mm / 2))
        if not parts.any():
            return
        parts &= ~flood(dilate(thick, width, (1.5, 1.5)), parts)
        rows, columns = pixels_of(parts)
        if not len(rows):
            return
        part, _ = components_at(parts, columns, rows)
        order = np.lexsort((-remaining[rows, columns], part))
        deepest = order[np.flatnonzero(np.diff(part[order], prepend=-1))]
        rows, columns = rows[deepest], columns[deepest]
        thickness = 2 * remaining[rows, columns]
        paint_balls(local, rows, columns, thickness / np.float32(2 * pixel_mm), thickness)
