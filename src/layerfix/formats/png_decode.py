"""A PNG file as one packed layer. Specification: PNG (ISO/IEC 15948), filters in section 9.

Mask printers' layers are 8-bit grey and mostly black and white. Then every filtered byte is 0, 1 or 255: a
pixel turned on or off against the one to its left (Sub), above (Up) or against black (None). So eight bytes
at a time are packed to bits, and the filter is undone on 64 pixels at once: an XOR with the row above, or a
running XOR along the row. Layers with greys, or with other filters, take the general way, a byte at a time;
every other kind of PNG (16-bit, palette, colour, interlaced) is read by Pillow.
"""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit, types

from layerfix.bits import U0, U1, U63, WORK, pack, words_for
from layerfix.errors import InputError
from layerfix.formats.png import SIGNATURE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

GREYS = types.Array(types.uint8, 1, "C", readonly=True)
LINE = types.Array(types.uint8, 1, "C")
IMAGE = types.Array(types.uint8, 2, "C")
NONE, SUB, UP, AVERAGE, PAETH = range(5)
ONES = np.uint64(0x0101010101010101)


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


@njit
def _octet(q, bit):  # type: ignore[no-untyped-def]
    """Bit `bit` of each of the eight bytes of q, as eight bits (the first byte's lowest)."""
    return (((q >> np.uint64(bit)) & ONES) * np.uint64(0x0102040810204080)) >> np.uint64(56)


@njit
def _flat_bytes(q):  # type: ignore[no-untyped-def]
    """True if every byte of q is 0, 1 or 255: bits 1 … 7 alike, and 0 set where they are."""
    return ((q ^ (q >> U1)) & np.uint64(0x7E7E7E7E7E7E7E7E)) | ((q >> np.uint64(7)) & ~q & ONES) == U0


@njit
def _running_xor(x):  # type: ignore[no-untyped-def]
    """Bit i of the result is the XOR of bits 0 … i."""
    for shift in (1, 2, 4, 8, 16, 32):
        x ^= x << np.uint64(shift)
    return x


@njit(types.boolean(GREYS, types.int64, WORK), cache=True, nogil=True)
def rows_if_binary(raw, width, rows):  # type: ignore[no-untyped-def]
    """Filtered bytes of an 8-bit image → packed rows, if it is black and white with filters None, Sub, Up.

    False, with `rows` half written, if it turns out not to be.
    """
    octets = np.zeros(rows.shape[1] * 8, np.uint64)  # a row's bytes; past the width they stay 0
    tail = np.zeros(8, np.uint8)
    for y in range(rows.shape[0]):
        start = y * (width + 1)
        kind = raw[start]
        if kind > UP:
            return False
        whole = width // 8
        line = raw[start + 1 : start + 1 + whole * 8].view(np.uint64)
        for i in range(whole):
            octets[i] = line[i]
        if width & 7:
            for i in range(width & 7):
                tail[i] = raw[start + 1 + whole * 8 + i]
            octets[whole] = tail.view(np.uint64)[0]
        carry = U0
        for w in range(rows.shape[1]):
            part = octets[w * 8 : w * 8 + 8]
            before = rows[y - 1, w] if kind == UP and y > 0 else U0
            any_bits = part[0] | part[1] | part[2] | part[3] | part[4] | part[5] | part[6] | part[7]
            if any_bits == U0:
                rows[y, w] = carry if kind == SUB else before
                continue
            turned, on = U0, U0
            for k in range(8):
                q = part[k]
                if not _flat_bytes(q):
                    return False
                turned |= _octet(q, 0) << np.uint64(8 * k)
                on |= _octet(q, 7) << np.uint64(8 * k)
            if kind == SUB:
                word = _running_xor(turned) ^ carry
                before = (word << U1) | (carry & U1)
                carry = U0 - (word >> U63)
            else:
                word = before ^ turned
            if (on & before) | (turned & ~on & ~before) != U0:  # 255 + 255, or 0 + 1: a grey after all
                return False
            rows[y, w] = word
        if width & 63:
            rows[y, rows.shape[1] - 1] &= (U1 << np.uint64(width & 63)) - U1
    return True


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
        grey = _by_pillow(data, where, size_px)
        has_greys = bool(((grey != 0) & (grey != 255)).any())
        return Decoded(pack(grey >= threshold), grey if has_greys else None)
    row_bytes = width if depth == 8 else (width + 7) // 8
    raw = np.frombuffer(_inflate(stream, height * (1 + row_bytes), where), np.uint8)
    rows = np.zeros((height, words_for(width)), np.uint64)
    if depth == 1:
        return Decoded(_rows_1bit(raw, width, rows, where), None)
    if rows_if_binary(raw, width, rows):
        return Decoded(rows, None)
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
        raise InputError(f"{where}: not a readable PNG image")
    header, parts, at = b"", [], 8
    while at + 12 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        crc = data[at + 8 + size : at + 12 + size]
        if len(crc) < 4:
            break
        if zlib.crc32(body, zlib.crc32(kind)) != int.from_bytes(crc, "big"):
            raise InputError(f"{where}: not a readable PNG image (wrong checksum)")
        if kind == b"IHDR":
            header = body
        elif kind == b"IDAT":
            parts.append(body)
        elif kind == b"IEND":
            if len(header) != 13 or not parts:
                break
            return header, parts[0] if len(parts) == 1 else b"".join(parts)
        at += 12 + size
    raise InputError(f"{where}: not a readable PNG image (it is cut short)")


def _inflate(stream: bytes, size: int, where: str) -> bytes:
    """Inflate a zlib stream that must give exactly `size` bytes; no more are ever made."""
    from zlib_ng import zlib_ng

    broken: Any = zlib_ng.error  # typed as an instance in its stubs
    try:
        raw: bytes = zlib_ng.decompressobj().decompress(stream, size + 1)
    except broken as problem:
        raise InputError(f"{where}: not a readable PNG image ({problem})") from problem
    if len(raw) != size:
        raise InputError(f"{where}: not a readable PNG image (too {'much' if len(raw) > size else 'little'} data)")
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


def _by_pillow(data: bytes, where: str, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Any other PNG as 8-bit grey."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as image:  # its size is checked
            if image.size != size_px:
                raise InputError(f"{where}: not a readable PNG image (two headers that disagree)")
            if image.mode.startswith("I"):  # 16-bit grey
                return (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
            return np.asarray(image.convert("L"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as problem:
        raise InputError(f"{where}: not a readable PNG image ({problem})") from problem
