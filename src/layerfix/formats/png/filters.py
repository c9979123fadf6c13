"""The filters of PNG (ISO/IEC 15948, section 9), undone straight into packed rows.

Kernels of `layerfix.formats.png.decode`, called with some whole rows at a time: the row above is taken from the
packed rows where it is black and white, and otherwise from a line of bytes that is handed on from call to call.
"""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import U0, U1, U63, WORK
from layerfix.kernels import njit
from layerfix.layers.grey_image import AT, FIRSTS, ONES, TARGET, pack_octets, pack_part, spread_bits

GREYS = types.Array(types.uint8, 1, "C", readonly=True)
LINES = types.Array(types.uint8, 2, "C")
NONE, SUB, UP, AVERAGE, PAETH = range(5)


@njit
def _unfilter(kind, raw, above, line):  # type: ignore[no-untyped-def]  # numba types it
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
def _note(part, threshold, w, out, at, values, found):  # type: ignore[no-untyped-def]  # numba types it
    """Pack up to 64 greys, and keep them if one is neither 0 nor 255. Returns how many words are kept then."""
    out[w], greys = pack_part(part, threshold)
    if greys:
        at[found] = w
        for i in range(part.shape[0]):
            values[found, i] = part[i]
        for i in range(part.shape[0], 64):
            values[found, i] = np.uint8(0)
        found += 1
    return found


