"""A mesh in its best build direction, for `layerfix fix --orient`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from layerfix.commands.options import raster_of
from layerfix.orientation.find import Options as SearchOptions
from layerfix.orientation.find import find
from layerfix.orientation.objective import Objective, Printing

if TYPE_CHECKING:
    from layerfix.commands.options import Options
    from layerfix.mesh.triangles import Mesh
    from layerfix.orientation.outcome import Orientation
    from layerfix.orientation.search import State


def printing_of(mesh: Mesh, options: Options) -> Printing:
    """How the part would be printed, from what was given and the printer. Raises InputError for what is missing."""
    raster, printer = raster_of(options, mesh.name), options.printer
    mode = options.correction.mode or (printer.mode if printer else "as_printed")
    spurs = options.correction.spurs or "metric"
    return Printing(raster.pixel_mm, raster.layer_mm, raster.min_feature_mm, raster.first_layer_mm, mode, spurs,
                    options.slicing.fill or "nonzero")  # fmt: skip


def standing(mesh: Mesh, options: Options, progress: Callable[[int, int], None]) -> tuple[Mesh, Orientation]:
    """The mesh as it needs the least correction, with a note of what that won; one that fits the printer, if given.

    Also what was searched.

    progress is called with (poses counted, about how many there will be). Ctrl-C ends it: there is nothing to keep.
    """

    def told(state: State) -> None:
        progress(round(state.done), max(round(state.total), 1))

    room_mm = options.printer.build_mm if options.printer else None
    method = options.slicing.orient or "race"
    objective = Objective(mesh, printing_of(mesh, options))
    found = find(objective, SearchOptions(method, room_mm=room_mm), workers=options.run.workers, progress=told)
    if found.interrupted:
        raise KeyboardInterrupt
    best, given = found.best, found.initial
    if best.pose == given.pose:
        note = f"stands as it is given: of {found.screened} poses none needs less than {given.changed_px} px"
    else:
        theta = ", ".join(f"{angle:.2f}".replace("-0.00", "0.00") for angle in best.theta_rad)
        before = f"instead of {given.changed_px} ({found.reduction_percent:.3g} % less)"
        if not given.printed:
            before = "where as it is given no layer would meet it"
        note = f"turned by θ = [{theta}] and {best.psi_rad:.2f} rad on the plate:"
        note += f" {best.changed_px} px to correct {before}"
    placed = found.mesh()
    return replace(placed, notes=(*placed.notes, note)), found
