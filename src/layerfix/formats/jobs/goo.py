"""GOO V3: Elegoo's open format. Specification: "GOO format V1.2" by Elegoo; sizes as UVtools and mslicer agree.

Big-endian: a header of 195,477 bytes with two RGB565 previews, then the layers one after the other (a 66-byte
definition, the size, 0x55, the runs, a checksum, CR LF), then an ending.
"""

from __future__ import annotations

import mmap
import struct
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from layerfix import __version__
from layerfix.bits import mirrored, words_for
from layerfix.errors import InputError
from layerfix.files import reading, whole_file
from layerfix.formats.encoding import PanelGreys, checked_printer, encoded
from layerfix.formats.jobs.container import (
    Container,
    Frame,
    Spool,
    Totals,
    bounds_of_table,
    container_stack,
    repeats_of,
)
from layerfix.formats.jobs.preview import Preview
from layerfix.formats.jobs.zip_job import MAX_PANEL_PX
from layerfix.formats.png.decode import Decoded
from layerfix.formats.text_values import machine_name

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL.Image import Image as Picture

    from layerfix.bits import Image, Rows
    from layerfix.formats.hints import Hints
    from layerfix.formats.options import WriteOptions
    from layerfix.formats.probe import Probe
    from layerfix.layers.grey_image import Greys
    from layerfix.printers import Printer
    from layerfix.stack import Layer, LayerStack

