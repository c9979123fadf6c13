"""Resin jobs read and written once more, slow and plain: what the package's formats are compared with.

Nothing here comes from the package. SL1 goes by zipfile and Pillow; photon, CBDDLP, CTB and GOO are written from
their specifications (catibo's cbddlp-ctb.adoc; Elegoo's "GOO format V1.2"). Images are (H, W) uint8.
"""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

PHOTON, CTB, CTB_V4, CTB_ENCRYPTED = 0x12FD0019, 0x12FD0086, 0x12FD0106, 0x12FD0107
TABLE_ENTRY = struct.Struct("<fffIIIIII")  # z, exposure, light-off, offset, size, page, table size, two unknown
EXTENSION = 48  # bytes that CTB v3 has after the copy of the table's entry, before the data
WORD = 0xFFFFFFFF

GOO_HEADER = struct.Struct(">4s8s32s24s24s32s32s32s3H26912s2s168200s2sI2H2?5f?8fI16f2H?I3f8sI?H")
GOO_LAYER = struct.Struct(">H15fH2s")
GOO_MAGIC = b"\7\0\0\0DLP\0"
GOO_ENDING = b"\0\0\0" + GOO_MAGIC
# Places in the tuple of header fields.
GOO_COUNT, GOO_X, GOO_Y, GOO_BED_X, GOO_BED_Y, GOO_LAYER_MM = 15, 16, 17, 20, 21, 23
GOO_VOLUME, GOO_WEIGHT, GOO_PRICE, GOO_OFFSET, GOO_8_BIT = -7, -6, -5, -3, -2


# ------------------------------------------------------------------------------------------------- zip, SL1


def png_bytes(grey: np.ndarray) -> bytes:
    """An 8-bit grey PNG as Pillow writes it."""
    buffer = io.BytesIO()
    Image.fromarray(grey.astype(np.uint8)).save(buffer, "PNG")
    return buffer.getvalue()


def png_pixels(data: bytes) -> np.ndarray:
    """(H, W) uint8 of a PNG as Pillow reads it; it must be grey."""
    with Image.open(io.BytesIO(data)) as image:
        assert image.mode in ("L", "1")
        return np.array(image.convert("L"))


