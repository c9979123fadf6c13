"""Printers: what one TOML file says about a machine. Those shipped live in ``sample_printers/``."""

from __future__ import annotations

from layerfix.printers.folder import printer_folder, printer_names
from layerfix.printers.hosts import find_by_host
from layerfix.printers.index import Entry, entries, find_printers
from layerfix.printers.keys import GCODE_FLAVORS, GCODE_PLACEHOLDERS, KEYS, MIRRORS, PROCESSES, Key
from layerfix.printers.printer import Printer, check_gcode, description, listing, load_printer

__all__ = [
    "GCODE_FLAVORS",
    "GCODE_PLACEHOLDERS",
    "KEYS",
    "MIRRORS",
    "PROCESSES",
    "Entry",
    "Key",
    "Printer",
    "check_gcode",
    "description",
    "entries",
    "find_by_host",
    "find_printers",
    "listing",
    "load_printer",
    "printer_folder",
    "printer_names",
]
