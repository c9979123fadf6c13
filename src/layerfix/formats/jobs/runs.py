"""Run-length codes of resin jobs, straight to and from packed rows.

A layer is one line of pixels, row after row; runs cross the ends of rows. Decoders set whole words of the packed
rows; encoders find the ends of runs by counting trailing zeros. Neither makes an 8-bit image, unless the layer
has greys.

Three codes (sources: catibo's cbddlp-ctb.adoc, BSD-2; uv3dp, MIT; the GOO specification V1.2):
  photon  a byte: bit 7 is the colour, bits 0 … 6 the length, at most 125 when written
  CTB     a byte: bits 0 … 6 are the grey value over 2; with bit 7 a length of 7, 14, 21 or 28 bits follows
  GOO     chunks of black, white, grey, or a difference to the previous grey, with 4 to 28 bits of length
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.bits import ALL, ROWS, U0, U1, WORK, lowest_bit
from layerfix.kernels import njit
from layerfix.layers.grey_image import ONES, Greys

if TYPE_CHECKING:
    from numpy.typing import NDArray

DATA = types.Array(types.uint8, 1, "C", readonly=True)
OUT = types.Array(types.uint8, 1, "C")
GREYS = types.Array(types.uint8, 2, "C")
STATE = types.Array(types.int64, 1, "C")
IMAGE = types.Array(types.uint8, 2, "C", readonly=True)
LONGEST_PHOTON = 125


@njit
def _set_run(rows, width, start, count):  # type: ignore[no-untyped-def]  # numba types it
    """Set `count` pixels from pixel `start` of the line of all rows."""
    while count > 0:
        y, x = start // width, start % width
        part = min(count, width - x)
        w0, w1 = x >> 6, (x + part - 1) >> 6
        head = ALL << np.uint64(x & 63)
        tail = ALL >> np.uint64(63 - ((x + part - 1) & 63))
        if w0 == w1:
            rows[y, w0] |= head & tail
        else:
            rows[y, w0] |= head
            for w in range(w0 + 1, w1):
                rows[y, w] = ALL
            rows[y, w1] |= tail
        start += part
        count -= part


@njit
def _run_length(rows, width, start, solid):  # type: ignore[no-untyped-def]  # numba types it
    """Length of the run of one colour that begins at pixel `start`, to the end of the layer at most."""
    height = rows.shape[0]
    total = width * height
    at = start
    while at < total:
        y, x = at // width, at % width
        w = x >> 6
        line = rows[y]
        bits = (~line[w] if solid else line[w]) >> np.uint64(x & 63)
        if bits != U0:
            found = lowest_bit(bits)
            if x + found < width:
                return at + found - start
            at += width - x
            continue
        at += min(64 - (x & 63), width - x)
    return total - start


@njit
def _solid_at(rows, width, at):  # type: ignore[no-untyped-def]  # numba types it
    y, x = at // width, at % width
    return (rows[y, x >> 6] >> np.uint64(x & 63)) & U1 != U0


# ------------------------------------------------------------------------------------------------ photon


@njit(types.int64(DATA, types.int64, WORK), cache=True, nogil=True)
def decode_photon(data, width, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Set the solid runs in zeroed `rows`; the number of pixels the data cover (they may be one short)."""
    total = width * rows.shape[0]
    at = 0
    for i in range(data.shape[0]):
        count = np.int64(data[i] & 0x7F)
        if data[i] & 0x80 and at < total:
            _set_run(rows, width, at, min(count, total - at))
        at += int(count)
    return at


@njit(OUT(ROWS, types.int64), cache=True, nogil=True)
def encode_photon(rows, width):  # type: ignore[no-untyped-def]  # numba types it
    """A black and white layer as photon runs."""
    total = width * rows.shape[0]
    out = np.empty(1024, np.uint8)
    n, at = 0, 0
    while at < total:
        solid = _solid_at(rows, width, at)
        count = _run_length(rows, width, at, solid)
        at += count
        chunks = (count + LONGEST_PHOTON - 1) // LONGEST_PHOTON
        if n + chunks > out.shape[0]:
            bigger = np.empty(2 * (n + chunks), np.uint8)
            bigger[:n] = out[:n]
            out = bigger
        colour = 0x80 if solid else 0
        for _ in range(chunks):
            part = min(count, LONGEST_PHOTON)
            out[n] = np.uint8(colour | part)
            n += 1
            count -= part
    return out[:n].copy()


# --------------------------------------------------------------------------------------------------- CTB


