"""Layers as numbered PNG files in a folder or a zip: the least common denominator of mask printers.

Files are ordered by the numbers in their names (`layerfix.formats.png.series`). What layerfix writes also says what
no plain PNG stack says: the pitch (pHYs chunk, and exactly in a tEXt chunk), the origin, and each layer's z. Other
programs skip those chunks.
"""

from __future__ import annotations

import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from layerfix.errors import InputError, OutputError
from layerfix.files import A_LONG_TIME_AGO, check_input, reading, whole_file, whole_folder
from layerfix.formats.encoding import encoded
from layerfix.formats.jobs.zip_job import MAX_PANEL_PX
from layerfix.formats.png.decode import decode_png
from layerfix.formats.png.encode import SIGNATURE, encode_grey_png, encode_png
from layerfix.formats.png.series import series_of
from layerfix.formats.text_values import LARGEST_NUMBER, abridged, parse_json
from layerfix.layers.grey_source import GreySource, greys_of, seen_from_above
from layerfix.stack import Layer, LayerStack, layer_bounds_mm
from layerfix.units import counted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.formats.hints import Hints
    from layerfix.formats.options import PngOptions
    from layerfix.formats.probe import Probe

TEXT_KEY = "layerfix"
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
HEAD_BYTES = 1024  # IHDR, pHYs and our tEXt come first and are shorter than this


class Source(NamedTuple):
    """Where layers come from: names in order, the bytes of one (refused over a limit) or the first of them, notes."""

    where: str
    names: list[str]
    load: Callable[[str, int], bytes]
    head: Callable[[str], bytes]
    told: tuple[str, ...] = ()


class Head(NamedTuple):
    """What the start of a PNG says."""

    width: int
    height: int
    colour: int
    most_bytes: int  # of a file with such an image
    pixel_mm: tuple[float, float] | None
    notes: dict[str, Any]
    frames: int  # more than one in an animation


def read_folder(probe: Probe, hints: Hints) -> LayerStack:
    """Every ``.png`` directly in the folder, as a stack that decodes when asked."""
    path = probe.path
    with reading(path):
        names, told = series_of(str(path), (p.name for p in path.iterdir() if not p.is_dir()))
    for name in names:  # a pipe, or a link to a layer that is gone
        check_input(path / name)

    def read(name: str, size: int) -> bytes:
        with reading(path / name), (path / name).open("rb") as file:
            return file.read(size)

    def load(name: str, limit: int) -> bytes:
        data = read(name, limit + 1)
        if len(data) > limit:
            raise InputError(f"{path / name}: has over {limit} bytes, more than an image of its size needs")
        return data

    return _stack(Source(str(path), names, load, lambda name: read(name, HEAD_BYTES), told), hints)


def read_zip(probe: Probe, hints: Hints) -> LayerStack:
    """Every ``.png`` entry of the zip, as a stack that decodes when asked."""
    archive = probe.archive
    where = str(archive.path)
    names, told = series_of(where, archive.entries)
    return _stack(Source(where, names, archive.read, lambda name: archive.head(name, HEAD_BYTES), told), hints)


def read_image(probe: Probe, hints: Hints) -> LayerStack:
    """A single PNG file, as a stack of one layer."""
    path = probe.path

    def read(name: str, size: int = -1) -> bytes:
        with reading(path), path.open("rb") as file:
            return file.read(size)

    return _stack(Source(str(path.parent), [path.name], read, lambda name: read(name, HEAD_BYTES)), hints)


def _stack(source: Source, hints: Hints) -> LayerStack:
    if not source.names:
        raise InputError(f"{source.where}: no PNG images in it; layers are files such as 0001.png, 0002.png")
    heads = [_head(f"{source.where}/{name}", source.head(name)) for name in source.names]
    first = heads[0]
    for name, head in zip(source.names, heads, strict=True):
        if (head.width, head.height) != (first.width, first.height):
            raise InputError(
                f"{source.where}: {name} is {head.width} × {head.height} px,"
                f" {source.names[0]} {first.width} × {first.height} px; all layers have one size"
            )
    pixel_mm = hints.pitch(first.pixel_mm)
    z_mm = _z_mm(source.where, heads, hints)
    if pixel_mm is None or z_mm is None:
        missing = " and ".join(w for w, v in (("pixel pitch", pixel_mm), ("layer height", z_mm)) if v is None)
        raise InputError(
            f"{source.where}: the images do not say their {missing}; give --printer, or --pixel and --layer"
        )
    x, y = first.notes.get("origin_mm", (0.0, first.height * pixel_mm[1]))

    notes = (*source.told, *_colour_note(heads), *_frames_note(source.names, heads))
    size, how = (first.width, first.height), (first.width, hints.threshold, hints.grey_floor, "")

    def make(index: int) -> Layer:
        name = source.names[index]
        where = f"{source.where}/{name}"
        decoded = decode_png(source.load(name, heads[index].most_bytes), where, size, threshold=hints.threshold)
        kept = GreySource(*seen_from_above(decoded.rows, decoded.grey, *how), hints.threshold, "")
        bottom, top = z_mm[index].tolist()
        return Layer(kept.seen, first.width, (bottom, top), source=kept, dimmed_px=kept.dimmed_px)

    try:
        return LayerStack(first.width, first.height, pixel_mm, z_mm, make, (x, y), notes=notes)
    except InputError as problem:
        raise InputError(f"{source.where}: {problem}") from problem


def _colour_note(heads: list[Head]) -> tuple[str, ...]:
    """A word about images that are not grey: their brightness is read, and written as grey."""
    coloured = sum(head.colour != 0 for head in heads)
    return (f"{coloured} of {len(heads)} images are in colour; they are read as grey",) if coloured else ()