SUFFIXES = (".goo",)
MAGIC = bytes([7, 0, 0, 0]) + b"DLP\0"
HEADER_BYTES = 195477
LAYER = struct.Struct(">H15fH2s")  # pause, pause z, z, exposure, off time, …, light, CR LF
ENDING = bytes([0, 0, 0]) + MAGIC
# Offsets of header fields: 160 bytes of text, three shorts, two previews with their CR LF.
LAYERS_AT = 4 + 8 + 32 + 24 + 24 + 32 + 32 + 32 + 6 + 2 * 116 * 116 + 2 + 2 * 290 * 290 + 2
COUNTS = struct.Struct(">IHH??ffff")  # layers, x, y, mirrors, bed x y z, layer height
VOLUME_AT = HEADER_BYTES - 3 - 4 - 8 - 12
TAIL = struct.Struct(">fff8sI?H")  # volume mm³, weight g, price, currency, offset of the layers, 8-bit?, transitions
MAX_LAYERS = 100_000
# For printers whose file says nothing of them.
TYPICAL_LIFT_MM, TYPICAL_LIFT_MM_MIN, TYPICAL_RETRACT_MM_MIN = 7.0, 80.0, 180.0
TYPICAL_DENSITY_G_ML = 1.1


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a job. Raises InputError for headers and layers that make no sense."""
    path = probe.path
    with reading(path), path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    if len(data) < HEADER_BYTES:
        raise InputError(f"{path}: the file is cut short: {len(data)} bytes")
    count, width, height, mirror_x, mirror_y, bed_x, bed_y, _, layer_mm = COUNTS.unpack_from(data, LAYERS_AT)
    *_, offset, eight_bit, _ = TAIL.unpack_from(data, VOLUME_AT)
    if not (0 < width * height <= MAX_PANEL_PX and 0 < count <= MAX_LAYERS):
        raise InputError(f"{path}: the header says {count} layers of {width} × {height} px (only GOO V3 is read)")
    if not (0 < bed_x < 10_000 and 0 < bed_y < 10_000 and 0 < layer_mm < 10):
        raise InputError(f"{path}: the header says a bed of {bed_x:g} × {bed_y:g} mm and layers of {layer_mm:g} mm")
    places, tops = _layers(path, data, offset, count)
    pixel_mm = hints.pitch((round(bed_x / width, 6), round(bed_y / height, 6)))
    assert pixel_mm is not None  # the file says it
    z_mm = bounds_of_table(path, tops, hints, lambda z: _bounds(z, round(layer_mm, 6)))
    frame = Frame(width, height, pixel_mm, z_mm)

    def payload(index: int) -> bytes:
        at, size = places[index]
        return data[at : at + size]

    def decode(index: int, packed: bytes) -> Decoded:
        from layerfix.formats.jobs import runs

        rows = np.zeros((height, words_for(width)), np.uint64)
        pixels = np.frombuffer(packed, np.uint8)
        covered, greys = runs.decode_goo(pixels, width, hints.threshold, rows)
        if covered != width * height:
            raise InputError(f"{path}: layer {index} is broken: its runs cover {covered} of {width * height} px")
        if not greys:
            return Decoded(rows, None)
        grey = np.zeros((height, width), np.uint8)
        runs.decode_goo_greys(pixels, grey)
        if not eight_bit:
            grey = np.where(grey < 16, grey * 17, 255).astype(np.uint8)
        return Decoded(rows, grey)

    def encode(index: int, packed: bytes, rows: Rows, greys: NDArray[np.uint8] | Greys | None) -> bytes:
        from layerfix.formats.jobs import runs

        if greys is None:
            return bytes(runs.encode_runs(rows, width, True))
        held = greys if eight_bit else _to_4_bit(np.asarray(greys), hints.threshold)
        return bytes(runs.encode_greys(held, True))

    def save(target: BinaryIO, spool: Spool, totals: Totals) -> None:
        _save(target, data, places, spool, totals)

    container = Container(path, SUFFIXES, payload, decode, encode, save, hints.threshold, hints.grey_floor,
                          "x" * mirror_x + "y" * mirror_y, machine=machine_name(data[92:124]))  # fmt: skip
    same = repeats_of(payload(i) == payload(i - 1) for i in range(1, count))
    return container_stack(container, frame, same)


def _to_4_bit(grey: NDArray[np.uint8], threshold: int) -> NDArray[np.uint8]:
    """Greys in sixteen levels, white as 255; what is solid is not rounded below the threshold."""
    levels = np.where(grey >= threshold, np.ceil(grey / 17), np.round(grey / 17))
    return np.where(levels >= 15, 255, levels).astype(np.uint8)


def _layers(path: Path, data: mmap.mmap, at: int, count: int) -> tuple[list[tuple[int, int]], list[float]]:
    """((offset, size) of each layer's runs, each layer's z), checksums verified."""
    places, tops = [], []
    for index in range(count):
        if at + LAYER.size + 4 > len(data):
            raise InputError(f"{path}: the file is cut short: layer {index} of {count} is missing")
        tops.append(LAYER.unpack_from(data, at)[2])
        (size,) = struct.unpack_from(">I", data, at + LAYER.size)
        start = at + LAYER.size + 4
        if size < 2 or start + size + 2 > len(data):
            raise InputError(f"{path}: the file is cut short: layer {index} ends past the end of the file")
        if data[start] != 0x55:
            raise InputError(f"{path}: layer {index} does not begin as layers do")
        runs_bytes = np.frombuffer(data, np.uint8, size - 2, start + 1)
        if (~int(runs_bytes.sum()) & 0xFF) != data[start + size - 1]:
            raise InputError(f"{path}: layer {index} is broken: wrong checksum")
        places.append((start + 1, size - 2))
        at = start + size + 2
    return places, tops


def _bounds(tops_mm: NDArray[np.float64], layer_mm: float) -> NDArray[np.float64]:
    """Bounds of the layers; the file holds where each ends."""
    first = tops_mm[0] - layer_mm
    return np.stack([np.append(max(first, 0.0) if tops_mm[0] > 0 else first, tops_mm[:-1]), tops_mm], axis=1)


def write(path: Path, stack: LayerStack, options: WriteOptions) -> None:
    """A new job: exposure, lifts and speeds from the printer's file, previews drawn.

    Raises OutputError without a printer that takes GOO, and for layers that are not its panel's size.
    """
    printer = checked_printer(path, stack, options, SUFFIXES)
    greys = PanelGreys(printer, options)
    preview = Preview(stack)
    width, mirror = stack.width, printer.mirror
    pixel_mm2 = stack.pixel_mm[0] * stack.pixel_mm[1]
    volume_mm3 = 0.0

    def encode(layer: Layer) -> tuple[bytes, Image, int]:
        from layerfix.formats.jobs import runs

        image = greys(layer)
        if image is not None:
            data = runs.encode_greys(image.mirrored(mirror), True)
        else:
            data = runs.encode_runs(mirrored(layer.rows, width, mirror), width, True)
        return bytes(data), preview.reduce(layer), layer.count_px()

    with whole_file(path, force=options.force) as file:
        file.write(bytes(HEADER_BYTES))
        for index, (data, blocks, solid_px) in enumerate(encoded(stack, encode, options.watch, once=True)):
            bottom, top = stack.z_mm[index].tolist()
            preview.add(blocks, top)
            volume_mm3 += solid_px * pixel_mm2 * (top - bottom)
            file.write(_definition(printer, index, top))
            file.write(struct.pack(">I", len(data) + 2) + b"\x55" + data + bytes([~sum(data) & 0xFF]) + b"\r\n")
        greys.tell()
        file.write(ENDING)
        file.seek(0)
        file.write(_new_header(stack, printer, preview, volume_mm3))
        file.seek(0, 2)


def _lifts(printer: Printer) -> tuple[float, float, float, float, float]:
    """(lift, its speed, the bottom's lift, its speed, the way back's speed), typical where the file says nothing."""
    lift, speed = printer.lift_mm or TYPICAL_LIFT_MM, printer.lift_mm_min or TYPICAL_LIFT_MM_MIN
    bottom = printer.bottom_lift_mm or lift, printer.bottom_lift_mm_min or speed
    return lift, speed, *bottom, printer.retract_mm_min or TYPICAL_RETRACT_MM_MIN


def _exposure_s(printer: Printer, index: int) -> float:
    """Bottom exposure, then the usual one, with the transition layers in between."""
    usual, bottom = printer.exposure_s or 0.0, printer.bottom_exposure_s or 0.0
    past = index + 1 - (printer.bottom_layers or 0)
    steps = (printer.transition_layers or 0) + 1
    return bottom + (usual - bottom) * min(max(past, 0), steps) / steps


def _definition(printer: Printer, index: int, z_mm: float) -> bytes:
    """A layer's definition: what the printer does after it."""
    is_bottom = index < (printer.bottom_layers or 0)
    lift, speed, bottom_lift, bottom_speed, back = _lifts(printer)
    up, up_speed = (bottom_lift, bottom_speed) if is_bottom else (lift, speed)
    pwm = printer.bottom_light_pwm if is_bottom else printer.light_pwm
    wait = printer.light_off_s or 0.0
    return LAYER.pack(
        0, 0.0, z_mm, _exposure_s(printer, index), wait, 0.0, 0.0, wait, up, up_speed, 0.0, 0.0, up, back, 0.0, 0.0,
        255 if pwm is None else pwm, b"\r\n",
    )  # fmt: skip


