"""SL1, SL1S, M1: the jobs of Prusa's resin printers.

A zip of 8-bit grey PNG images whose names begin with config.ini's `jobDir` (other images are no layers), in
the order of their names. The firmware reads config.ini; prusaslicer.ini says the panel's size, where it is there.
Sources: the firmware's project reader (keys), PrusaSlicer's archive writer.
"""

from __future__ import annotations

import io
import os
import re
import time
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.bits import mirrored
from layerfix.errors import InputError
from layerfix.files import whole_file
from layerfix.formats.encoding import PanelGreys, checked_printer, encoded
from layerfix.formats.jobs.container import Frame, Spool, Totals
from layerfix.formats.jobs.preview import Preview
from layerfix.formats.jobs.zip_job import check_layers, zip_job
from layerfix.formats.png.encode import encode_grey_png, encode_png
from layerfix.formats.png.series import IMAGES, gaps_in, listed, unlike_in
from layerfix.formats.text_values import LARGEST_NUMBER, abridged, machine_name
from layerfix.stack import layer_bounds_mm

if TYPE_CHECKING:
    from layerfix.bits import Image
    from layerfix.formats.hints import Hints
    from layerfix.formats.jobs.zips import Archive
    from layerfix.formats.options import WriteOptions
    from layerfix.formats.probe import Probe
    from layerfix.printers import Printer
    from layerfix.stack import Layer, LayerStack

SUFFIXES = (".sl1", ".sl1s", ".m1")
CONFIG, SLICER = "config.ini", "prusaslicer.ini"
THUMBNAILS = ((400, 400), (800, 480))
MASK = "mask.png"  # what the firmware lays over every layer
SECONDS_BETWEEN_LAYERS = 6.0  # tilting, roughly; the firmware makes its own estimate
# Panels of the three printers by image size, for jobs without prusaslicer.ini.
PITCH_BY_SIZE = {(1440, 2560): 0.04725, (1620, 2560): 0.05}


def parse_ini(text: str) -> dict[str, str]:
    """``key = value`` lines; later ones win, anything else is skipped."""
    found = {}
    for line in text.splitlines():
        key, separator, value = line.partition("=")
        if separator and not line.lstrip().startswith(("#", ";", "[")):
            found[key.strip()] = value.strip()
    return found


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a job. Raises InputError for a missing layer height, no layers, and what is no 8-bit grey."""
    archive = probe.archive
    config = parse_ini(archive.text(CONFIG))
    job = config["jobDir"]  # "thumb", say: the previews are in a folder, layers are not
    names = sorted(n for n in archive.entries
                   if n.startswith(job) and n.lower().endswith(".png") and "/" not in n[len(job):])  # fmt: skip
    width, height, _ = check_layers(archive, names, (0,))
    where = str(archive.path)
    notes = (*gaps_in(where, names, _said(config), job), *unlike_in(names), *_strangers(archive, job))
    slicer = parse_ini(archive.text(SLICER)) if SLICER in archive else {}
    pixel_mm = hints.pitch(_pitch_mm(slicer, (width, height)))
    if pixel_mm is None:
        raise InputError(f"{archive.path}: the job does not say its pixel pitch; give --printer or --pixel")
    said_mm = number(archive.path, config, "layerHeight")
    layer_mm = hints.layer(said_mm) or said_mm
    first_mm = hints.first_layer(_first_layer_mm(archive.path, slicer, layer_mm))
    frame = Frame(width, height, pixel_mm, layer_bounds_mm(len(names), layer_mm, first_mm))

    def metadata(totals: Totals, spool: Spool) -> dict[str, bytes]:
        return {CONFIG: with_used_material(archive.read(CONFIG), totals.added_mm3 / 1000)}

    return zip_job(archive, names, frame, hints, SUFFIXES, metadata, mirror=_mirror(slicer),
                   machine=machine_name(config.get("printerModel", "").encode()), notes=notes)  # fmt: skip


def _said(config: dict[str, str]) -> int | None:
    """How many layers config.ini speaks of: every one is exposed either slowly or fast."""
    counts = [config.get(key, "") for key in ("numFast", "numSlow")]
    return sum(map(int, counts)) if all(re.fullmatch("[0-9]{1,9}", count) for count in counts) else None


def _strangers(archive: Archive, job: str) -> tuple[str, ...]:
    """A word about images beside the layers: the firmware prints none of them."""
    names = [n for n in archive.entries
             if n.lower().endswith(IMAGES) and "/" not in n and not n.startswith(job) and n != MASK]  # fmt: skip
    if not names:
        return ()
    return (f"no layers, since their names do not begin with {abridged(job)} (jobDir): {listed(names)}",)


def number(path: Path, config: dict[str, str], key: str, file: str = CONFIG) -> float:
    """A key's value as a number above 0. Raises InputError naming the key."""
    try:
        value = float(config[key])
    except KeyError as problem:
        raise InputError(f"{path}: {file} has no {key}") from problem
    except ValueError as problem:
        raise InputError(f"{path}: {file} says {key} = {abridged(config[key])}; it is a number") from problem
    if not 0 < value < LARGEST_NUMBER:
        raise InputError(
            f"{path}: {file} says {key} = {abridged(config[key])}; it is above 0 and below {LARGEST_NUMBER:g}"
        )
    return value


