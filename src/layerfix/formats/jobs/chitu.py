"""Photon, CBDDLP and plain CTB: the binary jobs of ChiTu boards.

Sources: catibo's cbddlp-ctb.adoc (BSD-2), uv3dp (MIT).

Little-endian: a header, a table of 36-byte layer entries (z, exposure, light-off, data offset and size, …) and
the layers' data anywhere. Photon and CBDDLP store planes of one bit, one table after the other: a pixel's grey is
the share of planes it is set in. CTB stores 7-bit greys, XORed with a key stream if the header has a key.

The codes are loaded when first used: compiling them is not for those who have no such jobs.

Rewriting keeps every byte but the changed layers' data and their offsets and sizes in the table: data that fit go
where the old were, others to the end of the file, and nothing that points elsewhere has to move.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from layerfix.bits import unpack, words_for
from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.formats.jobs.container import (
    Container,
    Frame,
    Spool,
    Totals,
    bounds_of_table,
    container_stack,
    repeats_of,
)
from layerfix.formats.jobs.zip_job import MAX_PANEL_PX
from layerfix.formats.png.decode import Decoded
from layerfix.formats.text_values import machine_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows
    from layerfix.formats.hints import Hints
    from layerfix.formats.probe import Probe
    from layerfix.layers.grey_image import Greys
    from layerfix.stack import LayerStack

PHOTON_SUFFIXES, CTB_SUFFIXES = (".photon", ".cbddlp"), (".ctb",)
PHOTON, CTB, CTB_V4, ENCRYPTED = 0x12FD0019, 0x12FD0086, 0x12FD0106, 0x12FD0107
ENTRY = struct.Struct("<fffII")  # z, exposure, light-off, data offset, data size; 16 more bytes follow
ENTRY_BYTES, RECORD_BYTES = 36, 84
MAX_LAYERS = 100_000
MAX_PLANES = 16
MAX_NAME = 64  # bytes


@dataclass(frozen=True)
class _Header:
    """What the fixed part of the header says."""

    magic: int
    bed_mm: tuple[float, float]
    layer_mm: float
    width: int
    height: int
    table: int
    layers: int
    planes: int
    key: int
    mirrored: bool
    records: bool  # 84 bytes before each layer's data: its table entry once more, and motion settings


def read(probe: Probe, hints: Hints) -> LayerStack:
    """The layers of a job. Raises InputError for headers and tables that point outside the file or make no sense."""
    path = probe.path
    with reading(path), path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    header = _header(path, data)
    places = _table(path, data, header)
    tops = [ENTRY.unpack_from(data, header.table + i * ENTRY_BYTES)[0] for i in range(header.layers)]
    pixel_mm = hints.pitch((round(header.bed_mm[0] / header.width, 6), round(header.bed_mm[1] / header.height, 6)))
    assert pixel_mm is not None  # the file says it
    z_mm = bounds_of_table(path, tops, hints, lambda z: _bounds(z, header.layer_mm))
    frame = Frame(header.width, header.height, pixel_mm, z_mm)
    codec = _Codec(path, header, hints.threshold)

    def payload(index: int) -> bytes:
        planes = (places[index + k * header.layers] for k in range(header.planes))
        return b"".join(struct.pack("<I", size) + data[at : at + size] for at, size in planes)

    def save(target: BinaryIO, spool: Spool, totals: Totals) -> None:
        _save(target, data, header, places, spool)

    suffixes = PHOTON_SUFFIXES if header.magic == PHOTON else CTB_SUFFIXES
    container = Container(
        path, suffixes, payload, codec.decode, codec.encode, save, hints.threshold, hints.grey_floor,
        "x" * header.mirrored, machine=_machine(data),
    )  # fmt: skip

    left = 2 * len(data)  # bytes to compare: enough if no two layers overlap; a hostile table's all might

    @cache
    def same_bytes(a: tuple[int, int], b: tuple[int, int]) -> bool:
        nonlocal left
        left -= 2 * a[1]
        return left >= 0 and data[a[0] : a[0] + a[1]] == data[b[0] : b[0] + b[1]]

    def alike(i: int) -> bool:
        """Layer i is the one below it: the same data, in one place or in two."""
        pairs = [(places[i - 1 + k * header.layers], places[i + k * header.layers]) for k in range(header.planes)]
        if any(a[1] != b[1] for a, b in pairs):
            return False
        return all(a == b or same_bytes(a, b) for a, b in pairs)

    same = None if header.key else repeats_of(alike(i) for i in range(1, header.layers))
    return container_stack(container, frame, same)


def _machine(data: mmap.mmap) -> str:
    """The machine's name: the second extension of the header, which is not always there, says where it is."""
    try:
        (extension,) = struct.unpack_from("<I", data, 0x68)
        at, size = struct.unpack_from("<II", data, extension + 0x1C)
    except struct.error:
        return ""
    return machine_name(data[at : at + size]) if extension and size <= MAX_NAME else ""