def _frames_note(names: list[str], heads: list[Head]) -> tuple[str, ...]:
    """A word about animations: a layer is their first image, the one that every program shows."""
    moving = [(name, head.frames) for name, head in zip(names, heads, strict=True) if head.frames > 1]
    if not moving:
        return ()
    name, frames = moving[0]
    others = f" and {counted(len(moving) - 1, 'other')}" if len(moving) > 1 else ""
    return (f"{abridged(name)}{others} is an animation of {frames} images; only the first is read",)


def _z_mm(where: str, heads: list[Head], hints: Hints) -> NDArray[np.float64] | None:
    said = [head.notes.get("z_mm") for head in heads]
    if None not in said:
        return hints.bounds(where, np.array(said, np.float64).reshape(-1, 2))
    if hints.layer_mm is not None:
        return layer_bounds_mm(len(heads), hints.layer_mm, hints.first_layer_mm)
    if hints.printer is None:
        return None
    return layer_bounds_mm(len(heads), hints.printer.layer_mm, hints.first_layer_mm or hints.printer.first_layer_mm)


def _head(where: str, data: bytes) -> Head:
    """Width, height, pitch and our notes from the first bytes of a PNG. Raises InputError if it is none."""
    if data[:8] != SIGNATURE or data[12:16] != b"IHDR" or len(data) < 33:
        raise InputError(f"{where}: not a readable PNG image")
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    if not 0 < width * height <= MAX_PANEL_PX:
        raise InputError(f"{where}: says {width} × {height} px; at most {MAX_PANEL_PX} are read")
    pixel_mm: tuple[float, float] | None = None
    notes: dict[str, Any] = {}
    frames = 1
    at = 33
    while at + 8 <= len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + size]
        if kind == b"IDAT":
            break
        if kind == b"pHYs" and len(body) == 9:
            x, y, unit = struct.unpack(">IIB", body)
            if unit == 1 and x and y:
                pixel_mm = 1000 / x, 1000 / y
        if kind == b"acTL" and len(body) == 8:
            frames = int.from_bytes(body[:4], "big")
        if kind == b"tEXt" and body.startswith(TEXT_KEY.encode() + b"\0"):
            notes = _notes(where, body.partition(b"\0")[2])
        at += 12 + size
    if "pixel_mm" in notes:
        pixel_mm = notes["pixel_mm"]
    row_bytes = 1 + (width * depth * CHANNELS.get(colour, 4) + 7) // 8
    return Head(width, height, colour, height * row_bytes * 5 // 4 + (1 << 20), pixel_mm, notes, frames)


def _notes(where: str, text: bytes) -> dict[str, Any]:
    """Our tEXt chunk: pairs of numbers by name; what is not of that form is not ours, and ignored.

    Raises InputError for a pair whose numbers are not finite, or too large for any printer.
    """
    try:
        found = parse_json(text)
    except ValueError:
        return {}
    if not isinstance(found, dict):
        return {}
    notes = {}
    for key in ("pixel_mm", "origin_mm", "z_mm"):
        value = found.get(key)
        if not isinstance(value, list) or len(value) != 2 or not all(type(n) in (int, float) for n in value):
            continue
        if not all(abs(n) < LARGEST_NUMBER for n in value):  # nan neither
            shown = abridged(json.dumps(value))
            raise InputError(f"{where}: says {key} {shown}; its numbers are finite and below {LARGEST_NUMBER:g}")
        notes[key] = float(value[0]), float(value[1])
    return notes


def _encoder(stack: LayerStack, bits: int) -> Callable[[Layer], bytes]:
    def encode(layer: Layer) -> bytes:
        notes = {"pixel_mm": stack.pixel_mm, "origin_mm": stack.origin_mm, "z_mm": layer.z_mm}
        text = {TEXT_KEY: json.dumps(notes)}
        image = greys_of(layer, bits)
        if image is not None:
            return encode_grey_png(image, pixel_mm=stack.pixel_mm, text=text)
        return encode_png(layer.rows, layer.width, bits=bits, pixel_mm=stack.pixel_mm, text=text)

    return encode


def layer_name(index: int) -> str:
    """``00000.png``, ``00001.png`` …: lexical order is numeric order up to 100,000 layers."""
    return f"{index:05}.png"


def write_folder(path: Path, stack: LayerStack, options: PngOptions) -> None:
    """One PNG a layer into a new folder."""
    images = encoded(stack, _encoder(stack, options.bits), options.watch, once=False)
    with whole_folder(path, force=options.force) as folder:
        for index, data in enumerate(images):
            (folder / layer_name(index)).write_bytes(data)


def write_image(path: Path, stack: LayerStack, options: PngOptions) -> None:
    """The only layer of a stack as one PNG file. Raises OutputError for a stack of several."""
    if len(stack) != 1:
        raise OutputError(
            f"{path}: one PNG image holds one layer, not {len(stack)}; write a folder or a .zip, or one layer of them"
            " (stack[3:4], --layers 3)"
        )
    (data,) = encoded(stack, _encoder(stack, options.bits), options.watch, once=False)
    with whole_file(path, force=options.force) as file:
        file.write(data)


def write_zip(path: Path, stack: LayerStack, options: PngOptions) -> None:
    """One PNG a layer into a zip, stored: a PNG does not shrink again."""
    images = encoded(stack, _encoder(stack, options.bits), options.watch, once=False)
    with whole_file(path, force=options.force) as file, zipfile.ZipFile(file, "w") as archive:
        for index, data in enumerate(images):
            archive.writestr(zipfile.ZipInfo(layer_name(index), A_LONG_TIME_AGO), data)
