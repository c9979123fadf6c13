"""A mesh as it is printed: read, stood up, turned to fit, and cut into layers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from layerfix.commands.machines import hint_of, project_printers, told_of_heights, told_of_service
from layerfix.commands.mesh_file import mesh_in
from layerfix.commands.options import Options, raster_of, refuse_given
from layerfix.errors import InputError
from layerfix.mesh.empty import told_of_ends
from layerfix.mesh.slicing import slice_mesh
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh
    from layerfix.orientation.outcome import Orientation
    from layerfix.printers import Printer
    from layerfix.stack import LayerStack

QUARTER_TURN = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float64)


class Placing(NamedTuple):
    """What happened to a mesh after it was read: the (4, 4) matrix, and the search for a direction that chose it."""

    matrix: NDArray[np.float64]
    search: Orientation | None = None


class Part(NamedTuple):
    """A mesh as it is printed, its layers, and how it was turned and moved; None: it is as it was read."""

    mesh: Mesh
    stack: LayerStack
    placed: Placing | None


def open_part(
    source: Path,
    options: Options,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    mesh: Mesh | None = None,
) -> Part:
    """A mesh and its layers, in its best build direction if that is asked for (told of in full poses).

    mesh: of the source, where it stands on the plate; it is not turned then
    """
    refuse_given(options.greys, f"goes with images and jobs; {source} is a mesh")
    printer = options.printer
    pixel_mm, layer_mm, first_mm, min_feature_mm = raster_of(
        options, source, lambda: hint_of(source, project_printers(source))
    )
    paths = options.path_settings()
    if paths is not None:
        for height in (layer_mm, first_mm or layer_mm):
            paths.check_layer(height)
    slicing = options.slicing
    stands = mesh is not None
    placed: Placing | None = None
    mesh = mesh or mesh_in(source, slicing)
    if slicing.orient is not None:
        from layerfix.commands.standing import standing

        mesh, found = standing(mesh, options, progress)
        placed = Placing(found.matrix, found)
    if not stands and _fits_only_turned(mesh, printer):
        mesh = mesh.transformed(QUARTER_TURN[:3, :3])
        placed = Placing(QUARTER_TURN) if placed is None else Placing(QUARTER_TURN @ placed.matrix, placed.search)
    _check_size(mesh, printer)
    if slicing.axes is not None:
        from layerfix.commands.axes import thicker_across

        mesh = thicker_across(mesh, pixel_mm, options, progress)
    if slicing.min_overlap is not None and slicing.z_sampling != "overlap":
        raise InputError("--min-overlap: goes with --z-sampling overlap")
    panel = printer.pixels if printer and pixel_mm == printer.pixel_mm else None
    stack = slice_mesh(mesh, pixel_mm=pixel_mm, layer_mm=layer_mm, first_layer_mm=first_mm,
                       margin_mm=min_feature_mm, fill=slicing.fill or "nonzero",
                       z_sampling=slicing.z_sampling or "rescue",
                       min_overlap=0.5 if slicing.min_overlap is None else slicing.min_overlap,
                       antialias=bool(slicing.antialias),
                       frame_px=panel)  # fmt: skip
    stack = told_of_ends(stack, mesh)
    told = *told_of_service(printer), *told_of_heights(stack, mesh.size_mm[2], printer)
    return Part(mesh, replace(stack, notes=(*stack.notes, *told)), placed)


def _fits_only_turned(mesh: Mesh, printer: Printer | None) -> bool:
    """Whether the mesh fits the printer only if it is turned by 90° on the plate (many panels stand on end)."""
    if printer is None:
        return False
    (x, y, _), (room_x, room_y, _) = mesh.size_mm, printer.room_mm
    fits, fits_turned = x <= room_x and y <= room_y, x <= room_y and y <= room_x
    return fits_turned and not fits


def check_more_than_a_dot(mesh: Mesh, min_feature_mm: float) -> None:
    """Raises InputError for a part that is narrower than the minimum feature both ways: it would be another part."""
    size = mesh.size_mm
    if max(size[:2]) < min_feature_mm:
        raise InputError(
            f"{mesh.name}: the part is {size[0]:.4g} × {size[1]:.4g} mm, smaller than the minimum feature of"
            f" {format_mm(min_feature_mm)}; all of it would be one dot"
        )


def _check_size(mesh: Mesh, printer: Printer | None) -> None:
    size = mesh.size_mm
    if printer and any(part > room * (1 + 1e-9) for part, room in zip(size, printer.room_mm, strict=True)):
        raise InputError(
            f"{mesh.name}: the part is {' × '.join(f'{s:.4g}' for s in size)} mm, larger than what"
            f" {printer.name} prints: {' × '.join(f'{s:.4g}' for s in printer.room_mm)} mm"
        )