def ini(text: str) -> dict[str, str]:
    """key = value lines."""
    pairs = (line.split("=", 1) for line in text.splitlines() if "=" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def sl1_names(path: Path) -> list[str]:
    """The names of an SL1 job's layers in order: PNG entries that begin with jobDir."""
    with zipfile.ZipFile(path) as archive:
        prefix = ini(archive.read("config.ini").decode())["jobDir"]
        return sorted(n for n in archive.namelist() if n.startswith(prefix) and n.endswith(".png"))


def sl1_layers(path: Path) -> list[np.ndarray]:
    """Every layer of an SL1 job."""
    with zipfile.ZipFile(path) as archive:
        return [png_pixels(archive.read(name)) for name in sl1_names(path)]


def raw_entries(path: Path) -> dict[str, bytes]:
    """Every entry of a zip as it lies in the file: local header, data, and what follows up to the next."""
    data = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        infos = sorted(archive.infolist(), key=lambda info: info.header_offset)
        stops = [info.header_offset for info in infos[1:]] + [archive.start_dir]
        return {info.filename: data[info.header_offset : stop] for info, stop in zip(infos, stops, strict=False)}


def sl1_entries(layers: Sequence[np.ndarray], *, pitch_mm: float = 0.05, job: str = "part") -> dict[str, bytes]:
    """The entries of an SL1 job as PrusaSlicer writes them, for a panel of the layers' size."""
    height, width = layers[0].shape
    config = f"action = print\njobDir = {job}\nlayerHeight = 0.05\nusedMaterial = 1.250000\nexpTime = 7\n"
    slicer = (
        f"display_width = {width * pitch_mm:.6f}\ndisplay_height = {height * pitch_mm:.6f}\n"
        f"display_pixels_x = {width}\ndisplay_pixels_y = {height}\ninitial_layer_height = 0.05\n"
    )
    entries = {"config.ini": config.encode(), "prusaslicer.ini": slicer.encode()}
    entries |= {f"{job}{i:05}.png": png_bytes(layer) for i, layer in enumerate(layers)}
    return entries | {"thumbnail/thumbnail400x400.png": png_bytes(np.full((400, 400), 90))}


def write_zip(path: Path, entries: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    """A zip of these entries; returns its path."""
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in entries.items():
            archive.writestr(zipfile.ZipInfo(name, (2024, 2, 8, 19, 52, 6)), data, method)
    return path


def write_sl1(path: Path, layers: Sequence[np.ndarray], **options: Any) -> Path:
    """An SL1 job; returns its path."""
    return write_zip(path, sl1_entries(layers, **options))


# ------------------------------------------------------------------------------------------------ run lengths


def runs_of(flat: Sequence[int]) -> list[tuple[int, int]]:
    """(value, length) of every run of equal values."""
    array = np.asarray(flat)
    ends = np.flatnonzero(np.diff(array)) + 1
    starts = np.concatenate([[0], ends]) if len(array) else []
    return [(int(array[a]), int(b - a)) for a, b in zip(starts, [*ends, len(array)], strict=True)]


def spread(values: list[int], lengths: list[int]) -> np.ndarray:
    """Runs as pixels."""
    return np.repeat(np.array(values, np.uint8), np.array(lengths, np.int64))


def photon_runs(solid: np.ndarray) -> bytes:
    """One plane: bit 7 is the colour, bits 0 … 6 the length, at most 125."""
    out = bytearray()
    for value, length in runs_of(solid.reshape(-1) != 0):
        while length:
            part = min(length, 125)
            out.append(0x80 * value | part)
            length -= part
    return bytes(out)


def photon_pixels(data: bytes) -> np.ndarray:
    """One plane's pixels, 0 and 1."""
    codes = np.frombuffer(data, np.uint8) if data else np.zeros(0, np.uint8)
    return np.repeat(codes >> 7, codes & 0x7F)


def ctb_runs(grey: np.ndarray) -> bytes:
    """7-bit greys: a byte, and with bit 7 a length of 7, 14, 21 or 28 bits."""
    out = bytearray()
    for value, length in runs_of(grey.reshape(-1) >> 1):
        if length == 1:
            out.append(value)
            continue
        out.append(value | 0x80)
        if length < 1 << 7:
            out.append(length)
        elif length < 1 << 14:
            out += (length | 0x8000).to_bytes(2, "big")
        elif length < 1 << 21:
            out += (length | 0xC00000).to_bytes(3, "big")
        else:
            out += (length | 0xE0000000).to_bytes(4, "big")
    return bytes(out)


def ctb_pixels(data: bytes) -> np.ndarray:
    """Greys of a deciphered layer: twice the 7 bits, plus one unless black."""
    values, lengths, i = [], [], 0
    while i < len(data):
        code, length = data[i], 1
        i += 1
        if code & 0x80:
            first = data[i]
            for mark, mask, size in ((0x00, 0x80, 1), (0x80, 0xC0, 2), (0xC0, 0xE0, 3), (0xE0, 0xF0, 4)):
                if first & mask == mark:
                    length = int.from_bytes(data[i : i + size], "big") & ((1 << 7 * size) - 1)
                    assert i + size <= len(data), "the data end within a length"
                    i += size
                    break
            else:
                raise AssertionError("no such length")
        values.append((code & 0x7F) * 2 + (code & 0x7F > 0))
        lengths.append(length)
    return spread(values, lengths)


def ctb_cipher(data: bytes, seed: int, layer: int) -> bytes:
    """The data XORed with the layer's key stream; its own inverse."""
    if not seed:
        return data
    step = (seed * 0x2D83CDAC + 0xD8A83423) & WORD
    key = ((layer * 0x1E1530CD + 0xEC3D47CD) & WORD) * step & WORD
    out = bytearray(data)
    for i in range(len(out)):
        out[i] ^= key >> 8 * (i % 4) & 0xFF
        if i % 4 == 3:
            key = (key + step) & WORD
    return bytes(out)


def goo_chunk(kind: int, length: int, value: int = 0) -> bytes:
    """A chunk of kind 0 (black), 1 (grey) or 3 (white)."""
    more = next(n for n in range(4) if length < 1 << 4 + 8 * n)
    head = bytes([kind << 6 | more << 4 | length & 15])
    return head + (bytes([value]) if kind == 1 else b"") + (length >> 4).to_bytes(more, "big")


def goo_runs(grey: np.ndarray, *, differences: bool = False) -> bytes:
    """The chunks of a layer; with differences, small steps from one grey to the next as chunks of kind 2."""
    out, before = bytearray(), 0
    for value, length in runs_of(grey.reshape(-1)):
        step = value - before
        if differences and abs(step) <= 15 and length <= 255:
            head = 0x80 | (0x20 if step < 0 else 0) | abs(step)
            out += bytes([head]) if length == 1 else bytes([head | 0x10, length])
        else:
            out += goo_chunk({0: 0, 255: 3}.get(value, 1), length, value)
        before = value
    return bytes(out)


def goo_pixels(data: bytes) -> np.ndarray:
    """The greys of a layer's chunks."""
    values, lengths, i, value = [], [], 0, 0
    while i < len(data):
        head = data[i]
        i += 1
        kind, low = head >> 6, head & 15
        if kind == 2:
            value += -low if head & 0x20 else low
            length = 1
            if head & 0x10:
                length = data[i]
                i += 1
        else:
            value = {0: 0, 3: 255}.get(kind, -1)
            if kind == 1:
                value = data[i]
                i += 1
            more = head >> 4 & 3
            assert i + more <= len(data), "the data end within a length"
            length = int.from_bytes(data[i : i + more], "big") << 4 | low
            i += more
        values.append(value & 255)
        lengths.append(length)
    return spread(values, lengths)


# ---------------------------------------------------------------------------------------- photon, CBDDLP, CTB


class ChituJob(NamedTuple):
    """A Photon, CBDDLP or CTB file: its header, its table plane after plane, each entry's data, and the pixels."""

    header: bytes
    entries: list[tuple[Any, ...]]
    data: list[bytes]
    planes: int
    layers: list[np.ndarray]


def planes_of(grey: np.ndarray, planes: int) -> list[np.ndarray]:
    """Planes of one bit: a pixel is set in as many as its grey allows, the first ones first."""
    count = np.round(grey / 255 * planes)
    return [count > k for k in range(planes)]


def write_chitu(
    path: Path,
    layers: Sequence[np.ndarray],
    *,
    magic: int = PHOTON,
    version: int = 1,
    planes: int = 1,
    key: int = 0,
    shared: bool = False,
    pitch_mm: float = 0.05,
    first_z_mm: float = 0.0,
    exposures: int = 1,
) -> Path:
    """A Photon (1 plane), CBDDLP (version 2, planes) or CTB (version 2 to 4) file; returns its path.

    exposures  so many layers, one after the other, are at one height
    shared  equal data are stored once and pointed to by several entries
    Versions 3 and 4 have 84 bytes before each layer's data: its table entry once more, and motion settings.
    """
    height, width = layers[0].shape
    count, preview = len(layers), bytes(range(40))
    table_at = 112 + len(preview)
    header = struct.pack(
        "<II3f3I4f16I",
        magic, version, width * pitch_mm, height * pitch_mm, 150.0, 0, 0, 0, 0.05, 8.0, 60.0,
        1.0, 3, width, height, 112, table_at, count, 112, 90, 1, 0, 0, planes, 0, key, 0, 0,
    )  # fmt: skip
    if magic == PHOTON:
        coded = [photon_runs(planes_of(layer, planes)[k]) for k in range(planes) for layer in layers]
    else:
        coded = [ctb_cipher(ctb_runs(layer), key, i) for i, layer in enumerate(layers)]
    table, body, at, places = b"", b"", table_at + TABLE_ENTRY.size * len(coded), dict[bytes, int]()
    extended = magic != PHOTON and version >= 3
    for i, data in enumerate(coded):
        z = first_z_mm + 0.05 * (i % count // exposures)
        if shared and data in places:
            table += TABLE_ENTRY.pack(z, 8, 1, places[data], len(data), 0, 36, 0, 0)
            continue
        place = at + len(body) + (TABLE_ENTRY.size + EXTENSION if extended else 0)
        entry = TABLE_ENTRY.pack(z, 8, 1, place, len(data), 0, 36 + EXTENSION if extended else 36, 0, 0)
        if extended:
            total = TABLE_ENTRY.size + EXTENSION + len(data)
            body += entry + struct.pack("<I11f", total, 5, 60, 3, 180, 150, 1, 90, 0, 0, 1, 255)
        table, body, places[data] = table + entry, body + data, place
    path.write_bytes(header + preview + table + body)
    return path


def read_chitu(path: Path) -> ChituJob:
    """A Photon, CBDDLP or CTB file. Layers may be short by less than a row."""
    data = path.read_bytes()
    magic, version = struct.unpack_from("<II", data)
    width, height = struct.unpack_from("<II", data, 0x34)
    table_at, count = struct.unpack_from("<II", data, 0x40)
    planes = struct.unpack_from("<I", data, 0x5C)[0] if magic == PHOTON and version > 1 else 1
    (key,) = struct.unpack_from("<I", data, 0x64)
    entries = [TABLE_ENTRY.unpack_from(data, table_at + i * TABLE_ENTRY.size) for i in range(count * planes)]
    parts = [data[e[3] : e[3] + e[4]] for e in entries]
    if magic == PHOTON:
        flat = [photon_pixels(part) for part in parts]
    else:
        flat = [ctb_pixels(ctb_cipher(part, key, i)) for i, part in enumerate(parts)]
    total, images = width * height, []
    for pixels in flat:
        assert total - width < len(pixels) <= total
        images.append(np.concatenate([pixels, np.zeros(total - len(pixels), np.uint8)]).reshape(height, width))
    if magic == PHOTON:
        stacks = [sum(images[i + k * count].astype(int) for k in range(planes)) for i in range(count)]
        images = [(stack * 255 // planes).astype(np.uint8) for stack in stacks]
    return ChituJob(data[:table_at], entries, parts, planes, images)


def extensions(path: Path) -> list[tuple[tuple[Any, ...], int, bytes]]:
    """What CTB v3 has before each layer's data: the copy of its table entry, the total size, the settings."""
    data, found = path.read_bytes(), []
    for entry in read_chitu(path).entries:
        at = entry[3] - TABLE_ENTRY.size - EXTENSION
        copy = TABLE_ENTRY.unpack_from(data, at)
        (total,) = struct.unpack_from("<I", data, at + TABLE_ENTRY.size)
        found.append((copy, total, data[at + TABLE_ENTRY.size + 4 : entry[3]]))
    return found


# -------------------------------------------------------------------------------------------------------- GOO


class GooJob(NamedTuple):
    """A GOO file: its header's fields, each layer's definition and chunks, and the pixels."""

    header: tuple[Any, ...]
    definitions: list[bytes]
    data: list[bytes]
    layers: list[np.ndarray]


def goo_header(width: int, height: int, count: int, **changed: Any) -> bytes:
    """195,477 bytes. changed: of the fields by their place, as ``f16=…``, or `fm7` for the 7th from the end."""
    rng = np.random.default_rng(1)
    fields: list[Any] = [
        b"V3.0", GOO_MAGIC, b"a slicer", b"1.2", b"2024-01-01 00:00:00", b"Saturn", b"MSLA", b"Resin", 8, 0, 0,
        rng.bytes(26912), b"\r\n", rng.bytes(168200), b"\r\n", count, width, height, True, False,
        width * 0.05, height * 0.05, 250.0, 0.05, 2.5, False, *np.arange(1.0, 9.0), 4, *np.arange(9.0, 25.0),
        250, 251, True, 3600, 120.0, 0.5, 0.25, b"EUR", GOO_HEADER.size, True, 5,
    ]  # fmt: skip
    for name, value in changed.items():
        fields[int(name[1:].replace("m", "-"))] = value
    return GOO_HEADER.pack(*fields)


def goo_layer(data: bytes, index: int) -> bytes:
    """A layer's definition and its chunks with size, checksum and delimiters."""
    floats = [0.0, 0.05 * (index + 1), 2.5 + index, *np.arange(1.0, 13.0)]
    definition = GOO_LAYER.pack(0, *floats, 255, b"\r\n")
    return definition + struct.pack(">I", len(data) + 2) + b"\x55" + data + bytes([~sum(data) & 255]) + b"\r\n"


def write_goo(
    path: Path,
    layers: Sequence[np.ndarray],
    *,
    differences: bool = False,
    chunks: Iterable[bytes] = (),
    **changed: Any,
) -> Path:
    """A GOO file of these layers (or of these chunks); returns its path."""
    height, width = layers[0].shape
    coded = list(chunks) or [goo_runs(layer, differences=differences) for layer in layers]
    body = b"".join(goo_layer(data, i) for i, data in enumerate(coded))
    path.write_bytes(goo_header(width, height, len(coded), **changed) + body + GOO_ENDING)
    return path


def read_goo(path: Path) -> GooJob:
    """A GOO file; every delimiter, checksum and the ending are asserted."""
    data = path.read_bytes()
    header = GOO_HEADER.unpack_from(data)
    assert header[1] == GOO_MAGIC
    assert header[12] == header[14] == b"\r\n"
    at, definitions, parts, images = header[GOO_OFFSET], [], [], []
    for _ in range(header[GOO_COUNT]):
        definitions.append(data[at : at + 66])
        assert definitions[-1].endswith(b"\r\n")
        (size,) = struct.unpack_from(">I", data, at + 66)
        whole = data[at + 70 : at + 70 + size]
        assert whole[0] == 0x55
        assert whole[-1] == ~sum(whole[1:-1]) & 255
        assert data[at + 70 + size : at + 72 + size] == b"\r\n"
        parts.append(whole[1:-1])
        images.append(goo_pixels(parts[-1]).reshape(header[GOO_Y], header[GOO_X]))
        at += 72 + size
    assert data[at:] == GOO_ENDING
    return GooJob(header, definitions, parts, images)


# ---------------------------------------------------------------------------------------- pictures of layers


def thin_bar(height: int, width: int, level: int = 255, *, row: int = 8) -> np.ndarray:
    """A block that needs nothing and a bar one pixel high that does; `level` is the grey of the bar's ends."""
    grey = np.zeros((height, width), np.uint8)
    grey[row + 12 : height - 4, 8 : width - 8] = 255
    grey[row, 10 : width - 10] = 255
    grey[row, 10:14] = level
    return grey


def block(height: int, width: int, level: int = 255) -> np.ndarray:
    """A block that needs nothing, with a rim of `level`."""
    grey = np.zeros((height, width), np.uint8)
    grey[10 : height - 4, 8 : width - 8] = level
    grey[11 : height - 5, 9 : width - 9] = 255
    return grey
