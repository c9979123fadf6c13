"""What people look at: the beads of a layer, and extrusion widths beside the part."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.draw.canvas import Drawing
from layerfix.fdm.beads import EXTERNAL, GAP_FILL, PERIMETER, SKIRT, SOLID, SPARSE, TOP, LayerPaths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.widths import Widths
    from layerfix.stack import LayerStack

INK, PALE, RULE = "#282c34", "#aab0b8", "#dfe2e6"
# Near PrusaSlicer's own colours of feature types.
COLOURS = {
    EXTERNAL: "#f07d32",
    PERIMETER: "#f2c744",
    GAP_FILL: "#ffffff",
    SOLID: "#9a5fc1",
    TOP: "#e0494f",
    SPARSE: "#b0382f",
    SKIRT: "#3f8f6b",
}
OTHER = "#7f8c99"
PLOT_PX, LEGEND_PX = 1000, 34


def draw_paths(layer: LayerPaths, *, title: str = "") -> Drawing:
    """The beads of one layer, as wide as they are laid, with the way of the nozzle in them and its travels.

    Kinds of other slicers (`;TYPE:`) are grey where they are not known.
    """
    points = np.concatenate([path.points_mm for path in layer.paths]) if layer.paths else np.zeros((1, 2))
    widest = max((float(path.width_mm.max()) for path in layer.paths), default=1.0)
    low, high = points.min(axis=0) - widest, points.max(axis=0) + widest
    scale = PLOT_PX / max(float((high - low).max()), 1e-6)
    width, height = ((high - low) * scale).tolist()
    kinds = list(dict.fromkeys(path.kind for path in layer.paths))
    drawing = Drawing(max(width, 760) + 40, height + 76 + LEGEND_PX, "#20242b")

    def place(where: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([(where[:, 0] - low[0]) * scale + 20, (high[1] - where[:, 1]) * scale + 56])

    for path in layer.paths:
        on_page = place(path.points_mm)
        colour = COLOURS.get(path.kind, OTHER)
        for a, b in path.stretches():
            drawing.line(on_page[a : b + 1], float(path.width_mm[a]) * scale, colour)
    for path in layer.paths:
        drawing.line(place(path.points_mm), 1, "#20242b")
    for before, after in zip(layer.paths[:-1], layer.paths[1:], strict=True):
        drawing.line(place(np.array([before.points_mm[-1], after.points_mm[0]])), 1, "#5aa7ff")
    drawing.text(20, 36, title, 22, "#ffffff")
    x = 20.0
    for kind in kinds:
        drawing.box(x, height + 76, 16, 16, COLOURS.get(kind, OTHER))
        drawing.text(x + 22, height + 90, kind, 15, "#ffffff")
        x += 34 + 8.2 * len(kind)
    return drawing


def draw_widths(stack: LayerStack, suggested: Widths, chosen: Widths, *, title: str = "") -> Drawing:
    """The part from the front, and beside it, at the same heights, the widths suggested and chosen for its layers."""
    seen = np.array(list(stack.each(lambda layer: np.bitwise_or.reduce(layer.rows, axis=0), once=True)))
    silhouette = np.unpackbits(seen.view(np.uint8), axis=1, bitorder="little")[:, : stack.width].astype(bool)
    filled = np.flatnonzero(silhouette.any(axis=0))
    first, last = (int(filled[0]), int(filled[-1])) if len(filled) else (0, stack.width - 1)
    z0, z1 = float(suggested.z_mm[0, 0]), float(suggested.z_mm[-1, 1])
    scale = min(700 / (z1 - z0), 620 / ((last - first + 1) * stack.pixel_mm[0]))
    left, top, bottom = 70.0, 70.0, 70 + (z1 - z0) * scale
    part_px = (last - first + 1) * stack.pixel_mm[0] * scale
    plot_left, plot_px = left + part_px + 60, 420.0
    drawing = Drawing(plot_left + plot_px + 40, bottom + 70)

    def y_of(z_mm: float) -> float:
        return bottom - (z_mm - z0) * scale

    lowest, highest = suggested.range_mm
    room = max(highest - lowest, 1e-6)

    def x_of(width_mm: float) -> float:
        return plot_left + 20 + (width_mm - lowest) / room * (plot_px - 40)

    for k, row in enumerate(silhouette):
        y, height = y_of(suggested.z_mm[k, 1]), (suggested.z_mm[k, 1] - suggested.z_mm[k, 0]) * scale
        colour = "#d62728" if suggested.too_thin[k] else "#acb2ba"
        edges = np.flatnonzero(np.diff(row.astype(np.int8), prepend=0, append=0))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            x = left + (a - first) * stack.pixel_mm[0] * scale
            drawing.box(x, y, (b - a) * stack.pixel_mm[0] * scale, height + 0.3, colour)
    for tick in np.linspace(lowest, highest, 5):
        drawing.line([(x_of(tick), top), (x_of(tick), bottom)], 1, RULE)
        drawing.text(x_of(tick), bottom + 20, f"{tick:.3g}", 14, INK, "middle")
    for tick in np.linspace(z0, z1, 6):
        drawing.line([(left - 8, y_of(tick)), (left - 2, y_of(tick))], 1, INK)
        drawing.text(left - 12, y_of(tick) + 5, f"{tick:.3g}", 14, INK, "end")
    for widths, stroke, colour in ((suggested, 1.5, PALE), (chosen, 3.0, "#1f5fd6")):
        steps = [(x_of(w), y_of(z)) for low, high, w in widths.ranges() for z in (low, high)]
        drawing.line(steps, stroke, colour)
    if suggested.thinning_mm is not None:
        at = np.clip(suggested.thinning_mm, lowest, highest)
        steps = [(x_of(at[k]), y_of(z)) for k, bounds in enumerate(suggested.z_mm.tolist()) for z in bounds]
        drawing.line(steps, 1.0, "#2ca02c")
    for k in np.flatnonzero(suggested.too_thin).tolist():
        drawing.box(plot_left + 4, y_of(suggested.z_mm[k, 1]), 8,
                    (suggested.z_mm[k, 1] - suggested.z_mm[k, 0]) * scale + 0.3, "#d62728")  # fmt: skip
    drawing.text(left, 36, title, 20, INK)
    drawing.text(left, bottom + 42, "z in mm; red: too thin for every width, correct these", 14, INK)
    drawing.text(plot_left, bottom + 42, "extrusion width in mm", 14, INK)
    drawing.text(
        plot_left, bottom + 62, "grey: suggested, blue: chosen, green: where thinning leaves a line", 14, INK
    )
    return drawing
