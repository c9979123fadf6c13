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

from layerfix.bits import pack, words_for
from layerfix.errors import InputError
from layerfix.formats.png.encode import SIGNATURE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows


@dataclass(frozen=True, eq=False)
class Decoded:
    """A decoded layer: packed rows, and the grey image (H, W) uint8 if it has any value but 0 and 255."""

    rows: Rows
    grey: NDArray[np.uint8] | None


def decode_png(data: bytes, where: str, size_px: tuple[int, int], *, threshold: int = 128) -> Decoded:
    """Packed rows of a PNG: solid where the grey value is at least `threshold`.

    where, size_px  what errors name, and the (width, height) it must have: nothing larger is ever inflated
    raises          InputError for what is no PNG, is cut short or corrupt, or has another size
    """
    from layerfix.formats.png import filters as png_filters

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
    if png_filters.rows_if_binary(raw, width, rows):
        return Decoded(rows, None)
    greys = png_filters.rows_8bit(raw, width, threshold, rows)
    if greys < 0:
        raise InputError(f"{where}: not a readable PNG image (an unknown filter)")
    if not greys:
        return Decoded(rows, None)
    grey = np.empty((height, width), np.uint8)
    png_filters.grey_8bit(raw, width, grey)
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
    from layerfix.formats.png.filters import PAETH, grey_8bit

    row_bytes = (width + 7) // 8
    lines = raw.reshape(len(rows), 1 + row_bytes)
    if lines[:, 0].any():
        image = np.empty((len(rows), row_bytes), np.uint8)
        if lines[:, 0].max() > PAETH:
            raise InputError(f"{where}: not a readable PNG image (an unknown filter)")
        grey_8bit(raw, row_bytes, image)
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
