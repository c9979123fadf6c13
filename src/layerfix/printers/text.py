"""Values and tables as people read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def written(value: Any, between: str = " × ") -> str:
    """A value as people read it: several with `between`, G-code by its first line."""
    if isinstance(value, tuple):
        return between.join(map(written, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.7g}"
    lines = str(value).strip().splitlines() or ["none"]
    return lines[0] if len(lines) == 1 else f"{lines[0]} … ({len(lines)} lines)"  # G-code would break the columns


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines whose cells begin at the same places."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def title_of(maker: str, model: str) -> str:
    """Maker and model in a few words, without the maker's name twice."""
    return model if maker.partition(" ")[0] in model else f"{maker} {model}"
