"""The plan of the metric rule for one F: which erosions of S stand for depths, and how far cones grow between them.

Discs are sums of small elements: cross (radius 1 px), cross + square (2.2), disc 3 (3), + cross (4), + square (5.05),
which is the base of the next four. Up to 5.05 they are exact; their sums are regular 16-gons, round to 1 %. Near 0
there is one level more, of radius 2: without it 4.8 % of strips came out more than 2 px too long or short at d = 8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import types

from layerfix.kernels import know
from layerfix.layers.metric.tiles import CROSS, DISC3, HORIZONTAL, SQUARE, VERTICAL
from layerfix.layers.morphology import disc_half_widths

if TYPE_CHECKING:
    from numpy.typing import NDArray

SLOPE = 2.4  # of the cones: a corner keeps its tip if its full angle is below 2 · asin(1 / SLOPE) = 49°
SLACK_ANCHOR_PX = 1.0  # what pixels allow for when an anchored pixel explains another
SLACK_PX = 0.5  # the same for any other pixel, which must be
DEEPER_PX = 1.3  # this much deeper
STRIP = 8  # columns for each that a strip needs on either side, of which there are two at least
TABLE = types.Array(types.int64, 2, "C", readonly=True)
NUMBERS = types.Array(types.int64, 1, "C", readonly=True)
LENGTHS = types.Array(types.float64, 1, "C", readonly=True)
PLAN = types.Tuple((
    TABLE, NUMBERS, NUMBERS, TABLE, NUMBERS, TABLE, LENGTHS, NUMBERS, types.UniTuple(types.float64, 2), types.float64,
    types.float64, types.int64, types.int64, types.boolean,
))  # fmt: skip
STEPS = 16  # of a cone's growth, after which its elements come again
SPREAD = (0.3, 0.42)  # px; how far depths lie above a level's radius at least, and between two levels on average


@dataclass(frozen=True, eq=False)
class Plan:
    """levels    (n, 2) int64: of each erosion the one it is made from (-1: S itself) and the element
    half_widths  of each level's disc, one after the other, where they are discs of their own (rx ≠ ry), and starts
    schedule     (n, 3) int64: of each level, from the last to the first, the level that joins the cones before it
                 (-1: none), by how many steps it is grown before, and how many steps all grow then
    elements     (STEPS,) int64: what a step grows by
    offsets      (m, 2) int64: dy, dx of pixels by distance; lengths (m,): that distance
    outside      (n,) int64: of each level the first of the offsets that its disc does not hold
    scale        (sy, sx): what turns px into the metric; pixel: a pixel in it; radius: r
    """

    levels: NDArray[np.int64]
    half_widths: NDArray[np.int64]
    starts: NDArray[np.int64]
    schedule: NDArray[np.int64]
    elements: NDArray[np.int64]
    offsets: NDArray[np.int64]
    lengths: NDArray[np.float64]
    outside: NDArray[np.int64]
    scale: tuple[float, float]
    pixel: float
    radius: float

    @property
    def margin_px(self) -> int:
        """How far away a pixel may lie that makes another significant, or not: by its depth and all cones' growth."""
        return math.ceil(self.radius) + 2 + int(self.schedule[:, 1].max() + self.schedule[:, 2].sum())

    @property
    def halo(self) -> int:
        """The same in columns of words."""
        return -(-self.margin_px // 64)

    @property
    def round(self) -> bool:
        """Whether pixels are square."""
        return self.scale == (1.0, 1.0)

    @cached_property
    def numbers(self) -> tuple[Any, ...]:
        """The plan as kernels take it (PLAN), with the margin, a strip's columns, and whether pixels are square."""
        numbers = (
            self.levels, self.half_widths, self.starts, self.schedule, self.elements, self.offsets, self.lengths,
            self.outside, self.scale, self.pixel, self.radius, self.margin_px, STRIP * max(self.halo, 2),
            self.round,
        )  # fmt: skip
        know(numbers, PLAN)
        return numbers


@lru_cache(maxsize=32)
def plan_for(rx: float, ry: float) -> Plan:
    """The plan for F with these radii in px."""
    radius = max(rx, ry)
    sy, sx = radius / ry, radius / rx
    pixel = math.sqrt(sy * sx)
    levels = _levels(radius / pixel)
    elements, step_px = _cone_elements(sy, sx)
    if rx == ry:
        discs = _sums(levels)
        half_widths, starts = np.zeros(0, np.int64), np.zeros(1, np.int64)
    else:
        halves = [disc_half_widths(max(r, 1e-6) * pixel / sx, max(r, 1e-6) * pixel / sy) for r, _, _ in levels]
        discs = [_disc_image(half) for half in halves]
        half_widths, starts = np.concatenate(halves), np.cumsum([0, *map(len, halves)])
    offsets, lengths, outside = _rings(discs, radius, sy, sx)
    return Plan(
        np.array([(parent, element) for _, parent, element in levels], np.int64),
        half_widths,
        starts.astype(np.int64),
        _schedule([r for r, _, _ in levels], radius / pixel, step_px),
        elements,
        offsets,
        lengths,
        outside,
        (sy, sx),
        pixel,
        radius,
    )


def _levels(radius_px: float) -> list[tuple[float, int, int]]:
    """(radius in px, level it is made from, element) of erosions with radii up to 0.4 px below F's."""
    levels = [(0.0, -1, -1)]

    def add(radius: float, parent: int, element: int) -> int:
        levels.append((radius, parent, element))
        return len(levels) - 1

    base, at = 0, 0.0
    while at < radius_px:
        one = add(at + 1.0, base, CROSS)
        if base == 0:
            add(2.0, one, CROSS)
        add(at + 2.2, one, SQUARE)
        three = add(at + 3.0, base, DISC3)
        base = add(at + 5.05, add(at + 4.0, three, CROSS), SQUARE)
        at += 5.05
    return [level for level in levels if level[0] < radius_px - 0.4]


def _cone_elements(sy: float, sx: float) -> tuple[NDArray[np.int64], float]:
    """(elements, mean advance in px) of steps whose sum is nearly a disc in the metric."""
    angle = np.linspace(0, np.pi / 2, 91)
    x, y = np.cos(angle) * sx, np.sin(angle) * sy  # how far one pixel along x, along y reaches in each direction
    reach = {CROSS: np.maximum(x, y), SQUARE: x + y, HORIZONTAL: x, VERTICAL: y}
    total, elements = np.zeros_like(angle), []
    for k in range(STEPS):
        so_far = total
        if sx == sy:
            best = (CROSS, SQUARE)[k % 2]
        else:
            best = min(reach, key=lambda e: float(np.std(so_far + reach[e]) / np.mean(so_far + reach[e])))
        elements.append(best)
        total = total + reach[best]
    return np.array(elements, np.int64), float(total.mean()) / STEPS / math.sqrt(sy * sx)


def _schedule(radii: list[float], radius_px: float, step_px: float) -> NDArray[np.int64]:
    n = len(radii)
    upper = [*radii, radius_px]
    # Depth less half a pixel: of the pixels between two levels on average, and of those above one at least.
    of_level = [upper[k + 1] - 0.5 - max(0.0, (upper[k + 1] - upper[k] - SPREAD[1]) / 2) for k in range(n)]
    above = [r - 0.5 + SPREAD[0] for r in radii] + [radius_px]
    schedule = np.zeros((n, 3), np.int64)
    done, joined = 0, n
    for k in range(n - 1, -1, -1):
        steps = max(round((SLOPE * (radius_px - of_level[k]) + SLACK_ANCHOR_PX) / step_px) - done, 0)
        done += steps
        source, before = -1, 0
        j = k + 1
        while j < n and above[j] < of_level[k] + DEEPER_PX - 0.05:
            j += 1
        if j < joined:
            whole = round((SLOPE * (above[j] - of_level[k]) + SLACK_PX) / step_px)
            source, before, joined = j, max(whole - steps, 0), j
        schedule[k] = source, before, steps
    return schedule


def _sums(levels: list[tuple[float, int, int]]) -> list[NDArray[np.bool_]]:
    """The discs of the levels as images, odd sized around their centre."""
    discs: list[NDArray[np.bool_]] = []
    for _, parent, element in levels:
        if parent < 0:
            discs.append(np.ones((1, 1), bool))
            continue
        reach = 3 if element == DISC3 else 1
        wide = np.pad(discs[parent], 2 * reach)
        size = discs[parent].shape[0] + 2 * reach
        disc = np.zeros((size, size), bool)
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                if element == SQUARE or dx * dx + dy * dy <= reach * reach:
                    disc |= wide[reach + dy : reach + dy + size, reach + dx : reach + dx + size]
        discs.append(disc)
    return discs


def _disc_image(half_widths: NDArray[np.int64]) -> NDArray[np.bool_]:
    reach_x, reach_y = int(half_widths[0]), len(half_widths) - 1
    y, x = np.mgrid[-reach_y : reach_y + 1, -reach_x : reach_x + 1]
    inside: NDArray[np.bool_] = abs(x) <= half_widths[abs(y)]
    return inside


def _rings(
    discs: list[NDArray[np.bool_]], radius: float, sy: float, sx: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    reach_y, reach_x = int(radius / sy) + 3, int(radius / sx) + 3
    y, x = np.mgrid[-reach_y : reach_y + 1, -reach_x : reach_x + 1]
    length = np.hypot(sy * y, sx * x).ravel()
    order = np.argsort(length, kind="stable")
    order = order[length[order] <= radius + 2 * math.sqrt(sy * sx)]
    outside = []
    for disc in discs:
        inside = np.zeros((2 * reach_y + 1, 2 * reach_x + 1), bool)
        ky, kx = disc.shape[0] // 2, disc.shape[1] // 2
        inside[reach_y - ky : reach_y + ky + 1, reach_x - kx : reach_x + kx + 1] = disc
        outside.append(int(np.argmin(inside.ravel()[order])))
    offsets = np.stack([y.ravel()[order], x.ravel()[order]], axis=1).astype(np.int64)
    return np.ascontiguousarray(offsets), np.ascontiguousarray(length[order]), np.array(outside, np.int64)
