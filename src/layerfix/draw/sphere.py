"""Pictures of a search for a build direction: the half-sphere of directions, and one aim against another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.draw.canvas import Drawing

if TYPE_CHECKING:
    from numpy.typing import NDArray

INK, PALE, RULE = "#282c34", "#8a9099", "#dfe2e6"
# Few corrections are dark blue, many yellow: what printed in grey is still in order.
RAMP = (
    (0.0, (48, 18, 92)),
    (0.25, (42, 90, 154)),
    (0.5, (32, 156, 144)),
    (0.75, (134, 205, 84)),
    (1.0, (250, 231, 80)),
)
STEPS = 48  # colours
DISC_PX, CELL_PX, MARGIN = 560.0, 5.0, 70.0
WIDE = 12.0  # from this ratio of the largest to the least on, colours follow the logarithm


def sphere_map(
    directions: NDArray[np.float64],
    values: NDArray[np.float64],
    *,
    best: NDArray[np.float64],
    given: NDArray[np.float64],
    unit: str,
    title: str = "",
    both: bool = False,
) -> Drawing:
    """The half-sphere of directions seen from its pole, equal areas equal, coloured by the nearest direction's value.

    directions, values  (n, 3) and (n,)
    best, given  (3,) directions that are marked with a ring and a cross
    both         opposite directions differ: the lower half is drawn beside the upper, as seen through it
    """
    halves = (1.0, -1.0) if both else (1.0,)
    height = DISC_PX + 2 * MARGIN + 60
    drawing = Drawing(len(halves) * (DISC_PX + MARGIN) + MARGIN + 110, height)
    low, high = float(values.min()), float(values.max())
    logarithmic = low > 0 and high / low > WIDE

    def level(value: NDArray[np.float64]) -> NDArray[np.float64]:
        if high <= low:
            return np.zeros_like(value)
        a = np.log(value / low) / math.log(high / low) if logarithmic else (value - low) / (high - low)
        return np.clip(a, 0.0, 1.0)

    for k, sign in enumerate(halves):
        centre = MARGIN + DISC_PX / 2 + k * (DISC_PX + MARGIN), MARGIN + DISC_PX / 2 + 20
        _disc(drawing, centre, sign, directions, level(values), both)
        _axes(drawing, centre, sign)
        for direction, ring in ((given, False), (best, True)):
            if both and direction[2] * sign < 0:
                continue
            shown = direction if both or direction[2] >= 0 else -direction
            _mark(drawing, _on_page(shown, centre, sign), ring)
        if both:
            drawing.text(centre[0], height - 18, "upper half" if sign > 0 else "lower half, seen through the upper",
                         14, PALE, "middle")  # fmt: skip
    _bar(drawing, len(halves) * (DISC_PX + MARGIN) + MARGIN, low, high, logarithmic, unit)
    drawing.text(MARGIN - 40, 34, title, 18, INK)
    if not both:
        drawing.text(MARGIN - 40, height - 18, "ring: best, cross: as given. Opposite directions are one.", 14, PALE)
    return drawing


def _disc(
    drawing: Drawing,
    centre: tuple[float, float],
    sign: float,
    directions: NDArray[np.float64],
    levels: NDArray[np.float64],
    both: bool,
) -> None:
    from scipy.spatial import cKDTree

    tree = cKDTree(directions if both else np.concatenate([directions, -directions]))
    radius, count = DISC_PX / 2, int(DISC_PX / CELL_PX)
    at = (np.arange(count) + 0.5) * CELL_PX - radius
    x, y = np.meshgrid(at, at)
    across = np.hypot(x, y)
    inside = across <= radius
    z = 1 - (across / radius) ** 2
    share = np.sqrt(np.maximum(2 - (across / radius) ** 2, 0)) / radius
    looked = np.stack([x * share, -y * share, z * sign], axis=-1)[inside]
    distances, nearest = tree.query(looked, k=4)
    # Nearest neighbours weigh most; a direction that was looked at itself decides alone.
    weights = 1 / np.maximum(distances, 1e-3) ** 3
    mixed = (weights * levels[nearest % len(levels)]).sum(axis=1) / weights.sum(axis=1)
    steps = np.full(inside.shape, -1)
    steps[inside] = np.minimum((mixed * STEPS).astype(int), STEPS - 1)
    for j in range(count):
        edges = np.flatnonzero(np.diff(steps[j], prepend=-1, append=-1))
        for a, b in pairwise(edges.tolist()):
            if steps[j, a] >= 0:
                colour = _colour((steps[j, a] + 0.5) / STEPS)
                left, top = centre[0] - radius + a * CELL_PX, centre[1] - radius + j * CELL_PX
                drawing.box(left, top, (b - a) * CELL_PX + 0.4, CELL_PX + 0.4, colour)


def _on_page(direction: NDArray[np.float64], centre: tuple[float, float], sign: float) -> tuple[float, float]:
    """Lambert's equal-area projection from the pole of a half."""
    x, y, z = direction
    k = DISC_PX / 2 / math.sqrt(1 + max(float(z * sign), 0.0))
    return centre[0] + float(x) * k, centre[1] - float(y) * k


