"""Grey layers held small: 64 pixels of one row are a bit each where all are black or white, else a byte each.

Anti-aliased edges are a few words of a row: of a 12K layer's 59 MB some 10 are left, and none of it is ever written
out in full. Who needs the values takes them in bands of rows that stay in the processor's cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import types

from layerfix.bits import ALL, ROWS, U0, U1, WORK, words_for
from layerfix.kernels import njit

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray

    from layerfix.bits import Rows

    Values = NDArray[np.uint8]

BAND_BYTES = 1 << 20
IMAGE = types.Array(types.uint8, 2, "C", readonly=True)
TARGET = types.Array(types.uint8, 2, "C")
FIRSTS = types.Array(types.int64, 1, "C")
AT = types.Array(types.int32, 1, "C")
ONES, LOW_SEVEN = np.uint64(0x0101010101010101), np.uint64(0x7F7F7F7F7F7F7F7F)
BIT_OF_BYTE = np.uint64(0x8040201008040201)  # byte i holds bit i


@njit
def spread_octet(bits):  # type: ignore[no-untyped-def]  # numba types it
    """The lowest eight bits as eight bytes, 255 where set."""
    own = ((bits & np.uint64(255)) * ONES) & BIT_OF_BYTE
    return (((((own & LOW_SEVEN) + LOW_SEVEN) | own) >> np.uint64(7)) & ONES) * np.uint64(255)


@njit
def spread_bits(bits, line):  # type: ignore[no-untyped-def]  # numba types it
    """A packed row as bytes, 255 where solid."""
    width = line.shape[0]
    octets = line[: width & ~7].view(np.uint64)
    for w in range(bits.shape[0]):
        word, part = bits[w], octets[8 * w : min(8 * w + 8, octets.shape[0])]
        if word + U1 <= U1:  # all black, or all white
            for k in range(part.shape[0]):
                part[k] = word
        else:
            for k in range(part.shape[0]):
                part[k] = spread_octet(word >> np.uint64(8 * k))
    for x in range(width & ~7, width):
        line[x] = np.uint8(U0 - ((bits[x >> 6] >> np.uint64(x & 63)) & U1))


@njit
def pack_octets(octets, first):  # type: ignore[no-untyped-def]  # numba types it
    """(64 greys as bits, False) if all are 0 or 255, from octets[first] on; else (anything, True)."""
    some, every, word = U0, ALL, U0
    for k in range(8):
        some |= octets[first + k]
        every &= octets[first + k]
    if some == U0 or every == ALL:
        return every, False
    for k in range(8):
        on = (octets[first + k] >> np.uint64(7)) & ONES
        if on * np.uint64(255) != octets[first + k]:
            return word, True
        # Eight bits from the eight bytes: each moves to the top byte, to a place of its own.
        word |= ((on * np.uint64(0x0102040810204080)) >> np.uint64(56)) << np.uint64(8 * k)
    return word, False


@njit
def pack_part(part, threshold):  # type: ignore[no-untyped-def]  # numba types it
    """(the bits of up to 64 greys from `threshold` on, whether one of them is neither 0 nor 255)."""
    if part.shape[0] == 64:
        word, greys = pack_octets(part.view(np.uint64), 0)
        if greys:
            word = U0
            for i in range(64):
                word |= np.uint64(part[i] >= threshold) << np.uint64(i)
        return word, greys
    word, seen = U0, np.uint8(0)
    for i in range(part.shape[0]):
        seen |= np.uint8(part[i] + np.uint8(1)) & np.uint8(254)
        word |= np.uint64(part[i] >= threshold) << np.uint64(i)
    return word, seen != np.uint8(0)


@njit(types.int64(IMAGE, WORK, FIRSTS), cache=True, nogil=True)
def _count_greys(image, bright, firsts):  # type: ignore[no-untyped-def]  # numba types it
    """bright = which pixels are 255, where all of a word are 0 or 255; firsts[y]: words with greys above row y."""
    height, width = image.shape
    found = 0
    for y in range(height):
        firsts[y] = found
        for w in range(bright.shape[1]):
            bright[y, w], greys = pack_part(image[y, w * 64 : min(w * 64 + 64, width)], np.uint8(255))
            found += greys
    firsts[height] = found
    return found


@njit(types.void(IMAGE, AT, TARGET), cache=True, nogil=True)
def _take_greys(image, at, values):  # type: ignore[no-untyped-def]  # numba types it
    """The words that have greys, in order, and their pixels; as many as `_count_greys` found."""
    height, width = image.shape
    found = 0
    for y in range(height):
        for w in range((width + 63) // 64):
            part = image[y, w * 64 : min(w * 64 + 64, width)]
            _, greys = pack_part(part, np.uint8(255))
            if greys:
                at[found] = w
                for i in range(64):
                    values[found, i] = part[i] if i < part.shape[0] else np.uint8(0)
                found += 1


@njit(types.void(ROWS, FIRSTS, AT, TARGET, types.int64, TARGET), cache=True, nogil=True)
def _expand(bright, firsts, at, values, y, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = rows y … of the image, as bytes."""
    count, width = out.shape
    for k in range(count):
        line = out[k]
        spread_bits(bright[y + k], line)
        for n in range(firsts[y + k], firsts[y + k + 1]):
            part = line[64 * at[n] : min(64 * at[n] + 64, width)]
            for i in range(part.shape[0]):
                part[i] = values[n, i]


