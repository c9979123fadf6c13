"""NanoDLP's plates: a zip of numbered PNG images and JSON files.

12K panels may be stored with three LCD pixels in each RGB pixel (the image is a third as wide). plate.json's total
area follows what changes, and info.json's measures of changed layers are taken anew. Lengths in slicer.json
and profile.json are µm.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.bits import unpack as unpack_rows
from layerfix.errors import InputError
from layerfix.formats.jobs.container import Frame, Spool, Totals
from layerfix.formats.jobs.zip_job import check_layers, zip_job
from layerfix.formats.jobs.zips import LARGEST_SETTINGS, LARGEST_TEXT, Archive
from layerfix.formats.png.decode import decode_png
from layerfix.formats.png.rgb_packed import rgb_packer, rgb_unpacker
from layerfix.formats.png.series import gaps_in
from layerfix.formats.text_values import parse_json
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.bits import Image
    from layerfix.formats.hints import Hints
    from layerfix.formats.probe import Probe
    from layerfix.stack import LayerStack

SUFFIXES = (".nanodlp", ".zip")
PLATE, SLICER, PROFILE, INFO = "plate.json", "slicer.json", "profile.json", "info.json"
LAYER = re.compile(r"[0-9]+\.png")
RGB = 2
# Digits are bounded, as is white space: a pattern over a file of others must not go back and forth in it.
AREA = re.compile(
    rb'("TotalSolidArea"\s{0,99}:\s{0,99})(-?[0-9]{1,99}(?:\.[0-9]{1,99})?(?:[eE][-+]?[0-9]{1,3})?)(?![0-9.])'
)


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a plate. Raises InputError if neither file nor options say pitch and layer height."""
    archive = probe.archive
    slicer, profile = _object(archive, SLICER), _object(archive, PROFILE)
    _object(archive, PLATE)  # or it could not be kept true
    plate = archive.read(PLATE)
    names = sorted((n for n in archive.entries if LAYER.fullmatch(n)), key=lambda n: int(n[:-4]))
    width, height, colour = check_layers(archive, names, (0, RGB))
    notes = gaps_in(str(archive.path), names)
    width *= 3 if colour == RGB else 1
    pitch = _mm(slicer, "XPixelSize"), _mm(slicer, "YPixelSize")
    pixel_mm = hints.pitch((pitch[0], pitch[1]) if pitch[0] and pitch[1] else None)
    layer_mm = hints.layer(_mm(profile, "Depth"))
    if pixel_mm is None or layer_mm is None:
        raise InputError(f"{archive.path}: the plate does not say its pixel size and layer depth; give --printer")
    if INFO in archive:
        _measures_in(archive)
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

    return zip_job(archive, names, frame, hints, SUFFIXES, metadata, mirror=mirror, unpack=unpack, repack=repack,
                   notes=notes)  # fmt: skip


def _json(archive: Archive, name: str, limit: int) -> Any:
    try:
        return parse_json(archive.text(name, limit))
    except ValueError as problem:
        raise InputError(f"{archive.path}: {name} is not valid JSON ({problem})") from problem


def _object(archive: Archive, name: str) -> dict[str, Any]:
    found = _json(archive, name, LARGEST_SETTINGS) if name in archive else {}
    return found if isinstance(found, dict) else {}


def _measures_in(archive: Archive) -> list[Any]:
    """info.json: what is noted of each layer, bottom first; empty if it is something else."""
    found = _json(archive, INFO, LARGEST_TEXT)
    return found if isinstance(found, list) else []


def _mm(values: dict[str, Any], key: str) -> float | None:
    """A length in µm as mm (a value below 1 is taken for mm already); None if there is none."""
    value = values.get(key)
    if not isinstance(value, int | float) or not 0 < value < 1e6:
        return None
    return float(value) / 1000 if value >= 1 else float(value)


def _with_area(plate: bytes, added_mm2: float) -> bytes:
    """plate.json with TotalSolidArea (mm², over all layers) grown; every other byte as it was."""

    def grown(match: re.Match[bytes]) -> bytes:
        area_mm2 = float(match[2]) + added_mm2
        return match[1] + f"{max(area_mm2, 0):.4f}".encode() if math.isfinite(area_mm2) else match[0]

    return AREA.sub(grown, plate, count=1)


def _measured_anew(
    archive: Archive, names: list[str], spool: Spool, decode: Callable[[bytes], Image], pixel_mm: tuple[float, float]
) -> bytes:
    """info.json with the measures of changed layers: areas in mm², bounds in px. Keys it has not stay away."""
    layers = _measures_in(archive)
    if not layers:
        return archive.read(INFO)
    for index in range(min(len(names), len(layers))):
        data = spool.get(index)
        if data is not None and isinstance(layers[index], dict):
            new = _measures(decode(data), pixel_mm)
            layers[index].update({key: value for key, value in new.items() if key in layers[index]})
    try:
        return json.dumps(layers).encode()
    except RecursionError as problem:  # the limit counts from where one stands
        raise InputError(f"{archive.path}: {INFO} is nested too deeply") from problem


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