def _new_header(stack: LayerStack, printer: Printer, preview: Preview, volume_mm3: float) -> bytes:
    lift, speed, bottom_lift, bottom_speed, back = _lifts(printer)
    wait, usual = printer.light_off_s or 0.0, printer.exposure_s or 0.0
    moves_s = 60 * (lift / speed + lift / back)
    seconds = sum(_exposure_s(printer, i) + wait + moves_s for i in range(len(stack)))
    written = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime())
    texts = ("layerfix", __version__, written, printer.model, printer.name, "default")
    head = struct.pack(
        ">4s8s32s24s24s32s32s32s3H", b"V3.0", MAGIC, *(t.encode("ascii", "replace") for t in texts), 1, 0, 0
    )
    thumbnails = b"".join(_rgb565(preview.picture((side, side))) + b"\r\n" for side in (116, 290))
    height = stack.z_mm[-1, 1] - stack.z_mm[-1, 0]
    counts = COUNTS.pack(len(stack), stack.width, stack.height, "x" in printer.mirror, "y" in printer.mirror,
                         *printer.room_mm, round(float(height), 6))  # fmt: skip
    times = struct.pack(
        ">f?8fI16f2H?I", usual, True, wait, 0.0, 0.0, wait, 0.0, 0.0, wait,
        printer.bottom_exposure_s, printer.bottom_layers or 0,
        bottom_lift, bottom_speed, lift, speed, bottom_lift, back, lift, back, *([0.0] * 8),
        255 if printer.bottom_light_pwm is None else printer.bottom_light_pwm,
        255 if printer.light_pwm is None else printer.light_pwm, True, round(seconds),
    )  # fmt: skip
    grams = volume_mm3 / 1000 * TYPICAL_DENSITY_G_ML
    tail = TAIL.pack(volume_mm3, grams, 0.0, b"$", HEADER_BYTES, True, printer.transition_layers or 0)
    header = head + thumbnails + counts + times + tail
    assert len(header) == HEADER_BYTES
    return header


def _rgb565(picture: Picture) -> bytes:
    """Big-endian 16-bit pixels: 5 bits red, 6 green, 5 blue."""
    red, green, blue = (np.asarray(band, np.uint16) for band in picture.split())
    return (red >> 3 << 11 | green >> 2 << 5 | blue >> 3).astype(">u2").tobytes()


def _save(target: BinaryIO, data: mmap.mmap, places: list[tuple[int, int]], spool: Spool, totals: Totals) -> None:
    """The file with the runs of changed layers replaced, their sizes and checksums, and the volume."""
    volume, weight, price, *rest = TAIL.unpack_from(data, VOLUME_AT)
    done = 0
    for index, (at, size) in enumerate(places):
        changed = spool.get(index)
        if changed is None:
            continue
        target.write(data[done : at - 5])
        target.write(struct.pack(">I", len(changed) + 2) + b"\x55" + changed)
        target.write(bytes([~sum(changed) & 0xFF]))
        done = at + size + 1
    target.write(data[done:])
    if volume > 0:
        grown = max(volume + totals.added_mm3, 0.0) / volume
        with suppress(OverflowError, struct.error):  # amounts that are absurd stay as they are
            amounts = TAIL.pack(volume * grown, weight * grown, price * grown, *rest)
            target.seek(VOLUME_AT)
            target.write(amounts)
            target.seek(0, 2)
