"""Which printer a file is for, by what it says itself: told when none was given, never taken without a word."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.printers import find_by_host
from layerfix.units import format_mm

if TYPE_CHECKING:
    from layerfix.printers import Entry, Printer
    from layerfix.stack import LayerStack

MOST = 4  # printers that are proposed; of more, the file says too little


def job_printers(stack: LayerStack) -> list[Entry]:
    """The printers that a job may be for, by the machine it names, its pixels and its panel's size."""
    if stack.container is None:
        return []
    size_mm = stack.width * stack.pixel_mm[0], stack.height * stack.pixel_mm[1]
    found = find_by_host(stack.container.machine, pixels=(stack.width, stack.height), size_mm=size_mm)
    own = [entry for entry in found if entry.format in stack.container.suffixes]
    return own if len(found) > MOST and own else found


def project_printers(source: Path) -> list[Entry]:
    """The printers that a slicer's project may be for, by its settings."""
    from layerfix.formats.solid.project_3mf import machine_of

    if source.suffix.lower() != ".3mf":
        return []
    names, nozzle_mm = machine_of(source)
    return find_by_host(names, nozzle_mm=nozzle_mm)


def told_of_machine(stack: LayerStack, printer: Printer | None) -> list[str]:
    """A word about the printer that a job is for, if none was given, or if another one was."""
    found = job_printers(stack)
    if printer is not None and printer.process != "resin" and stack.container is not None:
        return [f"this is a job of a resin printer; {printer.title} is none ({printer.process})"]
    if not found or len(found) > MOST:
        return []
    names = " or ".join(entry.name for entry in found)
    if printer is None:
        feature = f" (minimum feature {format_mm(found[0].min_feature_mm)})" if len(found) == 1 else ""
        return [f"by its own word this job is for {named(found)}: --printer {names}{feature}"]
    if printer.pixels is None or sorted(printer.pixels) == sorted((stack.width, stack.height)):
        return []
    return [f"by its own word this job is for {named(found)}, not for {printer.title}: --printer {names}"]


def named(found: list[Entry]) -> str:
    """Makers and models, each once."""
    return " or ".join(dict.fromkeys(entry.title for entry in found))


def told_of_service(printer: Printer | None) -> list[str]:
    """What a service asks for beside the walls that are corrected."""
    if printer is None or printer.process != "service":
        return []
    pitch = format_mm(printer.pixel_mm[0])
    words = [f"{printer.title}: walls of {format_mm(printer.min_feature_mm)}, on pixels and layers of {pitch}"]
    wires = max(printer.min_wire_mm or 0.0, printer.min_free_wire_mm or 0.0)
    if wires > printer.min_feature_mm:
        words.append(f"it asks {format_mm(wires)} of wires and pins: --min-feature {wires:g}mm gives them that")
    return words


def told_of_heights(stack: LayerStack, part_mm: float, printer: Printer | None) -> list[str]:
    """A word about layers that the printer does not make, and about one that is higher than all of the part."""
    words = []
    heights = {round(float(top - bottom), 6) for bottom, top in (stack.z_mm[0], stack.z_mm[-1])}
    if printer is not None and printer.process != "service":
        low, high = printer.layer_range_mm
        for height in sorted(heights):
            if not low * (1 - 1e-6) <= height <= high * (1 + 1e-6):
                made = f"{format_mm(low)} to {format_mm(high)}"
                words.append(f"layers of {format_mm(height)}: {printer.title} makes {made}")
    if len(stack) == 1 and part_mm < min(heights) * (1 - 1e-6):
        words.append(f"the part is {format_mm(round(part_mm, 6))} high, and its only layer {format_mm(min(heights))}")
    return words


def hint_of(source: Path, found: list[Entry]) -> str:
    """For an error about a printer that is missing: what the file says, or nothing."""
    if not found or len(found) > MOST:
        return ""
    return f"; {source.name} is for {named(found)}: --printer {' or '.join(entry.name for entry in found)}"
