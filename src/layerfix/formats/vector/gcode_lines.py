"""Numbers of moves → lines of G-code as bytes, as Python's `%` writes them: most of the time of writing a layer."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.fdm.moves import LIFT, RETRACT
from layerfix.kernels import njit

POINTS = types.Array(types.float64, 2, "A", readonly=True)
NUMBERS = types.Array(types.float64, 1, "A", readonly=True)
KINDS = types.Array(types.int64, 1, "A", readonly=True)
LINES = types.Tuple((types.uint8[::1], types.int64[::1]))
LONGEST = 80  # bytes of a line: three numbers of at most 20 digits and their letters
XY, E, Z, F = (tuple(ord(c) for c in text) for text in ("G1 X", "G1 E", "G1 Z", " F"))
SPLIT = 2.0**27 + 1  # halves the digits of a double
SIGNIFICANT = 6  # digits of a height


@njit
def _put(out, n, text):  # type: ignore[no-untyped-def]  # numba types it
    for c in text:
        out[n] = c
        n += 1
    return n


@njit
def _rounded(value, scale):  # type: ignore[no-untyped-def]  # numba types it
    """value · scale as the nearest integer, halves to the even one: what lies at a half only because the product is
    rounded is told by the rest of the product (Dekker 1971)."""
    product = value * scale
    high = value * SPLIT
    high = high - (high - value)
    rest = (high * scale - product) + (value - high) * scale
    nearest = np.rint(product)
    if product - nearest == 0.5 and rest > 0:
        nearest += 1
    elif product - nearest == -0.5 and rest < 0:
        nearest -= 1
    return np.int64(nearest)


@njit
def _fixed(out, n, value, decimals):  # type: ignore[no-untyped-def]  # numba types it
    """The value with so many digits after the point, as "%.3f" has three."""
    if value < 0:
        out[n] = ord("-")
        n += 1
    scale = 10**decimals
    scaled = _rounded(abs(value), scale)
    whole, rest = scaled // scale, scaled % scale
    digits = 1
    while whole >= 10**digits:
        digits += 1
    for k in range(digits):
        out[n + digits - 1 - k] = 48 + whole % 10
        whole //= 10
    n += digits
    if decimals:
        out[n] = ord(".")
        n += 1
        for k in range(decimals):
            out[n + decimals - 1 - k] = 48 + rest % 10
            rest //= 10
        n += decimals
    return n


@njit
def _general(out, n, value):  # type: ignore[no-untyped-def]  # numba types it
    """The value with SIGNIFICANT digits, without zeros at the end, as "%.6g" has it from 0.0001 on."""
    decimals, size = SIGNIFICANT - 1, abs(value)
    while size >= 10 and decimals:
        size /= 10
        decimals -= 1
    while 0 < size < 1 and decimals < SIGNIFICANT + 3:
        size *= 10
        decimals += 1
    n = _fixed(out, n, value, decimals)
    if decimals:
        while out[n - 1] == 48:
            n -= 1
        if out[n - 1] == ord("."):
            n -= 1
    return n


@njit(LINES(KINDS, POINTS, NUMBERS, NUMBERS), cache=True, nogil=True)
def lines_of_moves(kind, to_mm, e, feedrate):  # type: ignore[no-untyped-def]  # numba types it
    """(bytes, where each line begins in them) of moves: where they end (n, 3), what they push, and how fast they are.

    kind  (n,) TRAVEL, LIFT, RETRACT, or what is laid (0 and more), whose feedrate stands in a line before it
    """
    out, starts, n = np.empty(LONGEST * kind.shape[0], np.uint8), np.empty(kind.shape[0], np.int64), 0
    for k in range(kind.shape[0]):
        starts[k] = n
        if kind[k] == LIFT:
            n = _general(out, _put(out, n, Z), to_mm[k, 2])
        elif kind[k] != RETRACT:
            n = _fixed(out, _put(out, n, XY), to_mm[k, 0], 3)
            out[n], out[n + 1] = ord(" "), ord("Y")
            n = _fixed(out, n + 2, to_mm[k, 1], 3)
        if kind[k] == RETRACT:
            n = _fixed(out, _put(out, n, E), e[k], 5)
        elif kind[k] >= 0:
            out[n], out[n + 1] = ord(" "), ord("E")
            n = _fixed(out, n + 2, e[k], 5)
        if kind[k] < 0:
            n = _fixed(out, _put(out, n, F), feedrate[k], 0)
        out[n] = ord("\n")
        n += 1
    return out[:n].copy(), starts
