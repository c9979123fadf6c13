"""NanoDLP's plates: a zip of numbered PNG images and JSON files.

12K panels may be stored with three LCD pixels in each RGB pixel (the image is a third as wide). plate.json's total
area follows what changes, and info.json's measures of changed layers are taken anew. Lengths in slicer.json
and profile.json are µm.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.bits import unpack as unpack_rows
from layerfix.errors import InputError
from layerfix.formats.jobs.container import Frame, Spool, Totals, hinted_pitch
from layerfix.formats.jobs.zip_job import check_layers, zip_job
from layerfix.formats.jobs.zips import Archive
from layerfix.formats.png.decode import decode_png
from layerfix.formats.png.rgb_packed import rgb_packer, rgb_unpacker
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.bits import Image
    from layerfix.formats.options import Hints
    from layerfix.formats.probe import Probe
    from layerfix.stack import LayerStack

SUFFIXES = (".nanodlp", ".zip")
PLATE, SLICER, PROFILE, INFO = "plate.json", "slicer.json", "profile.json", "info.json"
LAYER = re.compile(r"[0-9]+\.png")
RGB = 2
LARGEST_INFO = 256 << 20


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a plate. Raises InputError if neither file nor options say pitch and layer height."""
    archive = probe.archive
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

    def metadata(totals: Totals, spool: Spool) -> dict[str, bytes]:
        new = {PLATE: _with_area(plate, totals.added_mm3 / layer_mm)}
        if INFO in archive:
            new[INFO] = _measured_anew(archive, names, spool, decode, pixel_mm)
        return new

    size = width, height
    mirror = "x" if slicer.get("ImageMirror") else ""
    unpack, repack = None, None
    if colour == RGB:
        unpack, repack = rgb_unpacker(size, hints.threshold, bgr=False), rgb_packer(size, bgr=False)

    def decode(data: bytes) -> Image:
        found = unpack(data, INFO) if unpack else decode_png(data, INFO, size, threshold=hints.threshold)
        return unpack_rows(found.rows, width)

    return zip_job(archive, names, frame, hints, SUFFIXES, metadata, mirror=mirror, unpack=unpack, repack=repack)


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


def _measured_anew(
    archive: Archive, names: list[str], spool: Spool, decode: Callable[[bytes], Image], pixel_mm: tuple[float, float]
) -> bytes:
    """info.json with the measures of changed layers: areas in mm², bounds in px. Keys it has not stay away."""
    raw = archive.read(INFO, LARGEST_INFO)
    try:
        layers = json.loads(raw)
    except ValueError:
        return raw
    if not isinstance(layers, list):
        return raw
    for index in range(min(len(names), len(layers))):
        data = spool.get(index)
        if data is not None and isinstance(layers[index], dict):
            new = _measures(decode(data), pixel_mm)
            layers[index].update({key: value for key, value in new.items() if key in layers[index]})
    return json.dumps(layers).encode()


def _measures(image: Image, pixel_mm: tuple[float, float]) -> dict[str, float]:
    """What NanoDLP notes of a layer: (H, W) bool → by key."""
    import cv2

    count, _, stats, _ = cv2.connectedComponentsWithStats(image.astype(np.uint8), connectivity=8)
    areas = stats[1:, cv2.CC_STAT_AREA] * (pixel_mm[0] * pixel_mm[1])
    if count < 2:
        return dict.fromkeys(("TotalSolidArea", "LargestArea", "SmallestArea", "AreaCount"), 0)
    left, top = stats[1:, cv2.CC_STAT_LEFT], stats[1:, cv2.CC_STAT_TOP]
    return {
        "TotalSolidArea": float(areas.sum()),
        "LargestArea": float(areas.max()),
        "SmallestArea": float(areas.min()),
        "MinX": int(left.min()),
        "MinY": int(top.min()),
        "MaxX": int((left + stats[1:, cv2.CC_STAT_WIDTH]).max()) - 1,
        "MaxY": int((top + stats[1:, cv2.CC_STAT_HEIGHT]).max()) - 1,
        "AreaCount": count - 1,
    }
