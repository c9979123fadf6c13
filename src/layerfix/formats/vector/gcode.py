"""G-code for Marlin, Klipper and RepRapFirmware, with the comments that PrusaSlicer writes.

`;LAYER_CHANGE`, `;Z:`, `;HEIGHT:`, `;TYPE:` and `;WIDTH:` let viewers (PrusaSlicer's, OrcaSlicer's and others) colour
the beads. The stack's frame is put in the middle of the bed, its lowest solid layer on it. E follows from the bead's
cross-section (`fdm.beads`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix import __version__
from layerfix.errors import OutputError
from layerfix.fdm import LayerPaths
from layerfix.fdm.speeds import Speeds, written_time
from layerfix.files import whole_file
from layerfix.formats.vector import gcode_notes as notes
from layerfix.formats.vector.gcode_bed import bed_offset_mm, check_on_bed, on_bed, without_skirt_off_the_bed
from layerfix.formats.vector.gcode_code import filled, moves_of_code
from layerfix.formats.vector.gcode_text import Text, acceleration, fan
from layerfix.units import format_mm

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from layerfix.fdm import PathSettings
    from layerfix.fdm.beads import Hanging
    from layerfix.fdm.moves import Moves, Nozzle
    from layerfix.fdm.toolpaths import Toolpaths
    from layerfix.formats.options import GcodeOptions
    from layerfix.printers import Printer
    from layerfix.stack import LayerStack

    Floats = NDArray[np.float64]


SUFFIXES = (".gcode",)
# Dialects that a printer's file may name, but that are not written: a wrong file would be refused by the printer.
UNWRITTEN = {"griffin": "G-code with a Griffin header"}


@dataclass
class _Used:
    """What has been laid so far, and what is to be told of it; z's are those of the stack."""

    filament_mm: float = 0.0
    volume_mm3: float = 0.0
    seconds: float = 0.0
    layers: int = 0
    small_parts: int = 0
    small_z_mm: float = 0.0
    hanging: list[tuple[float, Hanging]] = field(default_factory=list)

    def add(self, paths: LayerPaths, moves: Moves, seconds: float, z_mm: float) -> None:
        """One layer more, with its top."""
        self.layers += 1
        self.seconds += seconds
        self.filament_mm += float(moves.e_mm[moves.lays].sum())
        self.volume_mm3 += float(moves.mm3.sum())
        if paths.small_parts and not self.small_parts:
            self.small_z_mm = z_mm
        self.small_parts += paths.small_parts
        self.hanging += [(z_mm, place) for place in paths.hanging]

    def sentences(self) -> list[str]:
        """All that is to be told."""
        small = [notes.small_parts(self.small_parts, self.small_z_mm)] if self.small_parts else []
        return [notes.amounts(self.seconds, self.filament_mm), *small, *notes.over_air(self.hanging)]


def write(path: FilePath, stack: LayerStack, options: GcodeOptions) -> None:
    """Plan the beads of a stack and write them for a printer.

    Raises OutputError without an FDM printer, and InputError for what `plan_toolpaths` refuses.
    """
    from layerfix.fdm.moves import Nozzle
    from layerfix.fdm.toolpaths import plan_toolpaths

    printer = options.machine()
    check_printer(path, printer)
    assert printer is not None
    settings = options.settings()
    lowest = next((k for k, layer in enumerate(stack) if layer.rows.any()), None)
    if lowest is None:
        raise OutputError(f"{path}: every layer is empty, so there is nothing to print")
    widths = None if options.width_mm is None else np.broadcast_to(options.width_mm, len(stack))[lowest:]
    planned = plan_toolpaths(on_bed(stack, lowest), settings, width_mm=widths)
    nozzle, text, used = Nozzle(printer, bed_offset_mm(stack, printer)), Text(printer), _Used()
    no_room = False
    with whole_file(path, force=options.force) as file:
        head = _head(printer, stack, planned)
        nozzle.at_mm = _run(head, nozzle, used)
        file.write(head.encode())
        if options.watch is not None:
            for index in range(lowest):
                options.watch(index, stack[index].without_pixels())
        for index, (layer, paths) in enumerate(planned.each()):
            bottom, top = stack.z_mm[lowest + index].tolist()  # where it is in the stack, not on the bed
            if options.watch is not None:
                options.watch(lowest + index, replace(layer, z_mm=(bottom, top)))
            if not paths.paths:
                continue
            check_on_bed(path, paths, nozzle.offset_mm, printer)
            if index == 0:
                paths, no_room = without_skirt_off_the_bed(paths, nozzle.offset_mm, printer)
            moves, seconds = nozzle.moves(paths)
            used.add(paths, moves, seconds, top)
            file.write(text.layer(moves, paths.z_mm))
            if index == 0:
                file.write(text.after_first_layer().encode())
        end = filled(printer.end_gcode or "", printer).strip("\n")
        _run(end, nozzle, used)
        file.write(_tail(printer, settings, used, stack, end).encode())
    if options.tell is None:
        return
    for sentence in used.sentences():
        options.tell(sentence)
    if stack.z_mm[lowest, 0] > 0:
        options.tell(f"the lowest solid layer is at z = {format_mm(stack.z_mm[lowest, 0])}; it was put on the bed")
    if no_room:
        options.tell("there is no room for a skirt on the bed, so there is none")


