"""Values out of the text of files that may lie: numbers, JSON, ``key = value`` lines.

Every function takes time and memory in proportion to the text: no pattern that backtracks, no number of thousands of
digits, no nesting that the parser cannot follow.
"""

from __future__ import annotations

import json
import re
from typing import Any

LARGEST_NUMBER = 1e9  # of anything that a job says: lengths in mm or µm, volumes, prices
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_KEY = re.compile(r"\w+")
_SHOWN = 40  # characters of a value in a message


def number_above_0(text: str) -> float | None:
    """The number that a text is, if it is above 0 and below LARGEST_NUMBER; else None."""
    if len(text) > 400 or not _NUMBER.fullmatch(text.strip()):
        return None
    value = float(text)
    return value if 0 < value < LARGEST_NUMBER else None


def keyed_numbers(text: str) -> dict[str, float]:
    """``key value`` or ``key = value`` lines with a number above 0, by the key in lower case; later ones win."""
    found = {}
    for line in text.splitlines():
        parts = line.replace("=", " ", 1).split()
        if len(parts) != 2 or not _KEY.fullmatch(parts[0]):
            continue
        number = number_above_0(parts[1])
        if number is not None:
            found[parts[0].lower()] = number
    return found


def parse_json(text: str | bytes) -> Any:
    """A JSON value. Raises ValueError for what is none, and for nesting too deep to follow."""
    try:
        return json.loads(text)
    except RecursionError as problem:
        raise ValueError("it is nested too deeply") from problem


def abridged(text: str) -> str:
    """A value for a message: its beginning if it is long."""
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}… ({len(text)} characters)"


def machine_name(raw: bytes) -> str:
    """What a job calls its machine, of a field that may hold anything: up to the first NUL, if that is plain text."""
    text = raw.partition(b"\0")[0].decode("utf-8", "replace").strip()
    return text if text.isprintable() and len(text) <= 64 else ""