@njit
def _pack_line(line, threshold, out, at, values, used):  # type: ignore[no-untyped-def]  # numba types it
    """Pack one row of greys, and note the words of it that have one that is neither 0 nor 255. How many there are."""
    width, found = line.shape[0], used
    octets = line[: width // 64 * 64].view(np.uint64)
    for w in range(out.shape[0]):
        if w < width // 64:
            word, greys = pack_octets(octets, 8 * w)
            if not greys:
                out[w] = word
                continue
        found = _note(line[w * 64 : min(w * 64 + 64, width)], threshold, w, out, at, values, found)
    return found - used


@njit
def _sub_line(raw, line, threshold, out, at, values, used):  # type: ignore[no-untyped-def]  # numba types it
    """`_unfilter` of filter Sub and `_pack_line` at once: words in which nothing changes are as the pixel before."""
    width, found, left = line.shape[0], used, np.uint8(0)
    whole = width // 64
    octets, done = raw[: whole * 64].view(np.uint64), line[: whole * 64].view(np.uint64)
    for w in range(out.shape[0]):
        if w < whole and (left in (0, 255)):
            seen = U0
            for k in range(8):
                seen |= octets[8 * w + k]
            if seen == U0:
                out[w] = np.uint64(left) * ONES
                for k in range(8):
                    done[8 * w + k] = out[w]
                continue
        for i in range(64 * w, min(64 * w + 64, width)):
            left = np.uint8(left + raw[i])
            line[i] = left
        found = _note(line[w * 64 : min(w * 64 + 64, width)], threshold, w, out, at, values, found)
    return found - used


@njit
def _octet(q, bit):  # type: ignore[no-untyped-def]  # numba types it
    """Bit `bit` of each of the eight bytes of q, as eight bits (the first byte's lowest)."""
    return (((q >> np.uint64(bit)) & ONES) * np.uint64(0x0102040810204080)) >> np.uint64(56)


@njit
def _flat_bytes(q):  # type: ignore[no-untyped-def]  # numba types it
    """True if every byte of q is 0, 1 or 255: bits 1 … 7 alike, and 0 set where they are."""
    return ((q ^ (q >> U1)) & np.uint64(0x7E7E7E7E7E7E7E7E)) | ((q >> np.uint64(7)) & ~q & ONES) == U0


@njit
def _running_xor(x):  # type: ignore[no-untyped-def]  # numba types it
    """Bit i of the result is the XOR of bits 0 … i."""
    for shift in (1, 2, 4, 8, 16, 32):
        x ^= x << np.uint64(shift)
    return x


@njit
def _fast_row(raw, kind, above, out):  # type: ignore[no-untyped-def]  # numba types it
    """Pack one row if it is black and white with filter None, Sub or Up; else False, with `out` half written.

    above, out  packed rows; `above` holds all that is in the row above
    """
    width = raw.shape[0]
    octets = raw[: width // 64 * 64].view(np.uint64)
    rest = np.zeros(64, np.uint8)
    for i in range(width & 63):
        rest[i] = raw[(width & ~63) + i]
    last = rest.view(np.uint64)
    carry = U0
    for w in range(out.shape[0]):
        part = octets[8 * w : 8 * w + 8] if w < width // 64 else last
        before = above[w] if kind == UP else U0
        any_bits = part[0] | part[1] | part[2] | part[3] | part[4] | part[5] | part[6] | part[7]
        if any_bits == U0:
            out[w] = carry if kind == SUB else before
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
        out[w] = word
    if width & 63:
        out[out.shape[0] - 1] &= (U1 << np.uint64(width & 63)) - U1
    return True


@njit(
    types.int64(GREYS, types.int64, types.int64, types.uint8, WORK, LINES, FIRSTS, AT, TARGET, types.int64),
    cache=True,
    nogil=True,
)
def unfilter_8bit(raw, y, width, threshold, rows, lines, firsts, at, values, used):  # type: ignore[no-untyped-def]  # numba types it
    """Filtered rows of an 8-bit image, the first of them row `y`, → packed rows, and words with greys.

    raw    whole rows of 1 + width bytes
    lines  (3, width) uint8, the same from call to call: the row above if it has greys, this row, [2, 0] says which
    firsts, at, values  as in `layerfix.layers.grey_image.GreyImage`, with room for every word of these rows
    used   words with greys so far
    returns how many there are then; -1 for a filter that does not exist
    """
    above, line, has_greys = lines[0], lines[1], lines[2]
    none_above = np.zeros(rows.shape[1], np.uint64)
    for k in range(raw.shape[0] // (width + 1)):
        here = raw[k * (width + 1) + 1 : (k + 1) * (width + 1)]
        kind, out = raw[k * (width + 1)], rows[y + k]
        bits_above = rows[y + k - 1] if y + k > 0 else none_above
        fast = kind <= SUB or (kind == UP and has_greys[0] == 0)
        if fast and _fast_row(here, kind, bits_above, out):
            has_greys[0] = 0
        else:
            if has_greys[0] == 0:
                spread_bits(bits_above, above)
            if kind == SUB:
                found = _sub_line(here, line, threshold, out, at, values, used)
            elif _unfilter(kind, here, above, line):
                found = _pack_line(line, threshold, out, at, values, used)
            else:
                return -1
            used += found
            has_greys[0] = found > 0
            if found:
                above, line = line, above
        firsts[y + k + 1] = used
    if has_greys[0]:  # in the next call, the row above is the first line again
        for x in range(width):
            lines[0, x] = above[x]
    return used


@njit(types.int64(GREYS, types.int64, types.int64, WORK, LINES), cache=True, nogil=True)
def unfilter_1bit(raw, y, width, rows, lines):  # type: ignore[no-untyped-def]  # numba types it
    """The same for a 1-bit image: rows of 1 + ⌈width / 8⌉ bytes, the leftmost pixel in the highest bit.

    lines  (3, ⌈width / 8⌉): the row above
    """
    size = lines.shape[1]
    above, line = lines[0], lines[1]
    for k in range(raw.shape[0] // (size + 1)):
        start = k * (size + 1)
        if not _unfilter(raw[start], raw[start + 1 : start + 1 + size], above, line):
            return -1
        out = rows[y + k]
        for w in range(out.shape[0]):
            word = U0
            for i in range(min(8, size - 8 * w)):
                byte = np.uint64(line[8 * w + i])
                # Eight bits reversed, after Sean Anderson's "Bit Twiddling Hacks".
                byte = (((byte * np.uint64(0x0802) & np.uint64(0x22110)) | (byte * np.uint64(0x8020) & np.uint64(
                    0x88440))) * np.uint64(0x10101) >> np.uint64(16)) & np.uint64(0xFF)  # fmt: skip
                word |= byte << np.uint64(8 * i)
            out[w] = word
        if width & 63:
            out[out.shape[0] - 1] &= (U1 << np.uint64(width & 63)) - U1
        for i in range(size):
            above[i] = line[i]
    return raw.shape[0] // (size + 1)
