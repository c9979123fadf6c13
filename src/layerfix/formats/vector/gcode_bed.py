"""Where a part lies on a printer's bed, and whether it does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.fdm.beads import SKIRT
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.fdm import LayerPaths
    from layerfix.printers import Printer
    from layerfix.stack import LayerStack

    Floats = NDArray[np.float64]


def on_bed(stack: LayerStack, lowest: int) -> LayerStack:
    """The stack from layer `lowest` on, moved down so that it begins at z = 0."""
    drop_mm = float(stack.z_mm[lowest, 0])
    if lowest == 0 and drop_mm == 0:
        return stack
    above = stack[lowest:]
    z_mm = np.round(above.z_mm - drop_mm, 9)
    make = above.make
    return replace(above, z_mm=z_mm, make=lambda i: replace(make(i), z_mm=(float(z_mm[i, 0]), float(z_mm[i, 1]))))


def check_on_bed(path: FilePath, layer: LayerPaths, offset_mm: Floats, printer: Printer) -> None:
    """Raises InputError for beads beside the bed."""
    points = np.concatenate([p.points_mm for p in layer.paths if p.kind != SKIRT]) + offset_mm
    room = np.array(printer.room_mm)
    if not _lies_on(points, printer) or layer.z_mm[1] > room[2] * (1 + 1e-9):
        size = np.ptp(points, axis=0)
        fits = (size <= room[:2]).all() and layer.z_mm[1] <= room[2]
        bed = f"{' × '.join(f'{s:.4g}' for s in printer.room_mm)} mm{', round' if printer.round_bed else ''}"
        how = (
            f"which fits {printer.name} ({bed}), but lies beside its bed: the middle of the layers' frame is put"
            " in the middle of the bed, so crop the layers to the part"
            if fits
            else f"larger than what {printer.name} prints: {bed}"
        )
        raise InputError(
            f"{path}: at z = {format_mm(layer.z_mm[1])} the part is {size[0]:.4g} × {size[1]:.4g} mm, {how}"
        )


def _lies_on(points_mm: Floats, printer: Printer) -> bool:
    """Whether (n, 2) points of the machine's own coordinates are all on its bed."""
    size = np.array(printer.room_mm[:2])
    places = points_mm - np.array(printer.bed_origin_mm or (0, 0))
    if printer.round_bed:
        return bool((np.hypot(*(places - size / 2).T) <= size.min() / 2).all())
    return bool((places >= 0).all() and (places <= size).all())


def bed_offset_mm(stack: LayerStack, printer: Printer) -> Floats:
    """What to add to the stack's x and y so that its frame is in the middle of the bed."""
    middle = np.array(stack.origin_mm) + np.array([stack.width, -stack.height]) * np.array(stack.pixel_mm) / 2
    offset: Floats = np.array(printer.bed_origin_mm or (0, 0)) + np.array(printer.room_mm[:2]) / 2 - middle
    return offset


def without_skirt_off_the_bed(layer: LayerPaths, offset_mm: Floats, printer: Printer) -> tuple[LayerPaths, bool]:
    """The layer without its skirt if that does not fit the bed, and whether that was so."""
    skirts = [path.points_mm + offset_mm for path in layer.paths if path.kind == SKIRT]
    fits = all(_lies_on(points, printer) for points in skirts)
    if fits:
        return layer, False
    kept = [k for k, path in enumerate(layer.paths) if path.kind != SKIRT]
    paths = tuple(layer.paths[k] for k in kept)
    return replace(layer, paths=paths, ways=layer.ways[kept[0] :] if layer.ways else ()), True
