"""G-code for Marlin, Klipper and RepRapFirmware, with the comments that PrusaSlicer writes.

`;LAYER_CHANGE`, `;Z:`, `;HEIGHT:`, `;TYPE:` and `;WIDTH:` let viewers (PrusaSlicer's, OrcaSlicer's and others) colour
the beads. The stack's frame is put in the middle of the bed, its lowest solid layer on it. E follows from the bead's
cross-section (`fdm.beads`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from layerfix import __version__
from layerfix.errors import InputError, OutputError
from layerfix.fdm import LayerPaths, Path
from layerfix.fdm.beads import SKIRT, section_mm2
from layerfix.fdm.speeds import Speeds, written_time
from layerfix.files import whole_file
from layerfix.printers import GCODE_PLACEHOLDERS
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.fdm import PathSettings
    from layerfix.fdm.toolpaths import Toolpaths
    from layerfix.formats.options import GcodeOptions
    from layerfix.printers import Printer
    from layerfix.stack import LayerStack

    Floats = NDArray[np.float64]


SUFFIXES = (".gcode",)


@dataclass
class _Used:
    """What has been laid so far."""

    filament_mm: float = 0.0
    volume_mm3: float = 0.0
    seconds: float = 0.0
    small_parts: int = 0
    small_z_mm: float = 0.0


class _Machine:
    """The printer while it prints: where it is, what it was told last, and the lines that follow from that."""

    def __init__(self, printer: Printer, offset_mm: Floats) -> None:
        self.printer, self.speeds, self.offset_mm = printer, Speeds(printer), offset_mm
        self.relative = bool(printer.relative_extrusion)
        self.filament_mm2 = math.pi * self.speeds.value("filament_mm") ** 2 / 4
        self.at: Floats | None = None
        self.e_mm = 0.0
        self.kind, self.width, self.speed = "", 0.0, 0
        self.retracted = False
        self.z_mm = 0.0
        self.used = _Used()

    def extrude(self, length_mm: float) -> str:
        """The E of one move by itself."""
        self.e_mm += length_mm
        return f"E{length_mm if self.relative else self.e_mm:.5f}"

    def layer(self, layer: LayerPaths, *, first: bool) -> Iterator[str]:
        """All lines of a layer."""
        bottom, top = layer.z_mm
        yield f";LAYER_CHANGE\n;Z:{top:.6g}\n;HEIGHT:{top - bottom:.6g}\n"
        self.width = 0.0
        if not self.relative:
            yield "G92 E0\n"
            self.e_mm = 0.0
        seconds = self.speeds.seconds(layer, first_layer=first)
        slowed = self.speeds.slowed(seconds)
        self.used.seconds += seconds if slowed == 1 else self.speeds.seconds(layer, first_layer=first, slowed=slowed)
        yield from self._to_height(top)
        for path in layer.paths:
            yield from self._travel(path.points_mm[0] + self.offset_mm)
            yield from self._bead(path, layer.layer_mm, first, slowed)

    def _to_height(self, z_mm: float) -> Iterator[str]:
        yield from self._retract()
        self.z_mm = z_mm
        if self.at is not None:  # else the start code has left the nozzle above the bed, and there it stays for now
            yield f"G1 Z{z_mm:.6g} F{60 * self.speeds.value('travel_mm_s'):.0f}\n"

    def _retract(self) -> Iterator[str]:
        length = self.speeds.value("retract_mm")
        if not self.retracted and length:
            yield f"G1 {self.extrude(-length)} F{60 * self.speeds.value('retract_mm_s'):.0f}\n"
        self.retracted = True

    def _travel(self, to: Floats) -> Iterator[str]:
        speed = 60 * self.speeds.value("travel_mm_s")
        way = math.inf if self.at is None else math.hypot(*(to - self.at))
        lift = self.speeds.value("retract_lift_mm")
        if way > 5e-4:
            if self.at is not None and way > self.speeds.value("retract_before_travel_mm"):
                yield from self._retract()
                if lift:
                    yield f"G1 Z{self.z_mm + lift:.6g} F{speed:.0f}\n"
            yield f"G1 X{to[0]:.3f} Y{to[1]:.3f} F{speed:.0f}\n"
            self.speed = 0
        if self.retracted:
            length = self.speeds.value("retract_mm")
            if lift or self.at is None:
                yield f"G1 Z{self.z_mm:.6g} F{speed:.0f}\n"
            if length:
                yield f"G1 {self.extrude(length)} F{60 * self.speeds.value('retract_mm_s'):.0f}\n"
            self.retracted, self.speed = False, 0
        self.at = to

    def _bead(self, path: Path, layer_mm: float, first: bool, slowed: float) -> Iterator[str]:
        if path.kind != self.kind:
            self.kind = path.kind
            yield f";TYPE:{path.kind}\n"
        points = path.points_mm[1:] + self.offset_mm
        section = np.asarray(section_mm2(path.width_mm, layer_mm))
        volumes = path.lengths_mm * section
        lengths = volumes / self.filament_mm2
        mm_s = self.speeds.path_mm_s(path, layer_mm, first_layer=first, slowed=slowed)
        speeds = np.round(60 * mm_s).astype(np.int64)
        es = lengths if self.relative else self.e_mm + np.cumsum(lengths)
        self.e_mm += float(lengths.sum())
        self.used.filament_mm += float(lengths.sum())
        self.used.volume_mm3 += float(volumes.sum())
        rows = np.column_stack([points, es])
        for a, b in path.stretches():
            if path.width_mm[a] != self.width:
                self.width = float(path.width_mm[a])
                yield f";WIDTH:{self.width:.6g}\n"
            if speeds[a] != self.speed:
                self.speed = int(speeds[a])
                yield f"G1 F{self.speed}\n"
            yield "G1 X%.3f Y%.3f E%.5f\n" * (b - a) % tuple(rows[a:b].ravel().tolist())
        self.at = points[-1]


def write(path: FilePath, stack: LayerStack, options: GcodeOptions) -> None:
    """Plan the beads of a stack and write them for a printer.

    Raises OutputError without an FDM printer, and InputError for what `plan_toolpaths` refuses.
    """
    from layerfix.fdm.toolpaths import plan_toolpaths

    printer = options.printer
    if printer is None:
        raise OutputError(f"{path}: G-code needs the printer's nozzle, bed and speeds; give --printer")
    settings = options.settings()
    lowest = next((k for k, layer in enumerate(stack) if layer.rows.any()), None)
    if lowest is None:
        raise OutputError(f"{path}: every layer is empty, so there is nothing to print")
    widths = None if options.width_mm is None else np.broadcast_to(options.width_mm, len(stack))[lowest:]
    planned = plan_toolpaths(on_bed(stack, lowest), settings, width_mm=widths)
    machine = _Machine(printer, bed_offset_mm(stack, printer))
    no_room = False
    with whole_file(path, force=options.force) as file:
        file.write(_head(printer, stack, planned).encode())
        if options.watch is not None:
            for index in range(lowest):
                options.watch(index, stack[index].without_pixels())
        for index, (layer, paths) in enumerate(planned.each()):
            if options.watch is not None:
                bottom, top = stack.z_mm[lowest + index].tolist()  # where it is in the stack, not on the bed
                options.watch(lowest + index, replace(layer, z_mm=(bottom, top)))
            if not paths.paths:
                continue
            _check_on_bed(path, paths, machine.offset_mm, printer)
            if index == 0:
                paths, no_room = _without_skirt_off_the_bed(paths, machine.offset_mm, printer)
            file.write("".join(machine.layer(paths, first=index == 0)).encode())
            if paths.small_parts and not machine.used.small_parts:
                machine.used.small_z_mm = paths.z_mm[1]
            machine.used.small_parts += paths.small_parts
            if index == 0:
                file.write(_after_first_layer(printer).encode())
        file.write(_tail(printer, settings, machine.used, stack).encode())
    _tell(options, machine.used)
    if stack.z_mm[lowest, 0] > 0 and options.tell is not None:
        options.tell(f"the lowest solid layer is at z = {format_mm(stack.z_mm[lowest, 0])}; it was put on the bed")
    if no_room and options.tell is not None:
        options.tell("there is no room for a skirt on the bed, so there is none")


def on_bed(stack: LayerStack, lowest: int) -> LayerStack:
    """The stack from layer `lowest` on, moved down so that it begins at z = 0."""
    drop_mm = float(stack.z_mm[lowest, 0])
    if lowest == 0 and drop_mm == 0:
        return stack
    above = stack[lowest:]
    z_mm = np.round(above.z_mm - drop_mm, 9)
    make = above.make
    return replace(above, z_mm=z_mm, make=lambda i: replace(make(i), z_mm=(float(z_mm[i, 0]), float(z_mm[i, 1]))))


def _check_on_bed(path: FilePath, layer: LayerPaths, offset_mm: Floats, printer: Printer) -> None:
    """Raises InputError for beads beside the bed."""
    points = np.concatenate([p.points_mm for p in layer.paths if p.kind != SKIRT]) + offset_mm
    room = np.array(printer.build_mm)
    if (points < 0).any() or (points > room[:2]).any() or layer.z_mm[1] > room[2] * (1 + 1e-9):
        size = np.ptp(points, axis=0)
        fits = (size <= room[:2]).all() and layer.z_mm[1] <= room[2]
        bed = f"{' × '.join(f'{s:.4g}' for s in printer.build_mm)} mm"
        how = (
            f"which fits {printer.name} ({bed}), but lies beside its bed: the middle of the layers' frame is put"
            " in the middle of the bed, so crop the layers to the part"
            if fits
            else f"larger than what {printer.name} prints: {bed}"
        )
        raise InputError(
            f"{path}: at z = {format_mm(layer.z_mm[1])} the part is {size[0]:.4g} × {size[1]:.4g} mm, {how}"
        )


def bed_offset_mm(stack: LayerStack, printer: Printer) -> Floats:
    """What to add to the stack's x and y so that its frame is in the middle of the bed."""
    middle = np.array(stack.origin_mm) + np.array([stack.width, -stack.height]) * np.array(stack.pixel_mm) / 2
    offset: Floats = np.array(printer.build_mm[:2]) / 2 - middle
    return offset


