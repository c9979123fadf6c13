"""The filters of PNG (ISO/IEC 15948, section 9), undone straight into packed rows.

Kernels of `layerfix.formats.png.decode`, which loads them when the first image is read.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types

from layerfix.bits import U0, U1, U63, WORK

GREYS = types.Array(types.uint8, 1, "C", readonly=True)
IMAGE = types.Array(types.uint8, 2, "C")
NONE, SUB, UP, AVERAGE, PAETH = range(5)
ONES = np.uint64(0x0101010101010101)


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
def rows_8bit(raw, width, threshold, rows):  # type: ignore[no-untyped-def]
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
def grey_8bit(raw, width, image):  # type: ignore[no-untyped-def]
    """Filtered bytes of an 8-bit image, known to be sound → the image."""
    above = np.zeros(width, np.uint8)
    for y in range(image.shape[0]):
        start = y * (width + 1)
        _unfilter(raw[start], raw[start + 1 : start + 1 + width], above, image[y])
        above = image[y]