def _axes(drawing: Drawing, centre: tuple[float, float], sign: float) -> None:
    turn = np.linspace(0, 2 * np.pi, 181)
    for degrees in (30, 60, 90):
        r = DISC_PX / 2 * math.sqrt(2) * math.sin(math.radians(degrees) / 2)
        ring = np.column_stack([centre[0] + r * np.cos(turn), centre[1] + r * np.sin(turn)])
        drawing.line(ring, 2.0 if degrees == 90 else 0.7, INK if degrees == 90 else "#ffffff")
    radius = DISC_PX / 2
    drawing.text(centre[0] + radius + 10, centre[1] + 5, "+x", 15, INK)
    drawing.text(centre[0], centre[1] - radius - 10, "+y", 15, INK, "middle")
    drawing.text(centre[0] + 6, centre[1] - 6, "+z" if sign > 0 else "-z", 13, "#ffffff")
    drawing.line([(centre[0] - 3, centre[1]), (centre[0] + 3, centre[1])], 1.2, "#ffffff")
    drawing.line([(centre[0], centre[1] - 3), (centre[0], centre[1] + 3)], 1.2, "#ffffff")


def _mark(drawing: Drawing, at: tuple[float, float], ring: bool) -> None:
    x, y = at
    for width, colour in ((5.0, "#ffffff"), (2.5, "#d62728" if ring else INK)):
        if ring:
            turn = np.linspace(0, 2 * np.pi, 41)
            drawing.line(np.column_stack([x + 11 * np.cos(turn), y + 11 * np.sin(turn)]), width, colour)
        else:
            drawing.line([(x - 7, y - 7), (x + 7, y + 7)], width, colour)
            drawing.line([(x - 7, y + 7), (x + 7, y - 7)], width, colour)


def _bar(drawing: Drawing, x: float, low: float, high: float, logarithmic: bool, unit: str) -> None:
    top, tall = MARGIN + 60, DISC_PX - 80
    for k in range(STEPS):
        y = top + tall * (1 - (k + 1) / STEPS)
        drawing.box(x, y, 18, tall / STEPS + 0.4, _colour((k + 0.5) / STEPS))
    for k in range(5):
        share = k / 4
        value = low * (high / low) ** share if logarithmic else low + (high - low) * share
        drawing.text(x + 25, top + tall * (1 - share) + 5, _number(float(value)), 14, INK)
    drawing.text(x, top - 14, unit, 14, INK)


def _number(value: float) -> str:
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 1000 else f"{value:.3g}"


def _colour(share: float) -> str:
    for (a, one), (b, other) in pairwise(RAMP):
        if share <= b:
            t = (share - a) / (b - a)
            return "#" + "".join(f"{round(p + (q - p) * t):02x}" for p, q in zip(one, other, strict=True))
    return "#fae750"


def scatter(
    x: Sequence[float],
    y: Sequence[float],
    *,
    x_title: str,
    y_title: str,
    front: Sequence[int],
    best: int | None,
    title: str = "",
) -> Drawing:
    """One aim against another: all poses pale, those on the front dark, the chosen one with a ring."""
    drawing = Drawing(760, 600)
    left, top, wide, tall = 96.0, 64.0, 620.0, 440.0
    xs, ys = np.asarray(x, np.float64), np.asarray(y, np.float64)

    def scale(values: NDArray[np.float64], start: float, length: float) -> NDArray[np.float64]:
        low, high = values.min(), values.max()
        placed: NDArray[np.float64] = start + length * (0.04 + 0.92 * (values - low) / max(high - low, 1e-12))
        return placed

    px, py = scale(xs, left, wide), 2 * top + tall - scale(ys, top, tall)
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        gx, gy = left + wide * (0.04 + 0.92 * share), top + tall * (1 - 0.04 - 0.92 * share)
        drawing.line([(gx, top), (gx, top + tall)], 1, RULE)
        drawing.line([(left, gy), (left + wide, gy)], 1, RULE)
        drawing.text(gx, top + tall + 20, _number(float(xs.min() + share * np.ptp(xs))), 13, INK, "middle")
        drawing.text(left - 8, gy + 5, _number(float(ys.min() + share * np.ptp(ys))), 13, INK, "end")
    for a, b in zip(px, py, strict=True):
        drawing.line([(a - 0.01, b), (a + 0.01, b)], 5, "#c3c8cf")
    order = sorted(front, key=lambda k: (xs[k], ys[k]))
    for k in order:
        drawing.line([(px[k] - 0.01, py[k]), (px[k] + 0.01, py[k])], 8, "#1f5fd6")
    if best is not None:
        _mark(drawing, (float(px[best]), float(py[best])), True)
    drawing.text(left, 36, title, 18, INK)
    drawing.text(left + wide / 2, top + tall + 46, x_title, 15, INK, "middle")
    drawing.text(left - 70, top - 14, y_title, 15, INK)
    drawing.text(left, 586, "dark: none is better in every aim; ring: chosen", 13, PALE)
    return drawing