def _header(path: Path, data: mmap.mmap) -> _Header:
    if len(data) < 0x70:
        raise InputError(f"{path}: the file is cut short: {len(data)} bytes")
    magic = struct.unpack_from("<I", data)[0]
    bed = struct.unpack_from("<ff", data, 8)
    (layer_mm,) = struct.unpack_from("<f", data, 0x20)
    width, height = struct.unpack_from("<II", data, 0x34)
    table, layers = struct.unpack_from("<II", data, 0x40)
    (planes,) = struct.unpack_from("<I", data, 0x5C)
    (key,) = struct.unpack_from("<I", data, 0x64)
    version = struct.unpack_from("<I", data, 4)[0]
    (mirrored,) = struct.unpack_from("<I", data, 0x50)
    if magic != PHOTON or version < 2:
        planes = 1
    if magic == PHOTON:
        key = 0
    if not (0 < width * height <= MAX_PANEL_PX and width < 1 << 16 and height < 1 << 16):
        raise InputError(f"{path}: the header says {width} × {height} px")
    if not 0 < layers <= MAX_LAYERS:
        raise InputError(f"{path}: the header says {layers} layers")
    if not all(0 < side < 10_000 for side in bed) or not 0 < layer_mm < 10:
        raise InputError(f"{path}: the header says a bed of {bed[0]:g} × {bed[1]:g} mm and layers of {layer_mm:g} mm")
    if not 0 < max(planes, 1) <= MAX_PLANES:
        raise InputError(f"{path}: the header says {planes} grey levels")
    return _Header(magic, bed, round(layer_mm, 6), width, height, table, layers, max(planes, 1), key, mirrored == 1,
                   magic != PHOTON and version >= 3)  # fmt: skip


def _table(path: Path, data: mmap.mmap, header: _Header) -> list[tuple[int, int]]:
    """(offset, size) of every layer's data, plane after plane."""
    count = header.layers * header.planes
    if header.table + count * ENTRY_BYTES > len(data):
        raise InputError(f"{path}: the file is cut short: its table of {count} layers ends past the end of the file")
    places = []
    most = 4 * header.width * header.height + 4096  # no run takes more than 4 bytes a pixel
    for i in range(count):
        at, size = ENTRY.unpack_from(data, header.table + i * ENTRY_BYTES)[3:]
        if at + size > len(data):
            raise InputError(
                f"{path}: the file is cut short: layer {i % header.layers} ends past the end of the file"
            )
        if size > most:
            raise InputError(
                f"{path}: layer {i % header.layers} has {size} bytes of runs, more than its"
                f" {header.width} × {header.height} px can need"
            )
        places.append((at, size))
    return places


def _bounds(z_mm: NDArray[np.float64], layer_mm: float) -> NDArray[np.float64]:
    """Bounds of the layers. The table holds where each begins (from 0) or where each ends, by program."""
    if z_mm[0] > layer_mm / 2:
        return np.stack([np.concatenate([[0.0], z_mm[:-1]]), z_mm], axis=1)
    return np.stack([z_mm, np.append(z_mm[1:], round(z_mm[-1] + layer_mm, 6))], axis=1)