@njit
def _ctb_chunk(data, i):  # type: ignore[no-untyped-def]  # numba types it
    """(grey value, length, index after the chunk); length -1 if the data end within it."""
    code = int(data[i])
    value = (code & 0x7F) << 1
    if value:
        value |= 1
    i += 1
    if not code & 0x80:
        return value, 1, i
    if i >= data.shape[0]:
        return value, -1, i
    first = int(data[i])
    i += 1
    if not first & 0x80:
        return value, first, i
    if first & 0xC0 == 0x80:
        more, length = 1, first & 0x3F
    elif first & 0xE0 == 0xC0:
        more, length = 2, first & 0x1F
    elif first & 0xF0 == 0xE0:
        more, length = 3, first & 0x0F
    else:
        return value, -1, i
    if i + more > data.shape[0]:
        return value, -1, i
    for _ in range(more):
        length = length << 8 | int(data[i])
        i += 1
    return value, length, i


@njit(types.UniTuple(types.int64, 2)(DATA, types.int64, types.int64, WORK), cache=True, nogil=True)
def decode_ctb(data, width, threshold, rows):  # type: ignore[no-untyped-def]  # numba types it
    """(pixels covered or -1 for broken data, whether there are greys); rows: zeroed."""
    total = width * rows.shape[0]
    at, i, greys = 0, 0, 0
    while i < data.shape[0]:
        value, length, i = _ctb_chunk(data, i)
        if length < 0:
            return -1, 0
        if value != 0 and value != 255:
            greys = 1
        if value >= threshold and at < total:
            _set_run(rows, width, at, min(length, total - at))
        at += length
    return at, greys


@njit(types.void(DATA, GREYS), cache=True, nogil=True)
def decode_ctb_greys(data, image):  # type: ignore[no-untyped-def]  # numba types it
    """The grey image of data that `decode_ctb` found sound."""
    flat = image.reshape(-1)
    at, i = 0, 0
    while i < data.shape[0]:
        value, length, i = _ctb_chunk(data, i)
        for k in range(at, min(at + length, flat.shape[0])):
            flat[k] = value
        at += length


@njit
def _put_ctb(out, n, value, count):  # type: ignore[no-untyped-def]  # numba types it
    code = np.int64(value) >> 1
    if count == 1:
        out[n] = np.uint8(code)
        return n + 1
    out[n] = np.uint8(code | 0x80)
    n += 1
    if count < 1 << 7:
        out[n] = np.uint8(count)
        return n + 1
    if count < 1 << 14:
        out[n], out[n + 1] = np.uint8(count >> 8 | 0x80), np.uint8(count & 255)
        return n + 2
    if count < 1 << 21:
        out[n], out[n + 1], out[n + 2] = (
            np.uint8(count >> 16 | 0xC0),
            np.uint8(count >> 8 & 255),
            np.uint8(count & 255),
        )
        return n + 3
    out[n], out[n + 1] = np.uint8(count >> 24 | 0xE0), np.uint8(count >> 16 & 255)
    out[n + 2], out[n + 3] = np.uint8(count >> 8 & 255), np.uint8(count & 255)
    return n + 4


@njit
def _put_goo(out, n, value, count):  # type: ignore[no-untyped-def]  # numba types it
    kind = 0 if value == 0 else (3 if value == 255 else 1)
    more = 0 if count < 1 << 4 else (1 if count < 1 << 12 else (2 if count < 1 << 20 else 3))
    out[n] = np.uint8(kind << 6 | more << 4 | count & 15)
    n += 1
    if kind == 1:
        out[n] = np.uint8(value)
        n += 1
    for k in range(more - 1, -1, -1):
        out[n] = np.uint8(count >> (4 + 8 * k) & 255)
        n += 1
    return n


@njit
def _put(goo, out, n, value, count):  # type: ignore[no-untyped-def]  # numba types it
    longest = 1 << 28
    while count > 0:
        part = min(count, longest - 1)
        n = _put_goo(out, n, value, part) if goo else _put_ctb(out, n, value, part)
        count -= part
    return n


@njit(OUT(ROWS, types.int64, types.boolean), cache=True, nogil=True)
def encode_runs(rows, width, goo):  # type: ignore[no-untyped-def]  # numba types it
    """A black and white layer as GOO or CTB runs."""
    total = width * rows.shape[0]
    out = np.empty(4096, np.uint8)
    n, at = 0, 0
    while at < total:
        solid = _solid_at(rows, width, at)
        count = _run_length(rows, width, at, solid)
        at += count
        if n + 64 > out.shape[0]:
            bigger = np.empty(2 * out.shape[0], np.uint8)
            bigger[:n] = out[:n]
            out = bigger
        n = _put(goo, out, n, 255 if solid else 0, count)
    return out[:n].copy()


