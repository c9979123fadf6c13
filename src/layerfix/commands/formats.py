"""`layerfix formats`: every kind of file, what is read from it and written to it, and the options it takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from layerfix.commands.options import flag
from layerfix.formats.options import own_options
from layerfix.formats.table import Format, rows


def list_formats() -> list[dict[str, Any]]:
    """One entry a row of the table, those of other distributions too."""
    return [_described(row) for row in rows()]


def _described(row: Format) -> dict[str, Any]:
    return {
        "name": row.name,
        "suffixes": list(row.suffixes),
        "read": "layers" if row.layers else "a mesh" if row.mesh else "no",
        "rewritten": row.rewritten,
        "written_from": list(row.writers),
        "options": sorted({name for writer in row.writers.values() for name in own_options(writer.options)}),
    }


def lines_of(found: Sequence[dict[str, Any]]) -> list[str]:
    """The same for people, in columns."""
    table = [("format", "suffixes", "read as", "written from", "options")]
    for entry in found:
        written = [*(["jobs of its kind"] if entry["rewritten"] else []), *entry["written_from"]]
        own = [option for option in map(flag, entry["options"]) if option]
        suffixes = " ".join(suffix or "(a folder)" for suffix in entry["suffixes"])
        table.append((entry["name"], suffixes, entry["read"], ", ".join(written) or "–", " ".join(own)))
    widths = [max(len(line[k]) for line in table) for k in range(5)]
    return ["  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in table]
