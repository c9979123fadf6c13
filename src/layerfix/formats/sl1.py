"""SL1, SL1S, M1: the jobs of Prusa's resin printers.

A zip of 8-bit grey PNG images whose names begin with config.ini's `jobDir` (other images are no layers), in
the order of their names. The firmware reads config.ini; prusaslicer.ini says the panel's size, where it is there.
Sources: the firmware's project reader (keys), PrusaSlicer's archive writer.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.errors import InputError
from layerfix.formats.container import Frame, Totals, hinted_pitch
from layerfix.formats.zip_job import check_layers, zip_job
from layerfix.formats.zips import Archive
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.formats.options import Hints
    from layerfix.stack import LayerStack

SUFFIXES = (".sl1", ".sl1s", ".m1")
CONFIG, SLICER = "config.ini", "prusaslicer.ini"
# Panels of the three printers by image size, for jobs without prusaslicer.ini.
PITCH_BY_SIZE = {(1440, 2560): 0.04725, (1620, 2560): 0.05}


def recognises(archive: Archive) -> bool:
    """A config.ini that names a jobDir."""
    return CONFIG in archive and "jobDir" in parse_ini(archive.text(CONFIG))


def parse_ini(text: str) -> dict[str, str]:
    """``key = value`` lines; later ones win, anything else is skipped."""
    found = {}
    for line in text.splitlines():
        key, separator, value = line.partition("=")
        if separator and not line.lstrip().startswith(("#", ";", "[")):
            found[key.strip()] = value.strip()
    return found


def read(archive: Archive, hints: Hints) -> LayerStack:
    """The layers of a job. Raises InputError for a missing layer height, no layers, and what is no 8-bit grey."""
    config = parse_ini(archive.text(CONFIG))
    names = sorted(n for n in archive.entries if n.startswith(config["jobDir"]) and n.lower().endswith(".png"))
    width, height, _ = check_layers(archive, names, (0,))
    slicer = parse_ini(archive.text(SLICER)) if SLICER in archive else {}
    pixel_mm = hinted_pitch(hints, _pitch_mm(slicer, (width, height)))
    if pixel_mm is None:
        raise InputError(f"{archive.path}: the job does not say its pixel pitch; give --printer or --pixel")
    layer_mm = hints.layer_mm or number(archive.path, config, "layerHeight")
    first_mm = hints.first_layer_mm or _first_layer_mm(archive.path, slicer, layer_mm)
    frame = Frame(width, height, pixel_mm, layer_bounds_mm(len(names), layer_mm, first_mm))

    def metadata(totals: Totals) -> dict[str, bytes]:
        return {CONFIG: with_used_material(archive.read(CONFIG), totals.added_mm3 / 1000)}

    return zip_job(archive, names, frame, hints, SUFFIXES, metadata)


def number(path: Path, config: dict[str, str], key: str) -> float:
    """A key's value as a number above 0. Raises InputError naming the key."""
    try:
        value = float(config[key])
    except KeyError as problem:
        raise InputError(f"{path}: {CONFIG} has no {key}") from problem
    except ValueError as problem:
        raise InputError(f"{path}: {CONFIG} says {key} = {config[key]}; it is a number") from problem
    if not 0 < value < float("inf"):
        raise InputError(f"{path}: {CONFIG} says {key} = {config[key]}; it is above 0")
    return value


def _first_layer_mm(path: Path, slicer: dict[str, str], layer_mm: float) -> float:
    return number(path, slicer, "initial_layer_height") if "initial_layer_height" in slicer else layer_mm


def _pitch_mm(slicer: dict[str, str], size: tuple[int, int]) -> tuple[float, float] | None:
    """The panel's pitch along the image's columns and rows: axes swap where the image is the panel turned."""
    try:
        pixels = int(slicer["display_pixels_x"]), int(slicer["display_pixels_y"])
        sides = float(slicer["display_width"]), float(slicer["display_height"])
        pitch = sides[0] / pixels[0], sides[1] / pixels[1]
    except (KeyError, ValueError, ZeroDivisionError):
        known = PITCH_BY_SIZE.get(size)
        return (known, known) if known else None
    return pitch if pixels == size or pixels != size[::-1] else pitch[::-1]


def with_used_material(config: bytes, added_ml: float) -> bytes:
    """config.ini with `usedMaterial` (ml) changed by so much; every other byte as it was."""

    def changed(match: re.Match[bytes]) -> bytes:
        return match[1] + f"{max(float(match[2]) + added_ml, 0):.6f}".encode()

    return re.sub(rb"(?m)^(usedMaterial\s*=\s*)([0-9.]+)", changed, config)
