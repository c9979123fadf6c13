"""Packed rows: the storage every layer uses, and the smallest kernels on it.

The contract, written down once: a layer is ``(height, words)`` uint64, C-ordered. Pixel x of row y is bit
``x % 64`` of ``rows[y, x // 64]``. Bits at or past the width are 0. Outside the frame is empty.
Kernels trust this; `layerfix.stack.Layer` checks it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.errors import InputError
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Rows = NDArray[np.uint64]
    Image = NDArray[np.bool_]

# Explicit signatures: one compilation per kernel, cached on disk, whatever array comes (numba would
# compile a read-only array anew). ROWS is an input, WORK is written to.
ROWS = types.Array(types.uint64, 2, "C", readonly=True)
WORK = types.Array(types.uint64, 2, "C")
ROW_BITS = types.Array(types.uint64, 1, "C")
U0, U1, U63 = np.uint64(0), np.uint64(1), np.uint64(63)
ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


def words_for(width: int) -> int:
    """Words in a row of `width` pixels."""
    return (width + 63) // 64


def pack(image: ArrayLike) -> Rows:
    """(H, W) bool (or anything where non-zero is solid) → (H, words) uint64 packed rows.

    >>> unpack(pack([[0, 1, 1]]), 3).astype(int).tolist()
    [[0, 1, 1]]
    """
    array = np.asarray(image)
    if array.ndim != 2:
        raise InputError(f"an image has two dimensions, this array has shape {array.shape}")
    solid = array if array.dtype == np.bool_ else array != 0
    height, width = solid.shape
    packed = np.zeros((height, words_for(width) * 8), np.uint8)
    packed[:, : (width + 7) // 8] = np.packbits(solid, axis=1, bitorder="little")
    return packed.view("<u8").astype(np.uint64, copy=False)


def unpack(rows: Rows, width: int) -> Image:
    """(H, words) uint64 packed rows → (H, width) bool."""
    if rows.ndim != 2 or rows.dtype != np.uint64 or rows.shape[1] != words_for(width):
        raise InputError(
            f"packed rows of width {width} are (height, {words_for(width)}) uint64; got {rows.shape} {rows.dtype}"
        )
    as_bytes = np.ascontiguousarray(rows).astype("<u8", copy=False).view(np.uint8)
    return np.unpackbits(as_bytes, axis=1, bitorder="little", count=width).view(np.bool_)


# Kernels here and elsewhere carry no annotations ("no-untyped-def"): their types are numba's, stated in the
# signature, or taken from the caller; what Python calls from outside is annotated.
@njit
def popcount(x):  # type: ignore[no-untyped-def]  # numba types it
    """Set bits of one word (LLVM turns this into one instruction)."""
    x = x - ((x >> U1) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit
def lowest_bit(x):  # type: ignore[no-untyped-def]  # numba types it
    """Index of the lowest set bit of a word that is not 0."""
    return popcount((x & (U0 - x)) - U1)


@njit
def highest_bit(x):  # type: ignore[no-untyped-def]  # numba types it
    """Index of the highest set bit of a word that is not 0."""
    x |= x >> U1
    x |= x >> np.uint64(2)
    x |= x >> np.uint64(4)
    x |= x >> np.uint64(8)
    x |= x >> np.uint64(16)
    x |= x >> np.uint64(32)
    return popcount(x) - 1


@njit
def _put_mirrored(words, across, shift, line):  # type: ignore[no-untyped-def]  # numba types it
    """line[:] = words, mirrored along the columns if `across`; shift: bits past the width."""
    count = line.shape[0]
    if not across:
        for w in range(count):
            line[w] = words[w]
        return
    up = (np.uint64(64) - shift) & U63
    before = U0  # the reversed word to the right of this one in `words`
    for w in range(count):
        x = words[w]
        if x != U0:
            for half, mask in (
                (np.uint64(1), np.uint64(0x5555555555555555)),
                (np.uint64(2), np.uint64(0x3333333333333333)),
                (np.uint64(4), np.uint64(0x0F0F0F0F0F0F0F0F)),
                (np.uint64(8), np.uint64(0x00FF00FF00FF00FF)),
                (np.uint64(16), np.uint64(0x0000FFFF0000FFFF)),
                (np.uint64(32), np.uint64(0x00000000FFFFFFFF)),
            ):
                x = ((x >> half) & mask) | ((x & mask) << half)
        # Reversed, the row's pixels end at the last bit; they are moved down to bit 0.
        line[count - 1 - w] = (x >> shift) | ((before << up) if shift else U0)
        before = x


@njit(types.void(ROWS, types.int64, types.boolean, types.boolean, WORK), cache=True, nogil=True)
def _mirror(rows, width, across, down, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = rows, mirrored along its columns if `across`, along its rows if `down`; both may be one array."""
    height, words = rows.shape
    shift = np.uint64(64 * words - width)
    upper, lower = np.empty(words, np.uint64), np.empty(words, np.uint64)
    for y in range((height + 1) // 2):
        z = height - 1 - y
        for w in range(words):
            upper[w], lower[w] = rows[y, w], rows[z, w]
        _put_mirrored(upper, across, shift, out[z if down else y])
        _put_mirrored(lower, across, shift, out[y if down else z])


def mirrored(rows: Rows, width: int, axes: str, out: Rows | None = None) -> Rows:
    """(H, words): the layer mirrored along its columns ("x"), its rows ("y"), both or neither ("").

    out  takes the result, and may be `rows` itself; a new array if not given (or `rows`, if there is no axis)
    """
    if not axes:
        return rows
    out = np.empty_like(rows) if out is None else out
    _mirror(rows, width, "x" in axes, "y" in axes, out)
    return out