@njit(OUT(IMAGE, types.boolean, STATE), cache=True, nogil=True)
def _encode_band(image, goo, state):  # type: ignore[no-untyped-def]  # numba types it
    """The runs that end in a band of rows. state: the grey of the run that goes on, and its length so far (0 before
    the first band); of an empty band it is ended."""
    flat = image.reshape(-1)
    total = flat.shape[0]
    octets = flat[: total & ~7].view(np.uint64)
    lost = 0 if goo else 1
    out = np.empty(4096, np.uint8)
    n, at = 0, 0
    value, length = state[0], state[1]
    while at < total or (total == 0 and length > 0):
        if length == 0:
            value = np.int64(flat[at])
        stop = at
        while stop < total and np.int64(flat[stop]) >> lost == value >> lost:
            stop += 1
            if stop & 7 == 0:  # eight at a time
                eight = np.uint64(value) * ONES
                while stop >> 3 < octets.shape[0] and octets[stop >> 3] == eight:
                    stop += 8
        length += stop - at
        at = stop
        if at == total and total > 0:
            break
        if n + 64 > out.shape[0]:
            bigger = np.empty(2 * out.shape[0], np.uint8)
            bigger[:n] = out[:n]
            out = bigger
        n = _put(goo, out, n, value, length)
        length = 0
    state[0], state[1] = value, length
    return out[:n].copy()


def encode_greys(image: NDArray[np.uint8] | Greys, goo: bool) -> NDArray[np.uint8]:
    """A grey layer as GOO or CTB runs (CTB holds 7 bits: the lowest is lost); from `Greys` a band at a time."""
    state = np.zeros(2, np.int64)
    bands = image.bands() if isinstance(image, Greys) else [image]
    parts = [_encode_band(np.ascontiguousarray(band), goo, state) for band in bands]
    return np.concatenate([*parts, _encode_band(np.empty((0, 0), np.uint8), goo, state)])


# --------------------------------------------------------------------------------------------------- GOO


@njit
def _goo_chunk(data, i, before):  # type: ignore[no-untyped-def]  # numba types it
    """(grey value, length, index after the chunk) given the value before; length -1 if the data end within it."""
    code = int(data[i])
    kind, more = code >> 6, code >> 4 & 3
    i += 1
    if kind == 2:
        length = 1
        if more & 1:
            if i >= data.shape[0]:
                return before, -1, i
            length = int(data[i])
            i += 1
        value = before - (code & 15) if more & 2 else before + (code & 15)
        return value & 255, length, i
    value = 0 if kind == 0 else 255
    if i + more + (kind == 1) > data.shape[0]:
        return before, -1, i
    if kind == 1:
        value = int(data[i])
        i += 1
    length = 0
    for _ in range(more):
        length = length << 8 | int(data[i])
        i += 1
    return value, length << 4 | code & 15, i


@njit(types.UniTuple(types.int64, 2)(DATA, types.int64, types.int64, WORK), cache=True, nogil=True)
def decode_goo(data, width, threshold, rows):  # type: ignore[no-untyped-def]  # numba types it
    """(pixels covered or -1 for broken data, whether there are greys); rows: zeroed."""
    total = width * rows.shape[0]
    at, i, greys, value = 0, 0, 0, 0
    while i < data.shape[0]:
        value, length, i = _goo_chunk(data, i, value)
        if length < 0:
            return -1, 0
        if value != 0 and value != 255:
            greys = 1
        if value >= threshold and at < total:
            _set_run(rows, width, at, min(length, total - at))
        at += length
    return at, greys


@njit(types.void(DATA, GREYS), cache=True, nogil=True)
def decode_goo_greys(data, image):  # type: ignore[no-untyped-def]  # numba types it
    """The grey image of data that `decode_goo` found sound."""
    flat = image.reshape(-1)
    at, i, value = 0, 0, 0
    while i < data.shape[0]:
        value, length, i = _goo_chunk(data, i, value)
        for k in range(at, min(at + length, flat.shape[0])):
            flat[k] = value
        at += length


# ------------------------------------------------------------------------------------------- CTB's cipher


@njit(types.Array(types.uint8, 1, "C")(types.uint32, types.uint32, types.int64), cache=True, nogil=True)
def key_stream(seed, layer, size):  # type: ignore[no-untyped-def]  # numba types it
    """The bytes that a CTB layer is XORed with: words of a linear sequence, little-endian (catibo)."""
    step = np.uint32(seed * np.uint32(0x2D83CDAC) + np.uint32(0xD8A83423))
    key = np.uint32(np.uint32(layer * np.uint32(0x1E1530CD) + np.uint32(0xEC3D47CD)) * step)
    out = np.empty(size, np.uint8)
    for i in range(size):
        out[i] = np.uint8(key >> np.uint32(8 * (i & 3)) & np.uint32(255))
        if i & 3 == 3:
            key = np.uint32(key + step)
    return out