@njit(types.void(FIRSTS, AT, TARGET, types.uint8, WORK), cache=True, nogil=True)
def _cut(firsts, at, values, threshold, rows):  # type: ignore[no-untyped-def]  # numba types it
    """The bits of the words that have greys: set from `threshold` on. Pixels past the width are 0."""
    for y in range(rows.shape[0]):
        for n in range(firsts[y], firsts[y + 1]):
            word = U0
            for i in range(64):
                word |= np.uint64(values[n, i] >= threshold) << np.uint64(i)
            rows[y, at[n]] = word


class Greys:
    """An image of 8-bit greys that is given in bands. shape: (H, W)."""

    def __init__(self, shape: tuple[int, int], make: Callable[[], Iterator[Values]]) -> None:
        self.shape, self._make = shape, make

    def bands(self) -> Iterator[Values]:
        """(n, W) uint8, from the first row on; each is good until the next is asked for."""
        return self._make()

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """All of it, (H, W) uint8."""
        out, y = np.empty(self.shape, np.uint8), 0
        for band in self.bands():
            out[y : y + len(band)] = band
            y += len(band)
        return out if dtype is None else out.astype(dtype)

    def mirrored(self, axes: str) -> Greys:
        """The image mirrored along its columns ("x"), its rows ("y": the last row comes first, so all of it is
        held), both or neither ("")."""
        if not axes:
            return self
        across = -1 if "x" in axes else 1
        if "y" in axes:
            return GreyImage.of(np.asarray(self)[::-1, ::across])
        return Greys(self.shape, lambda: (_backwards(band) for band in self.bands()))

    def in_bits(self, bits: int) -> Greys:
        """The image in so many bits, 2 … 8."""
        if bits == 8:
            return self
        most = (1 << bits) - 1
        levels = np.round(np.round(np.arange(256) * most / 255) * 255 / most).astype(np.uint8)
        return Greys(self.shape, lambda: (levels[band] for band in self.bands()))


def _backwards(band: Values) -> Values:
    """(n, W) uint8, each row from its end; by eight pixels if that can be: 4 × as fast."""
    if band.shape[1] % 8:
        return band[:, ::-1]
    return np.ascontiguousarray(band).view(np.uint64)[:, ::-1].byteswap().view(np.uint8)


class GreyImage(Greys):
    """An image of 8-bit greys, (H, W), held small.

    bright  (H, words) packed: what is 255, in words without greys; the bits of the others may be anything
    firsts  (H + 1,) int64: how many words with greys there are above each row
    at      (n,) int32: which word of its row each of them is
    values  (n, 64) uint8: its pixels, 0 past the width
    """

    def __init__(
        self, width: int, bright: Rows, firsts: NDArray[np.int64], at: NDArray[np.int32], values: Values
    ) -> None:
        self.shape = len(bright), width
        self.bright, self.firsts, self.at, self.values = bright, firsts, at, values

    @classmethod
    def of(cls, image: NDArray[np.uint8] | GreyImage) -> GreyImage:
        """The same as an array, (H, W) uint8."""
        if isinstance(image, GreyImage):
            return image
        image = np.ascontiguousarray(image)
        height, width = image.shape
        bright, firsts = np.empty((height, words_for(width)), np.uint64), np.empty(height + 1, np.int64)
        count = _count_greys(image, bright, firsts)
        at, values = np.empty(count, np.int32), np.empty((count, 64), np.uint8)
        _take_greys(image, at, values)
        return cls(width, bright, firsts, at, values)

    def at_least(self, threshold: int, first: int = 0, stop: int | None = None) -> Rows:
        """(H, words): the pixels from `threshold` on, 1 … 255; of all rows, or of some."""
        stop = self.shape[0] if stop is None else stop
        rows = self.bright[first:stop].copy()
        _cut(self.firsts[first : stop + 1], self.at, self.values, threshold, rows)
        return rows

    def rows(self, first: int, stop: int, room: Values | None = None) -> Values:
        """(stop - first, W) uint8: some rows. room: at least as many, to be written to."""
        out = np.empty((stop - first, self.shape[1]), np.uint8) if room is None else room[: stop - first]
        _expand(self.bright, self.firsts, self.at, self.values, first, out)
        return out

    def bands(self) -> Iterator[Values]:
        room = None
        for first, stop in bands_of(*self.shape):
            band = self.rows(first, stop, room)
            room = band if room is None else room
            yield band


def bands_of(height: int, width: int) -> Iterator[tuple[int, int]]:
    """(first row, past the last) of bands of about BAND_BYTES pixels."""
    step = max(BAND_BYTES // max(width, 1), 1)
    for first in range(0, height, step):
        yield first, min(first + step, height)
