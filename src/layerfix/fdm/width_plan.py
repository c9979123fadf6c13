"""A part with the extrusion widths chosen for it: tables, plots, slicers' projects and G-code are written from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from layerfix.fdm.settings import PathSettings
    from layerfix.layers.widths import Widths
    from layerfix.mesh.triangles import Mesh
    from layerfix.printers import Printer
    from layerfix.stack import LayerStack

ON_BED_MM = 1e-6


def with_first_layer(widths: Widths, width_mm: float | None) -> Widths:
    """The same widths, but for the first layer if it lies on the bed and has a width of its own."""
    if width_mm is None or not len(widths) or widths.z_mm[0, 0] > ON_BED_MM:
        return widths
    out = widths.width_mm.copy()
    out[0] = width_mm
    return replace(widths, width_mm=out)


@dataclass(frozen=True, eq=False)
class WidthPlan:
    """The value that `layerfix.write` turns into .3mf, .gcode, .csv, .json, .png and .svg.

    part       the mesh, for a slicer's project
    stack      its layers
    suggested  by `suggest_widths`, layer by layer
    chosen     by `banded`
    printer    whose nozzle, speeds and bed they are for
    settings   how its beads are laid
    summary    what else a table may say, by name
    """

    part: Mesh
    stack: LayerStack
    suggested: Widths
    chosen: Widths
    printer: Printer
    settings: PathSettings
    summary: Mapping[str, Any] = field(default_factory=dict)

    @property
    def laid(self) -> Widths:
        """The chosen widths as they are laid: the first layer on the bed has the printer's own, in slicers too."""
        return with_first_layer(self.chosen, self.settings.first_layer_width_mm)

    def corrected(self) -> LayerStack:
        """The layers with what is too thin for the narrowest of the widths thickened to it."""
        from layerfix.layers.correction import correct

        return correct(self.stack, min_feature_mm=self.suggested.range_mm[0])
