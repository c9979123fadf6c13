"""A PNG file as one packed layer. Specification: PNG (ISO/IEC 15948), filters in section 9.

Mask printers' layers are 8-bit (or 1-bit) grey. For those the inflated bytes go through the filters one row
at a time, straight into packed rows: the full grey image is made only for layers that have greys. Every other
kind of PNG (16-bit, palette, colour, interlaced) is read by Pillow.
"""

from __future__ import annotations

import io
import struct
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit, types

from layerfix.bits import U0, WORK, pack, words_for
from layerfix.errors import InputError
from layerfix.formats.png import SIGNATURE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

GREYS = types.Array(types.uint8, 1, "C", readonly=True)
LINE = types.Array(types.uint8, 1, "C")
IMAGE = types.Array(types.uint8, 2, "C")
NONE, SUB, UP, AVERAGE, PAETH = range(5)


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded layer: packed rows, and the grey image (H, W) uint8 if it has any value but 0 and 255."""

    rows: Rows
    grey: NDArray[np.uint8] | None


@njit
def _unfilter(kind, raw, above, line):  # type: ignore[no-untyped-def]
    """Undo one row's filter for one byte a pixel. False if the filter type does not exist."""
    n = line.shape[0]
    if kind == NONE:
        for i in range(n):
            line[i] = raw[i]
    elif kind == UP:
        for i in range(n):
            line[i] = raw[i] + above[i]
    elif kind == SUB:
        left = np.uint8(0)
        for i in range(n):
            left = np.uint8(left + raw[i])
            line[i] = left
    elif kind == AVERAGE:
        left = np.uint8(0)
        for i in range(n):
            left = np.uint8(raw[i] + np.uint8((np.int32(left) + np.int32(above[i])) >> 1))
            line[i] = left
    elif kind == PAETH:
        a, c = np.int32(0), np.int32(0)
        for i in range(n):
            b = np.int32(above[i])
            pa, pb, pc = abs(b - c), abs(a - c), abs(a + b - 2 * c)
            best = a if pa <= pb and pa <= pc else (b if pb <= pc else c)
            a = np.int32(np.uint8(np.int32(raw[i]) + best))
            line[i] = np.uint8(a)
            c = b
    else:
        return False
    return True


