"""CWS: Creation Workshop's zip, as NovaMaker and others write it. PNG images, a G-code, and slice.conf.

slice.conf holds ``key value`` lines: xppm and yppm (pixels per mm), thickness (mm), layers_num …
Images may be RGB with three LCD pixels in each, blue leftmost.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from layerfix.errors import InputError
from layerfix.formats.jobs.container import Frame, hinted_pitch
from layerfix.formats.jobs.zip_job import check_layers, zip_job
from layerfix.formats.jobs.zips import Archive
from layerfix.formats.png.images import numeric_order
from layerfix.formats.png.rgb_packed import rgb_packer, rgb_unpacker
from layerfix.formats.text_values import keyed_numbers
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.formats.options import Hints
    from layerfix.formats.probe import Probe
    from layerfix.stack import LayerStack

SUFFIXES = (".cws",)
CONF = "slice.conf"
LARGEST_CONF = 1 << 16  # bytes; those of real jobs have some hundred
LAYER = re.compile(r".*[0-9]\.png", re.IGNORECASE | re.DOTALL)
RGB = 2


def _conf_name(archive: Archive) -> str | None:
    return next((name for name in archive.entries if name.lower() == CONF), None)


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a job. Raises InputError if neither file nor options say pitch and layer height."""
    archive = probe.archive
    values = keyed_numbers(archive.text(_conf_name(archive) or CONF, LARGEST_CONF))
    names = sorted((n for n in archive.entries if LAYER.fullmatch(n)), key=numeric_order)
    width, height, colour = check_layers(archive, names, (0, RGB))
    width *= 3 if colour == RGB else 1
    pitch = (1 / values["xppm"], 1 / values["yppm"]) if {"xppm", "yppm"} <= values.keys() else None
    pixel_mm = hinted_pitch(hints, pitch)
    layer_mm = hints.layer_mm or values.get("thickness") or (hints.printer.layer_mm if hints.printer else None)
    if pixel_mm is None or layer_mm is None:
        raise InputError(f"{archive.path}: {CONF} does not say xppm, yppm and thickness; give --printer")
    frame = Frame(width, height, pixel_mm, layer_bounds_mm(len(names), layer_mm, hints.first_layer_mm))
    size = width, height
    if colour != RGB:
        return zip_job(archive, names, frame, hints, SUFFIXES, lambda totals, spool: {})
    unpack, repack = rgb_unpacker(size, hints.threshold, bgr=True), rgb_packer(size, bgr=True)
    return zip_job(archive, names, frame, hints, SUFFIXES, lambda totals, spool: {}, unpack=unpack, repack=repack)
