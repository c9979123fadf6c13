"""A stack → the beads of all its layers."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, overload

import numpy as np

from layerfix.errors import InputError
from layerfix.fdm.arrange import arranged, skirt
from layerfix.fdm.beads import LayerPaths, Path
from layerfix.fdm.bridges import OverAir, over_air
from layerfix.fdm.layer_plan import Perimeters, perimeters_of, plan_layer
from layerfix.fdm.settings import PathSettings
from layerfix.fdm.travel import ways_inside
from layerfix.layers.latest import Latest
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from layerfix.stack import Layer, LayerStack


GAP_MM = 1e-4  # between two layers; less is rounding


@dataclass(frozen=True, eq=False)
class Toolpaths(Sequence[LayerPaths]):
    """The beads of every layer, planned when asked for; `each` plans them in the stack's threads."""

    stack: LayerStack
    settings: PathSettings
    width_mm: NDArray[np.float64]  # (layers,)
    latest: Latest[Perimeters] = field(default_factory=Latest, repr=False)

    def __len__(self) -> int:
        return len(self.stack)

    @overload
    def __getitem__(self, index: int) -> LayerPaths: ...
    @overload
    def __getitem__(self, index: slice) -> list[LayerPaths]: ...
    def __getitem__(self, index: int | slice) -> LayerPaths | list[LayerPaths]:
        """The beads of a layer, or a list of those of several: they depend on the layers around, which stay."""
        if isinstance(index, slice):
            return [self[k] for k in range(len(self))[index]]
        k = range(len(self))[index]
        first = max(k - self._below, 0)
        around = [self.stack[i] for i in range(first, min(k + self._above + 1, len(self)))]
        return self._plan(k, around[: k - first], around[k - first], around[k - first + 1 :])

    def __iter__(self) -> Iterator[LayerPaths]:
        return (paths for _, paths in self.each())

    def each(self) -> Generator[tuple[Layer, LayerPaths]]:
        """(layer without its pixels, its paths) in order."""

        def plan(k: int, below: Sequence[Layer], layer: Layer, above: Sequence[Layer]) -> tuple[Layer, LayerPaths]:
            return layer.without_pixels(), self._plan(k, below, layer, above)

        return self.stack.each_with_neighbours(plan, below=self._below, above=self._above)

    @property
    def _below(self) -> int:
        return max(self.settings.bottom_layers, 1)

    @property
    def _above(self) -> int:
        return max(self.settings.top_layers, 1)

    def _plan(self, k: int, below: Sequence[Layer], layer: Layer, above: Sequence[Layer]) -> LayerPaths:
        stack, width = self.stack, float(self.width_mm[k])
        z = stack.z_mm  # a gap is nothing to lie on, and nothing that covers
        apart = np.flatnonzero(z[1:, 0] - z[:-1, 1] > GAP_MM) + 1  # layers above a gap
        touching_below = k - int(apart[apart <= k].max(initial=0))
        touching_above = int(apart[apart > k].min(initial=len(stack))) - 1 - k
        below, above = below[max(len(below) - touching_below, 0) :], above[:touching_above]
        air = over_air(below[-1] if below else None, layer, stack, width) if k else OverAir()
        perimeters = self.latest.of(layer)
        if perimeters is None or not perimeters.are_of(layer, width):
            perimeters = perimeters_of(
                layer,
                settings=self.settings,
                pixel_mm=stack.pixel_mm[0],
                origin_mm=stack.origin_mm,
                width_mm=width,
            )
        if perimeters is None:
            paths: list[Path] = []
        else:
            self.latest.keep(layer, perimeters)
            paths = plan_layer(perimeters, below, layer, above, index=k, bridges=air.bridges)
        ordered, parts, small = arranged(paths, layer, stack, self.settings, k)
        ways = ways_inside(ordered, parts, layer.rows, stack)
        if k == 0 and self.settings.skirt_loops and ordered:
            loops = skirt(layer, stack, self.settings, width)
            ordered, ways = [*loops, *ordered], (*[None] * len(loops), *ways)
        return LayerPaths(layer.z_mm, tuple(ordered), small, ways, air.hanging)


def plan_toolpaths(stack: LayerStack, settings: PathSettings, *, width_mm: ArrayLike | None = None) -> Toolpaths:
    """The beads that print a stack (correct it first: what is narrower than a bead comes out a bead wide).

    settings  see `PathSettings`; `settings_for(printer)` takes them from a printer's file
    width_mm  extrusion width of each layer, (layers,) or one for all, instead of the settings' (`suggest_widths`)
    returns   a sequence of LayerPaths, in the stack's own mm
    raises    InputError for pixels that are not square or coarser than a third of the nozzle, layers higher than the
              nozzle or the narrowest bead, and widths that the nozzle cannot lay
    """
    px, py = stack.pixel_mm
    if abs(px - py) > 1e-9 * px:
        raise InputError(
            f"pixels of {format_mm(px)} × {format_mm(py)}: toolpaths need square pixels; slice with one pitch"
        )
    if px > settings.nozzle_mm / 3:
        raise InputError(
            f"pixels of {format_mm(px)} are too coarse for a nozzle of {format_mm(settings.nozzle_mm)}: use"
            f" {format_mm(settings.nozzle_mm / 8)}"
        )
    for layer_mm in np.unique(np.round(stack.z_mm[:, 1] - stack.z_mm[:, 0], 6)).tolist():
        settings.check_layer(layer_mm)
    widths = np.full(len(stack), settings.width_mm)
    if width_mm is None:
        widths[:1] = settings.first_layer_width_mm or settings.width_mm
    else:
        given = np.asarray(width_mm, np.float64)
        if given.shape not in ((), (1,), (len(stack),)):
            raise InputError(f"widths of shape {given.shape}: one for all, or one for each of {len(stack)} layers")
        widths[:] = given
    for width in np.unique(widths).tolist():
        settings.check_width(width)
    return Toolpaths(stack, settings, widths)