def _first_layer_mm(path: Path, slicer: dict[str, str], layer_mm: float) -> float:
    return number(path, slicer, "initial_layer_height", SLICER) if "initial_layer_height" in slicer else layer_mm


def _pitch_mm(slicer: dict[str, str], size: tuple[int, int]) -> tuple[float, float] | None:
    """The panel's pitch along the image's columns and rows: axes swap where the image is the panel turned."""
    try:
        pixels = int(slicer["display_pixels_x"]), int(slicer["display_pixels_y"])
        sides = float(slicer["display_width"]), float(slicer["display_height"])
        pitch = sides[0] / pixels[0], sides[1] / pixels[1]
    except (KeyError, ValueError, ArithmeticError):
        known = PITCH_BY_SIZE.get(size)
        return (known, known) if known else None
    return pitch if pixels == size or pixels != size[::-1] else pitch[::-1]


def _mirror(slicer: dict[str, str]) -> str:
    """Axes the panel shows mirrored: what prusaslicer.ini says, else x, as on all of these printers."""
    if "display_mirror_x" not in slicer:
        return "x"
    return "".join(axis for axis in "xy" if slicer.get(f"display_mirror_{axis}") == "1")


def with_used_material(config: bytes, added_ml: float) -> bytes:
    """config.ini with `usedMaterial` (ml) changed by so much; every other byte as it was."""

    def changed(match: re.Match[bytes]) -> bytes:
        try:
            old_ml = float(match[2])
        except ValueError:
            return match[0]
        return match[1] + f"{max(old_ml + added_ml, 0):.6f}".encode()

    return re.sub(rb"(?m)^(usedMaterial[ \t]*=[ \t]*)([^\s]+)", changed, config)