def _without_skirt_off_the_bed(layer: LayerPaths, offset_mm: Floats, printer: Printer) -> tuple[LayerPaths, bool]:
    """The layer without its skirt if that does not fit the bed, and whether that was so."""
    skirts = [path.points_mm + offset_mm for path in layer.paths if path.kind == SKIRT]
    fits = all((points >= 0).all() and (points <= np.array(printer.build_mm[:2])).all() for points in skirts)
    if fits:
        return layer, False
    return replace(layer, paths=tuple(path for path in layer.paths if path.kind != SKIRT)), True


def _tell(options: GcodeOptions, used: _Used) -> None:
    if options.tell is None:
        return
    options.tell(f"printing takes about {written_time(used.seconds)} and {used.filament_mm / 1000:.3g} m of filament")
    if used.small_parts:
        options.tell(
            f"{used.small_parts} parts of layers are smaller than a bead and come out larger,"
            f" the first at z = {format_mm(used.small_z_mm)}"
        )


def _head(printer: Printer, stack: LayerStack, planned: Toolpaths) -> str:
    widths = np.unique(planned.width_mm)
    span = f"{widths[0]:g}" if len(widths) == 1 else f"{widths[0]:g} to {widths[-1]:g}"
    lines = [
        f"; generated by layerfix {__version__}",
        f"; {len(stack)} layers for {printer.title}, extrusion width {span} mm",
        ";TYPE:Custom",
        filled(printer.start_gcode or "", printer).strip("\n"),
        "G21",
        "G90",
        "M83" if printer.relative_extrusion else "M82",
        "G92 E0",
        _acceleration(printer),
        _fan(printer, 0.0),
    ]
    return "\n".join(line for line in lines if line) + "\n"


