"""NanoDLP's plates: a zip of numbered PNG images and JSON files.

12K panels may be stored with three LCD pixels in each RGB pixel (the image is a third as wide). plate.json's total
area follows what changes; info.json's measures of single layers stay as they were sliced. Lengths in slicer.json
and profile.json are µm.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from layerfix.errors import InputError
from layerfix.formats.container import Frame, Totals, hinted_pitch
from layerfix.formats.rgb_packed import rgb_packer, rgb_unpacker
from layerfix.formats.zip_job import check_layers, zip_job
from layerfix.formats.zips import Archive
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.formats.options import Hints
    from layerfix.stack import LayerStack

SUFFIXES = (".nanodlp", ".zip")
PLATE, SLICER, PROFILE = "plate.json", "slicer.json", "profile.json"
LAYER = re.compile(r"[0-9]+\.png")
RGB = 2


def recognises(archive: Archive) -> bool:
    """A plate.json beside a profile.json or slicer.json."""
    return PLATE in archive and (SLICER in archive or PROFILE in archive)


def read(archive: Archive, hints: Hints) -> LayerStack:
    """The layers of a plate. Raises InputError if neither file nor options say pitch and layer height."""
    slicer, profile = _json(archive, SLICER), _json(archive, PROFILE)
    plate = archive.read(PLATE)
    names = sorted((n for n in archive.entries if LAYER.fullmatch(n)), key=lambda n: int(n[:-4]))
    width, height, colour = check_layers(archive, names, (0, RGB))
    width *= 3 if colour == RGB else 1
    pitch = _mm(slicer, "XPixelSize"), _mm(slicer, "YPixelSize")
    pixel_mm = hinted_pitch(hints, (pitch[0], pitch[1]) if pitch[0] and pitch[1] else None)
    layer_mm = hints.layer_mm or _mm(profile, "Depth") or (hints.printer.layer_mm if hints.printer else None)
    if pixel_mm is None or layer_mm is None:
        raise InputError(f"{archive.path}: the plate does not say its pixel size and layer depth; give --printer")
    frame = Frame(width, height, pixel_mm, layer_bounds_mm(len(names), layer_mm, hints.first_layer_mm))

    def metadata(totals: Totals) -> dict[str, bytes]:
        return {PLATE: _with_area(plate, totals.added_mm3 / layer_mm)}

    size = width, height
    if colour != RGB:
        return zip_job(archive, names, frame, hints, SUFFIXES, metadata)
    unpack, repack = rgb_unpacker(size, hints.threshold, bgr=False), rgb_packer(size, bgr=False)
    return zip_job(archive, names, frame, hints, SUFFIXES, metadata, unpack=unpack, repack=repack)


def _json(archive: Archive, name: str) -> dict[str, Any]:
    if name not in archive:
        return {}
    try:
        found = json.loads(archive.text(name))
    except ValueError as problem:
        raise InputError(f"{archive.path}: {name} is not valid JSON ({problem})") from problem
    return found if isinstance(found, dict) else {}


def _mm(values: dict[str, Any], key: str) -> float | None:
    """A length in µm as mm (a value below 1 is taken for mm already); None if there is none."""
    value = values.get(key)
    if not isinstance(value, int | float) or not 0 < value < 1e6:
        return None
    return float(value) / 1000 if value >= 1 else float(value)


def _with_area(plate: bytes, added_mm2: float) -> bytes:
    """plate.json with TotalSolidArea (mm², over all layers) grown; every other byte as it was."""

    def grown(match: re.Match[bytes]) -> bytes:
        return match[1] + f"{max(float(match[2]) + added_mm2, 0):.4f}".encode()

    return re.sub(rb'("TotalSolidArea"\s*:\s*)([0-9.]+)', grown, plate, count=1)
