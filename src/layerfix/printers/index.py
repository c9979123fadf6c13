"""The shipped printers in one small file, so that hundreds are listed and searched without reading each of theirs.

``sample_printers/index.json`` is made of the TOML files by ``python -m tests.printer_files``; a test compares them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache
from typing import Any

from layerfix.errors import InputError
from layerfix.printers.folder import printer_folder
from layerfix.printers.text import title_of

INDEX = "index.json"
# Words alike by at least so much (twice the letters in common over all letters) are taken for each other:
# "satrun" and "saturn" 0.83, "foton" and "photon" 0.73, "mars" and "max" 0.57.
ALIKE = 0.7


@dataclass(frozen=True)
class Entry:
    """What is known of a shipped printer without reading its file; the names are those of `Printer`."""

    name: str
    maker: str
    model: str
    process: str
    min_feature_mm: float
    pixel_mm: tuple[float, float]
    build_mm: tuple[float, float, float] | None = None
    pixels: tuple[int, int] | None = None
    nozzle_mm: float | None = None
    format: str = ""
    slicer_names: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """As `Printer.title`."""
        return title_of(self.maker, self.model)


@cache
def entries() -> tuple[Entry, ...]:
    """Every shipped printer, by name. Raises InputError if the index is missing or broken."""
    path = printer_folder() / INDEX
    try:
        found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
        return tuple(_entry(row) for row in found)
    except (OSError, ValueError, TypeError, AttributeError) as problem:
        raise InputError(
            f"{path}: the index of printers cannot be read ({problem}); install layerfix anew"
        ) from problem


def _entry(row: dict[str, Any]) -> Entry:
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}
    return Entry(**values)


def find_printers(process: str | None = None, text: str = "") -> list[Entry]:
    """The shipped printers of one process (None: of all) whose maker, model or name has every word of `text`; if none
    has, those with words spelled like them, the likest first. Hyphens and spaces make no difference ("ender3").
    """
    chosen = [entry for entry in entries() if process in (None, entry.process)]
    words = text.lower().split()
    exact = [entry for entry in chosen if all(_holds(entry, word) for word in words)]
    return exact or _spelled_like(chosen, words)


def _holds(entry: Entry, word: str) -> bool:
    text = f"{entry.name} {entry.maker} {entry.model}".lower()
    return word in text or (squeezed(word) != "" and squeezed(word) in squeezed(text))


def squeezed(text: str) -> str:
    """Its letters, digits, points and pluses alone, small."""
    return re.sub(r"[^a-z0-9.+]", "", text.lower())


def tokens(text: str) -> set[str]:
    """Its words; what has letters and digits is one ("mk4s"), a hyphen parts."""
    return set(re.findall(r"[a-z0-9.+]+", text.lower()))


def _spelled_like(chosen: Iterable[Entry], words: list[str]) -> list[Entry]:
    likeness = cache(_likeness)
    found = []
    for entry in chosen:
        known = tokens(f"{entry.name} {entry.maker} {entry.model}")
        best = [max((likeness(word, token) for token in known), default=0.0) for word in words]
        if best and min(best) >= ALIKE:
            found.append((-sum(best), entry.name, entry))
    return [entry for _, _, entry in sorted(found, key=lambda one: one[:2])]


def _likeness(word: str, token: str) -> float:
    """0 to 1; 0 for words with different numbers, for a Mars 3 is no Mars 4."""
    if re.sub(r"[^0-9.]", "", word) != re.sub(r"[^0-9.]", "", token):
        return 0.0
    matcher = SequenceMatcher(None, word, token, autojunk=False)
    return matcher.ratio() if matcher.real_quick_ratio() >= ALIKE else 0.0