def filled(text: str, printer: Printer) -> str:
    """Start or end G-code with the printer's temperatures in it.

    A line whose temperature the printer's file does not say is left out, with a word.
    """
    lines = []
    for line in text.splitlines():
        for placeholder in GCODE_PLACEHOLDERS:
            value = getattr(printer, placeholder.strip("{}"))
            if placeholder in line:
                line = f"; {line} (unknown)" if value is None else line.replace(placeholder, f"{value:g}")
        lines.append(line)
    return "\n".join(lines)


def _acceleration(printer: Printer) -> str:
    """M204 in the printer's dialect: Marlin 2 and RepRapFirmware tell printing and travel apart."""
    value = printer.acceleration_mm_s2
    if value is None:
        return ""
    return f"M204 P{value:g} T{value:g}" if printer.gcode_flavor in ("marlin2", "reprap") else f"M204 S{value:g}"


def _fan(printer: Printer, percent: float) -> str:
    """M106 with the share that RepRapFirmware takes, or the 0 to 255 of the others; M107 is off."""
    if not percent:
        return "M106 S0" if printer.gcode_flavor == "reprap" else "M107"
    return f"M106 S{percent / 100:.2f}" if printer.gcode_flavor == "reprap" else f"M106 S{2.55 * percent:.0f}"


def _after_first_layer(printer: Printer) -> str:
    lines = []
    if printer.nozzle_c is not None and printer.nozzle_c != printer.first_layer_nozzle_c:
        lines.append(f"M104 S{printer.nozzle_c:g}")
    if printer.bed_c is not None and printer.bed_c != printer.first_layer_bed_c:
        lines.append(f"M140 S{printer.bed_c:g}")
    if printer.fan_percent:
        lines.append(_fan(printer, printer.fan_percent))
    return "".join(f"{line}\n" for line in lines)


def _tail(printer: Printer, settings: PathSettings, used: _Used, stack: LayerStack) -> str:
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
        filled(printer.end_gcode or "", printer).strip("\n"),
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