def write(path: Path, stack: LayerStack, options: WriteOptions) -> None:
    """A new job for one of Prusa's resin printers: exposure from the printer's file, previews drawn.

    Raises OutputError without a printer, for one that lacks exposures or is no SL1, and for layers of another size.
    """
    printer = checked_printer(path, stack, options, SUFFIXES)
    greys = PanelGreys(printer, options)
    job, preview = path.stem, Preview(stack)
    mirror, width = printer.mirror, stack.width
    volume_mm3 = 0.0

    def encode(layer: Layer) -> tuple[bytes, Image, int]:
        image = greys(layer)
        if image is not None:
            data = encode_grey_png(image.mirrored(mirror))
        else:
            data = encode_png(mirrored(layer.rows, width, mirror), width)
        return data, preview.reduce(layer), layer.count_px()

    pixel_mm2 = stack.pixel_mm[0] * stack.pixel_mm[1]
    with whole_file(path, force=options.force) as file, zipfile.ZipFile(file, "w") as archive:
        for index, (data, blocks, solid_px) in enumerate(encoded(stack, encode, options.watch, once=True)):
            bottom, top = stack.z_mm[index].tolist()
            preview.add(blocks, top)
            volume_mm3 += solid_px * pixel_mm2 * (top - bottom)
            archive.writestr(_entry(f"{job}{index:05}.png"), data)
        greys.tell()
        for size in THUMBNAILS:
            picture = io.BytesIO()
            preview.picture(size).save(picture, "PNG")
            archive.writestr(_entry(f"thumbnail/thumbnail{size[0]}x{size[1]}.png"), picture.getvalue())
        archive.writestr(_entry(CONFIG), _config(job, stack, printer, volume_mm3))
        archive.writestr(_entry(SLICER), _slicer(stack, printer))


def _entry(name: str) -> zipfile.ZipInfo:
    return zipfile.ZipInfo(name, time.gmtime(_now())[:6])


def _now() -> float:
    """The time of writing, or SOURCE_DATE_EPOCH, so that builds can be reproduced."""
    return float(os.environ.get("SOURCE_DATE_EPOCH", time.time()))


def _heights_mm(stack: LayerStack) -> tuple[float, float]:
    """(first layer, the others)."""
    first = stack.z_mm[0, 1] - stack.z_mm[0, 0]
    other = stack.z_mm[-1, 1] - stack.z_mm[-1, 0]
    return round(float(first), 6), round(float(other), 6)


def _config(job: str, stack: LayerStack, printer: Printer, volume_mm3: float) -> str:
    """config.ini: what the firmware reads."""
    model = re.search(r"\b(SL1S|SL1|M1)\b", printer.model)
    fade = printer.transition_layers or 0
    values = {
        "action": "print",
        "expTime": f"{printer.exposure_s:g}",
        "expTimeFirst": f"{printer.bottom_exposure_s:g}",
        "expUserProfile": 0,
        "fileCreationTimestamp": time.strftime("%Y-%m-%d at %H:%M:%S UTC", time.gmtime(_now())),
        "hollow": 0,
        "jobDir": job,
        "layerHeight": f"{_heights_mm(stack)[1]:g}",
        "materialName": "layerfix",
        "numFade": fade,
        "numFast": len(stack),
        "numSlow": 0,
        "printProfile": "layerfix",
        "printTime": f"{len(stack) * ((printer.exposure_s or 0) + SECONDS_BETWEEN_LAYERS):.6f}",
        "printerModel": model[1] if model else "SL1",
        "printerProfile": printer.model,
        "printerVariant": "default",
        "usedMaterial": f"{volume_mm3 / 1000:.6f}",
    }
    return "".join(f"{key} = {value}\n" for key, value in values.items())


def _slicer(stack: LayerStack, printer: Printer) -> str:
    """prusaslicer.ini: the panel, for programs that look there (UVtools does)."""
    first, other = _heights_mm(stack)
    values = {
        "display_height": f"{printer.room_mm[1]:g}",
        "display_mirror_x": int("x" in printer.mirror),
        "display_mirror_y": int("y" in printer.mirror),
        "display_orientation": "landscape",
        "display_pixels_x": stack.width,
        "display_pixels_y": stack.height,
        "display_width": f"{printer.room_mm[0]:g}",
        "exposure_time": f"{printer.exposure_s:g}",
        "faded_layers": printer.transition_layers or 0,
        "initial_exposure_time": f"{printer.bottom_exposure_s:g}",
        "initial_layer_height": f"{first:g}",
        "layer_height": f"{other:g}",
        "printer_model": printer.model,
        "printer_settings_id": printer.name,
    }
    return "".join(f"{key} = {value}\n" for key, value in values.items())