@njit
def _pack_line(line, threshold, out):  # type: ignore[no-untyped-def]
    """Pack one row of greys; True if it has one that is neither 0 nor 255."""
    width = line.shape[0]
    greys = np.uint8(0)
    for i in range(width):
        greys |= np.uint8(line[i] + np.uint8(1)) & np.uint8(254)
    for w in range(width // 64):
        word = U0
        part = line[w * 64 : w * 64 + 64]
        for i in range(64):
            word |= np.uint64(part[i] >= threshold) << np.uint64(i)
        out[w] = word
    if width & 63:
        word = U0
        part = line[width & ~63 :]
        for i in range(part.shape[0]):
            word |= np.uint64(part[i] >= threshold) << np.uint64(i)
        out[width // 64] = word
    return greys != np.uint8(0)


@njit(types.int64(GREYS, types.int64, types.uint8, WORK), cache=True, nogil=True)
def _rows_8bit(raw, width, threshold, rows):  # type: ignore[no-untyped-def]
    """Filtered bytes of an 8-bit image → packed rows. 1 if there are greys, 0 if not, -1 for a bad filter."""
    line, above = np.zeros(width, np.uint8), np.zeros(width, np.uint8)
    greys = 0
    for y in range(rows.shape[0]):
        start = y * (width + 1)
        if not _unfilter(raw[start], raw[start + 1 : start + 1 + width], above, line):
            return -1
        if _pack_line(line, threshold, rows[y]):
            greys = 1
        line, above = above, line
    return greys


@njit(types.void(GREYS, types.int64, IMAGE), cache=True, nogil=True)
def _grey_8bit(raw, width, image):  # type: ignore[no-untyped-def]
    """Filtered bytes of an 8-bit image, known to be sound → the image."""
    above = np.zeros(width, np.uint8)
    for y in range(image.shape[0]):
        start = y * (width + 1)
        _unfilter(raw[start], raw[start + 1 : start + 1 + width], above, image[y])
        above = image[y]


def decode_png(data: bytes, where: str, size_px: tuple[int, int], *, threshold: int = 128) -> Decoded:
    """Packed rows of a PNG: solid where the grey value is at least `threshold`.

    where, size_px  what errors name, and the (width, height) it must have: nothing larger is ever inflated
    raises          InputError for what is no PNG, is cut short or corrupt, or has another size
    """
    kind, stream = _chunks(data, where)
    width, height, depth, colour, _, _, interlace = struct.unpack(">IIBBBBB", kind)
    if (width, height) != size_px:
        raise InputError(f"{where}: {width} × {height} px, not {size_px[0]} × {size_px[1]} px")
    if colour != 0 or interlace != 0 or depth not in (1, 8):
        grey = _by_pillow(data, where)
        has_greys = bool(((grey != 0) & (grey != 255)).any())
        return Decoded(pack(grey >= threshold), grey if has_greys else None)
    row_bytes = width if depth == 8 else (width + 7) // 8
    raw = np.frombuffer(_inflate(stream, height * (1 + row_bytes), where), np.uint8)
    rows = np.zeros((height, words_for(width)), np.uint64)
    if depth == 1:
        return Decoded(_rows_1bit(raw, width, rows, where), None)
    greys = _rows_8bit(raw, width, threshold, rows)
    if greys < 0:
        raise InputError(f"{where}: not a readable PNG image (an unknown filter)")
    if not greys:
        return Decoded(rows, None)
    grey = np.empty((height, width), np.uint8)
    _grey_8bit(raw, width, grey)
    return Decoded(rows, grey)


def _chunks(data: bytes, where: str) -> tuple[bytes, bytes]:
    """(IHDR, all IDAT) of a PNG, checksums verified."""
    if data[:8] != SIGNATURE:
        raise InputError(f"{where}: not a PNG image")
    header, parts, at = b"", [], 8
    while at + 12 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        crc = data[at + 8 + size : at + 12 + size]
        if len(crc) < 4:
            break
        if zlib.crc32(body, zlib.crc32(kind)) != int.from_bytes(crc, "big"):
            raise InputError(f"{where}: a corrupt PNG image (wrong checksum of {kind!r})")
        if kind == b"IHDR":
            header = body
        elif kind == b"IDAT":
            parts.append(body)
        elif kind == b"IEND":
            if len(header) != 13 or not parts:
                break
            return header, parts[0] if len(parts) == 1 else b"".join(parts)
        at += 12 + size
    raise InputError(f"{where}: a PNG image that is cut short")


def _inflate(stream: bytes, size: int, where: str) -> bytes:
    """Inflate a zlib stream that must give exactly `size` bytes; no more are ever made."""
    from isal import isal_zlib

    try:
        inflater = isal_zlib.decompressobj()
        raw: bytes = inflater.decompress(stream, size + 1)
    except isal_zlib.error as problem:
        raise InputError(f"{where}: a corrupt PNG image ({problem})") from problem
    if len(raw) != size:
        raise InputError(f"{where}: a corrupt PNG image ({'too much' if len(raw) > size else 'too little'} data)")
    return raw


def _rows_1bit(raw: NDArray[np.uint8], width: int, rows: Rows, where: str) -> Rows:
    """Filtered bytes of a 1-bit image → packed rows. Filters act on whole bytes."""
    row_bytes = (width + 7) // 8
    lines = raw.reshape(len(rows), 1 + row_bytes)
    if lines[:, 0].any():
        image = np.empty((len(rows), row_bytes), np.uint8)
        if lines[:, 0].max() > PAETH:
            raise InputError(f"{where}: not a readable PNG image (an unknown filter)")
        _grey_8bit(raw, row_bytes, image)
    else:
        image = lines[:, 1:]
    solid = np.unpackbits(image, axis=1, count=width)
    return pack(solid)


def _by_pillow(data: bytes, where: str) -> NDArray[np.uint8]:
    """Any other PNG as 8-bit grey."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data)) as image:
            if image.mode.startswith("I"):  # 16-bit grey
                return (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
            return np.asarray(image.convert("L"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as problem:
        raise InputError(f"{where}: not a readable PNG image ({problem})") from problem