def check_printer(path: FilePath, printer: Printer | None) -> None:
    """Raises OutputError without a printer, and for one whose G-code is another language than what is written."""
    if printer is None:
        raise OutputError(f"{path}: G-code needs the printer's nozzle, bed and speeds; give --printer")
    if printer.gcode_flavor in UNWRITTEN:
        raise OutputError(
            f"{path}: {printer.title} takes only {UNWRITTEN[printer.gcode_flavor]}, which is not written here;"
            " write a mesh (.3mf or .stl) and slice that for it"
        )


def check_codes(path: FilePath, printer: Printer | None, own: Mapping[str, Any]) -> None:
    """As `check_printer`, and OutputError for a printer without start or end code if none is in `own`, either."""
    check_printer(path, printer)
    assert printer is not None
    if printer.nozzle_mm is None:
        return  # `settings_for` says so
    missing = [key for key in ("start_gcode", "end_gcode") if getattr(printer, key) is None and not own.get(key)]
    if missing:
        options = " ".join(f"--{key.replace('_', '-')} FILE" for key in missing)
        codes = " and ".join(key.removesuffix("_gcode") for key in missing)
        raise OutputError(
            f"{path}: no {codes} code of {printer.title} is known, without which nothing heats or homes; give"
            f" {options} (what your slicer's printer settings hold), or write a mesh (.3mf or .stl) for your slicer"
        )


def _run(code: str, nozzle: Nozzle, used: _Used) -> Floats:
    """Add the time of the moves in start or end code; (3,) where it leaves the nozzle."""
    from layerfix.fdm.motion import move_seconds

    deltas, speeds, at = moves_of_code(code, nozzle.at_mm)
    steep = np.full(len(speeds), nozzle.speeds.value("acceleration_mm_s2"))
    used.seconds += float(move_seconds(deltas, speeds, steep, nozzle.limits).sum())
    return at


def _head(printer: Printer, stack: LayerStack, planned: Toolpaths) -> str:
    widths = np.unique(planned.width_mm)
    span = f"{widths[0]:g}" if len(widths) == 1 else f"{widths[0]:g} to {widths[-1]:g}"
    lines = [
        f"; generated by layerfix {__version__}",
        f"; for {printer.title}, extrusion width {span} mm",
        ";TYPE:Custom",
        filled(printer.start_gcode or "", printer).strip("\n"),
        "G21",
        "G90",
        "M83" if printer.relative_extrusion else "M82",
        "G92 E0",
        acceleration(printer),
        fan(printer, 0.0),
    ]
    return "\n".join(line for line in lines if line) + "\n"


def _tail(printer: Printer, settings: PathSettings, used: _Used, stack: LayerStack, end: str) -> str:
    config = {
        "nozzle_diameter": f"{settings.nozzle_mm:g}",
        "filament_diameter": f"{Speeds(printer).value('filament_mm'):g}",
        "gcode_flavor": printer.gcode_flavor or "marlin",
        "layer_height": f"{np.median(stack.z_mm[:, 1] - stack.z_mm[:, 0]):g}",
        "extrusion_width": f"{settings.width_mm:g}",
        "perimeters": settings.perimeters,
        "fill_density": f"{100 * settings.density:g}%",
        "top_solid_layers": settings.top_layers,
        "bottom_solid_layers": settings.bottom_layers,
        "seam_position": settings.seam,
        "printer_model": printer.title,
    }
    lines = [
        ";TYPE:Custom",
        end,
        f"; total layers = {used.layers}",
        f"; filament used [mm] = {used.filament_mm:.2f}",
        f"; filament used [cm3] = {used.volume_mm3 / 1000:.3f}",
        f"; estimated printing time (normal mode) = {written_time(used.seconds)}",
        "",
        *(
            f"; {key} = {value:g}" if isinstance(value, float) else f"; {key} = {value}"
            for key, value in config.items()
        ),
    ]
    return "\n".join(lines).lstrip("\n") + "\n"
