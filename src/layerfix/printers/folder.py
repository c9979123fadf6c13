"""Where the shipped printers are, and what they are called."""

from __future__ import annotations

from functools import cache
from pathlib import Path


def printer_folder() -> Path:
    """Where the printers are: inside the installed package, or beside ``src`` in a checkout."""
    inside = Path(__file__).parents[1] / "sample_printers"
    return inside if inside.is_dir() else Path(__file__).parents[3] / "sample_printers"


@cache
def printer_names() -> tuple[str, ...]:
    """Names of the shipped printers, sorted."""
    return tuple(sorted(p.stem for p in printer_folder().glob("*.toml")))
