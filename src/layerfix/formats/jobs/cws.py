"""CWS: Creation Workshop's zip, as NovaMaker and others write it. PNG images, a G-code, and slice.conf.

slice.conf holds ``key value`` lines: xppm and yppm (pixels per mm), thickness (mm), layers_num … Jobs of Creation
Workshop itself and of uv3dp have none: the same is in comments at the start of their G-code, where uv3dp writes the
pitch in mm by the name of pixels per mm.
Images may be RGB with three LCD pixels in each, blue leftmost.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from layerfix.errors import InputError
from layerfix.formats.jobs.container import Frame
from layerfix.formats.jobs.zip_job import check_layers, zip_job
from layerfix.formats.jobs.zips import Archive
from layerfix.formats.png.rgb_packed import rgb_packer, rgb_unpacker
from layerfix.formats.png.series import gaps_in, numeric_order
from layerfix.formats.text_values import keyed_numbers, number_above_0
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.formats.hints import Hints
    from layerfix.formats.probe import Probe
    from layerfix.stack import LayerStack

SUFFIXES = (".cws",)
CONF = "slice.conf"
LARGEST_CONF = 1 << 16  # bytes; those of real jobs have some hundred
LAYER = re.compile(r".*[0-9]\.png", re.IGNORECASE | re.DOTALL)
RGB = 2
COMMENT = re.compile(r"^;\(([A-Za-z ]{1,40})=\s*([0-9.]{1,20})", re.MULTILINE)
NAMES = {"pix per mm x": "xppm", "pix per mm y": "yppm", "layer thickness": "thickness"}
LEAST_PER_MM = 1.0  # pixels per mm: nobody's are larger than a millimetre


def _conf_name(archive: Archive) -> str | None:
    return next((name for name in archive.entries if name.lower() == CONF), None)


def _values(archive: Archive) -> dict[str, float]:
    """What slice.conf says or, without one, the comments of the G-code, by the names of slice.conf."""
    conf = _conf_name(archive)
    if conf is not None:
        return keyed_numbers(archive.text(conf, LARGEST_CONF))
    names = [name for name in archive.entries if name.lower().endswith(".gcode")]
    values: dict[str, float] = {}
    for comment in COMMENT.findall(archive.head(names[0], LARGEST_CONF).decode("latin-1")) if names else ():
        key, number = NAMES.get(comment[0].strip().lower()), number_above_0(comment[1])
        if key is not None and number is not None:
            values[key] = number
    for key in ("xppm", "yppm"):
        if values.get(key, 1.0) < LEAST_PER_MM:  # it is the pitch
            values[key] = 1 / values[key]
    return values


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a job. Raises InputError if neither file nor options say pitch and layer height."""
    archive = probe.archive
    values = _values(archive)
    names = sorted((n for n in archive.entries if LAYER.fullmatch(n)), key=numeric_order)
    width, height, colour = check_layers(archive, names, (0, RGB))
    said = int(values["layers_num"]) if "layers_num" in values else None
    notes = gaps_in(str(archive.path), names, said)
    width *= 3 if colour == RGB else 1
    pitch = (1 / values["xppm"], 1 / values["yppm"]) if {"xppm", "yppm"} <= values.keys() else None
    pixel_mm = hints.pitch(pitch)
    layer_mm = hints.layer(values.get("thickness"))
    if pixel_mm is None or layer_mm is None:
        raise InputError(
            f"{archive.path}: neither {CONF} nor the G-code says pixels per mm and layer thickness; give --printer,"
            " or --pixel and --layer"
        )
    frame = Frame(width, height, pixel_mm, layer_bounds_mm(len(names), layer_mm, hints.first_layer_mm))
    size = width, height
    if colour != RGB:
        return zip_job(archive, names, frame, hints, SUFFIXES, lambda totals, spool: {}, notes=notes)
    unpack, repack = rgb_unpacker(size, hints.threshold, bgr=True), rgb_packer(size, bgr=True)
    return zip_job(archive, names, frame, hints, SUFFIXES, lambda totals, spool: {}, unpack=unpack, repack=repack,
                   notes=notes)  # fmt: skip
