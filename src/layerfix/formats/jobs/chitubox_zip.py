"""Chitubox's zip: numbered PNG images and a run.gcode whose comments say the rest.

The comments are lines ``;key:value`` (layerHeight, resolutionX, machineX, totalLayer, volume, weight, price …).
It is also what Chitubox hands to its export plugins.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from layerfix.errors import InputError
from layerfix.formats.jobs.container import Frame, Spool, Totals
from layerfix.formats.jobs.zip_job import check_layers, zip_job
from layerfix.formats.png.series import gaps_in
from layerfix.formats.text_values import machine_name, number_above_0
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.formats.hints import Hints
    from layerfix.formats.probe import Probe
    from layerfix.stack import LayerStack

SUFFIXES = (".zip",)
GCODE = "run.gcode"
LARGEST_GCODE = 256 << 20
LAYER = re.compile(r"[0-9]+\.png")


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a job. Raises InputError if neither file nor options say pitch and layer height."""
    archive = probe.archive
    gcode = archive.read(GCODE, LARGEST_GCODE)
    values = _comments(gcode)
    names = sorted((n for n in archive.entries if LAYER.fullmatch(n)), key=lambda n: int(n[:-4]))
    width, height, _ = check_layers(archive, names, (0,))
    notes = gaps_in(str(archive.path), names, int(values["totalLayer"]) if "totalLayer" in values else None)
    pitch = None
    if {"machineX", "machineY"} <= values.keys():
        pitch = round(values["machineX"] / width, 6), round(values["machineY"] / height, 6)
    pixel_mm = hints.pitch(pitch)
    layer_mm = hints.layer(values.get("layerHeight"))
    if pixel_mm is None or layer_mm is None:
        raise InputError(f"{archive.path}: {GCODE} does not say machineX, machineY and layerHeight; give --printer")
    frame = Frame(width, height, pixel_mm, layer_bounds_mm(len(names), layer_mm, hints.first_layer_mm))

    def metadata(totals: Totals, spool: Spool) -> dict[str, bytes]:
        return {GCODE: _with_volume(gcode, values, totals.added_mm3 / 1000)}

    mirror = "x" if values.get("mirror") else ""
    found = re.search(rb"(?m)^;machineType:(.*)$", gcode[: 1 << 16])
    machine = machine_name(found[1]) if found else ""
    return zip_job(archive, names, frame, hints, SUFFIXES, metadata, mirror=mirror, machine=machine, notes=notes)


def _comments(gcode: bytes) -> dict[str, float]:
    """``;key:number`` lines of the header; values that are no numbers above 0 are left out."""
    found = {}
    for line in gcode[: 1 << 16].decode("latin-1").splitlines():
        key, _, value = line.removeprefix(";").partition(":")
        number = number_above_0(value) if line.startswith(";") and key.isalpha() else None
        if number is not None:
            found[key] = number
    return found


def _with_volume(gcode: bytes, values: dict[str, float], added_ml: float) -> bytes:
    """The header with volume (ml), weight and price grown by what was added; every other byte as it was."""
    if "volume" not in values:
        return gcode
    growth = max(values["volume"] + added_ml, 0) / values["volume"]
    for key in ("volume", "weight", "price"):
        if math.isfinite(values.get(key, math.inf) * growth):
            new = f";{key}:{values[key] * growth:.6f}".encode()
            gcode = re.sub(rb"(?m)^;" + key.encode() + rb":[-+0-9.eE]+", new, gcode, count=1)
    return gcode
