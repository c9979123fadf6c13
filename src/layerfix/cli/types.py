"""Values as people write them on the command line: lengths with units, pitches, ranges, shares."""

from __future__ import annotations

from typing import Any

import click

from layerfix.errors import InputError
from layerfix.units import parse_length_mm, parse_pitch_mm, parse_scale


class Length(click.ParamType[float]):
    """A length with a unit, in mm."""

    name = "length"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            return parse_length_mm(value)
        except InputError as problem:
            self.fail(str(problem), param, ctx)


class Area(click.ParamType[float]):
    """A unit of length and a 2 after the number, in mm²: ``0.01mm2``."""

    name = "area"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value).strip()
        length = text.removesuffix("²").removesuffix("2")
        if isinstance(value, float):
            return value
        if length == text or not length[-1:].isalpha():
            self.fail(f"'{value}' is not an area: write a number and a unit, such as 0.01mm2", param, ctx)
        try:
            number = parse_length_mm(length)
            return number * parse_length_mm(f"1{length.lstrip('0123456789.+-eE ')}")
        except InputError:
            self.fail(f"'{value}' is not an area: write a number and a unit, such as 0.01mm2", param, ctx)


class Pitch(click.ParamType[tuple[float, float]]):
    """One length, or two with an x between them: ``19umx24um``."""

    name = "pitch"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        try:
            return parse_pitch_mm(str(value))
        except InputError as problem:
            self.fail(str(problem), param, ctx)


class Range(click.ParamType[tuple[int, int]]):
    """Layers, counted from 0: ``12`` is one, ``10:20`` are ten."""

    name = "range"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        first, colon, stop = str(value).partition(":")
        try:
            found = int(first or 0), (int(stop) if stop else 1 << 30) if colon else int(first) + 1
        except ValueError:
            self.fail(f"'{value}' is not a range of layers: write 12, or 10:20", param, ctx)
        if not 0 <= found[0] < found[1]:
            self.fail(f"'{value}' holds no layer: they are counted from 0, and 10:20 ends before 20", param, ctx)
        return found


class Percent(click.ParamType[float]):
    """``20%``, ``20`` or ``0.2``, as 0.2."""

    name = "percent"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value).strip()
        try:
            share = float(text.removesuffix("%"))
            share /= 100 if text.endswith("%") or share > 1 else 1
        except ValueError:
            self.fail(f"'{value}' is not a share: write 20%, or 0.2", param, ctx)
        if not 0 <= share <= 1:
            self.fail(f"'{value}' is not between 0 % and 100 %: write 20%, or 0.2", param, ctx)
        return share


class Scale(click.ParamType[float]):
    """``1:87``, ``50%`` or ``2``: how many times as large."""

    name = "scale"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            return parse_scale(str(value))
        except InputError as problem:
            self.fail(str(problem), param, ctx)


class Weights(click.ParamType[dict[str, float]]):
    """``added=1,support=0.2`` as numbers by name; which names there are is known where they are used."""

    name = "weights"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> dict[str, float]:
        found: dict[str, float] = {}
        for part in str(value).split(","):
            name, _, number = part.partition("=")
            try:
                found[name.strip()] = float(number)
            except ValueError:
                self.fail(f"'{part}' is not a weight: write added=1,support=0.2", param, ctx)
        return found