class _Codec:
    """Payloads of one job. A payload is its planes' data, each after its size."""

    def __init__(self, path: Path, header: _Header, threshold: int) -> None:
        self.path, self.header, self.threshold = path, header, threshold

    def decode(self, index: int, payload: bytes) -> Decoded:
        from layerfix.formats.jobs import runs
        from layerfix.layers.greys import pack_from

        h = self.header
        planes = _split(payload)
        if h.magic != PHOTON:
            return self._decode_ctb(index, np.frombuffer(planes[0], np.uint8))
        stack = []
        for plane in planes:
            rows = np.zeros((h.height, words_for(h.width)), np.uint64)
            covered = runs.decode_photon(np.frombuffer(plane, np.uint8), h.width, rows)
            self._check(index, covered)
            stack.append(rows)
        if len(stack) == 1 or all(np.array_equal(stack[0], other) for other in stack[1:]):
            return Decoded(stack[0], None)
        counts = np.zeros((h.height, h.width), np.uint16)
        for rows in stack:
            counts += unpack(rows, h.width)
        grey = (counts * 255 // len(stack)).astype(np.uint8)
        return Decoded(pack_from(grey, self.threshold), grey)

    def _decode_ctb(self, index: int, data: NDArray[np.uint8]) -> Decoded:
        from layerfix.formats.jobs import runs

        h = self.header
        if h.key:
            data = data ^ runs.key_stream(h.key, index, len(data))
        rows = np.zeros((h.height, words_for(h.width)), np.uint64)
        covered, greys = runs.decode_ctb(data, h.width, self.threshold, rows)
        self._check(index, covered)
        if not greys:
            return Decoded(rows, None)
        grey = np.zeros((h.height, h.width), np.uint8)
        runs.decode_ctb_greys(data, grey)
        return Decoded(rows, grey)

    def _check(self, index: int, covered: int) -> None:
        """Layers may be short (firmware leaves the rest dark), as some programs write them one pixel short."""
        total = self.header.width * self.header.height
        if covered < 0 or covered > total:
            raise InputError(f"{self.path}: layer {index} is broken: its runs cover {covered} of {total} px")
        if covered < total - self.header.width:
            raise InputError(f"{self.path}: layer {index} is cut short: its runs cover {covered} of {total} px")

    def encode(self, index: int, payload: bytes, rows: Rows, greys: NDArray[np.uint8] | Greys | None) -> bytes:
        from layerfix.formats.jobs import runs
        from layerfix.layers.greys import pack_from

        h = self.header
        if h.magic == PHOTON:
            levels = [rows] * h.planes
            if greys is not None:
                grey = np.asarray(greys)
                # Plane k is set from k + ½ levels on, and in what is solid up to the threshold at least.
                steps = [int(np.ceil((k + 0.5) * 255 / h.planes)) for k in range(h.planes)]
                enough = int(np.ceil(self.threshold * h.planes / 255))
                levels = [pack_from(grey, step) for step in steps]
                levels = [level | rows if k < enough else level for k, level in enumerate(levels)]
            planes = [runs.encode_photon(np.ascontiguousarray(r), h.width).tobytes() for r in levels]
        else:
            data = runs.encode_runs(rows, h.width, False) if greys is None else runs.encode_greys(greys, False)
            planes = [(data ^ runs.key_stream(h.key, index, len(data)) if h.key else data).tobytes()]
        return b"".join(struct.pack("<I", len(p)) + p for p in planes)


def _split(payload: bytes) -> list[bytes]:
    planes, at = [], 0
    while at < len(payload):
        (size,) = struct.unpack_from("<I", payload, at)
        planes.append(payload[at + 4 : at + 4 + size])
        at += 4 + size
    return planes


def _save(target: BinaryIO, data: mmap.mmap, header: _Header, places: list[tuple[int, int]], spool: Spool) -> None:
    """The file with changed layers' data in the old place if they fit and nobody shares it, else at the end."""
    target.write(data)
    shared = _shared(places)
    for index in range(header.layers):
        changed = spool.get(index)
        for k, plane in enumerate(_split(changed) if changed is not None else []):
            entry = index + k * header.layers
            old, room = places[entry]
            record = bytearray(data[old - RECORD_BYTES : old]) if header.records else bytearray()
            at = old
            if len(plane) > room or entry in shared:
                at = target.seek(0, 2) + len(record)
            if len(record) == RECORD_BYTES:
                struct.pack_into("<II", record, 12, at, len(plane))
                struct.pack_into("<I", record, ENTRY_BYTES, RECORD_BYTES + len(plane))
            target.seek(at - len(record))
            target.write(record + plane)
            target.seek(header.table + entry * ENTRY_BYTES + 12)
            target.write(struct.pack("<II", at, len(plane)))
    target.seek(0, 2)


def _shared(places: list[tuple[int, int]]) -> set[int]:
    """Entries whose data overlap those of another."""
    order = sorted(range(len(places)), key=lambda i: places[i])
    found: set[int] = set()
    end, last = -1, -1
    for i in order:
        at, size = places[i]
        if at < end:
            found |= {i, last}
        if at + size > end:
            end, last = at + size, i
    return found
