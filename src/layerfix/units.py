"""Text such as ``0.3mm`` or ``47um`` and millimetres. Inside layerfix every length is in mm."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from layerfix.errors import InputError

MM_PER_UNIT = {
    "nm": 1e-6,
    "um": 1e-3,
    "µm": 1e-3,
    "μm": 1e-3,
    "micron": 1e-3,
    "mm": 1.0,
    "cm": 10.0,
    "in": 25.4,
    "inch": 25.4,
    "ft": 304.8,
    "foot": 304.8,
    "m": 1000.0,
    "meter": 1000.0,
    "metre": 1000.0,
}
_LENGTH = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\W\d]*)\s*")

_SCALE = re.compile(r"\s*(\d{0,20}\.?\d{1,20}|\d{1,20}\.)\s*(?:(%)|:\s*(\d{0,20}\.?\d{1,20}))?\s*")


def mm_per_unit(name: str) -> float:
    """Millimetres in one `name` (``mm``, ``um``, ``in``, ``m`` …; plurals and capitals are understood)."""
    wanted = name.strip().lower()
    for unit in (wanted, wanted.removesuffix("s"), wanted.removesuffix("es"), wanted.removesuffix("imeter")):
        if unit in MM_PER_UNIT:
            return MM_PER_UNIT[unit]
    spelled_out = {
        "millimeter": 1.0,
        "millimetre": 1.0,
        "centimeter": 10.0,
        "centimetre": 10.0,
        "micrometer": 1e-3,
        "micrometre": 1e-3,
        "feet": 304.8,
    }
    if wanted.removesuffix("s") in spelled_out:
        return spelled_out[wanted.removesuffix("s")]
    raise InputError(f"unknown unit '{name}': use one of um, mm, cm, in, ft, m")


def parse_length_mm(text: str) -> float:
    """``"0.3mm"`` → 0.3, ``"47um"`` → 0.047, ``"0.1in"`` → 2.54. A length has a unit and is above 0.

    Raises InputError for text without a unit, an unknown unit, and values that are not above 0.
    """
    match = _LENGTH.fullmatch(text)
    if not match:
        raise InputError(f"'{text}' is not a length: write a number and a unit, such as 0.3mm or 47um")
    number, unit = match.groups()
    if not unit:
        raise InputError(f"'{text}' has no unit: write {text.strip()}mm or {text.strip()}um")
    value_mm = float(number) * mm_per_unit(unit)
    if not (math.isfinite(value_mm) and value_mm > 0):
        raise InputError(f"'{text}' is not a usable length: it must be above 0")
    return value_mm


def parse_pitch_mm(text: str) -> tuple[float, float]:
    """Read a pitch: one length, or two with an x between them, as ``19umx24um``. Raises InputError for others."""
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) > 2:
        raise InputError(f"'{text}' is not a pitch: write 50um, or 19umx24um")
    sizes = [parse_length_mm(part) for part in parts]
    return sizes[0], sizes[-1]


def parse_scale(text: str) -> float:
    """``"1:87"`` → 1/87, ``"50%"`` → 0.5, ``"2"`` → 2.0: how many times as large a part becomes.

    Raises InputError for anything else and for scales that are not above 0.
    """
    match = _SCALE.fullmatch(text)
    if not match:
        raise InputError(f"'{text}' is not a scale: write 1:87, 50% or a number such as 2 or 0.5")
    number, per_cent, over = match.groups()
    share = float(number) * (0.01 if per_cent else 1.0)
    value = share / float(over) if over and float(over) else share if over is None else math.inf
    if not 0 < value < math.inf:
        raise InputError(f"'{text}' is not a usable scale: it must be above 0")
    return value


def format_mm(value_mm: float) -> str:
    """A length as people write it: ``0.3 mm``, ``47 µm`` below a tenth of a millimetre."""
    if value_mm and abs(value_mm) < 0.1:
        return f"{value_mm * 1000:.4g} µm"
    return f"{value_mm:.4g} mm"


def counted(number: int, thing: str) -> str:
    """``1 layer``, ``3 layers``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def one_or_two(value: float | tuple[float, float], what: str, unit: str) -> tuple[float, float]:
    """(x, y) of something given as one number or as two. Raises InputError unless both are above 0."""
    numbers = tuple(value) if isinstance(value, Iterable) else (value, value)
    try:
        x, y = (float(n) for n in numbers)
    except (TypeError, ValueError) as problem:
        raise InputError(f"{what} {value} {unit}: it is one number, or two") from problem
    if not (0 < x < math.inf and 0 < y < math.inf):
        raise InputError(f"{what} {value} {unit}: it must be above 0")
    return x, y
