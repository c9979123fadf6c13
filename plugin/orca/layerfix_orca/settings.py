"""The plugin's settings, and what stands in for those that are left at 0: the host's own."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from layerfix.errors import InputError

# What OrcaSlicer shows and lets people edit. 0 stands for "as the printer and the line widths say".
DEFAULTS: dict[str, Any] = {
    "min_feature_mm": 0.0,
    "first_layer_min_feature_mm": 0.0,
    "beads": 2.0,
    "mode": "add_only",
    "keep_gaps_mm": 0.0,
    "pixel_mm": 0.0,
}
MODES = ("add_only", "as_printed")


@dataclass(frozen=True)
class Settings:
    """Lengths in mm. `keep_gaps_mm` None: parts may grow together. `pixel_mm` None: the library's choice."""

    min_feature_mm: float
    first_layer_min_feature_mm: float
    mode: str
    keep_gaps_mm: float | None
    pixel_mm: float | None

    def feature_mm(self, first_layer: bool) -> float:
        """The minimum feature of a layer."""
        return self.first_layer_min_feature_mm if first_layer else self.min_feature_mm


def settings_of(saved: str, host_value: Callable[[str], str | None]) -> Settings:
    """Settings from what the host saved (JSON, "{}" at first) and its own options.

    The minimum feature is as many line widths as `beads` says: of the outer wall, and in the first layer of that.
    Raises InputError for names that are not known and for values that cannot be used.
    """
    given = json.loads(saved) if saved.strip() else {}
    if not isinstance(given, dict):
        raise InputError(f"layerfix's settings are {saved[:60]}; they are an object such as {json.dumps(DEFAULTS)}")
    unknown = sorted(set(given) - set(DEFAULTS))
    if unknown:
        raise InputError(f"layerfix has no setting '{unknown[0]}'; choose from {', '.join(DEFAULTS)}")
    config = {**DEFAULTS, **given}
    if config["mode"] not in MODES:
        raise InputError(f"mode '{config['mode']}' is not known; choose from {', '.join(MODES)}")
    numbers = {name: _number(name, value) for name, value in config.items() if name != "mode"}
    nozzle_mm = _first(host_value("nozzle_diameter"), 0.0) or 0.4
    width_mm = _width(host_value, ("outer_wall_line_width", "line_width"), nozzle_mm)
    first_mm = _width(host_value, ("initial_layer_line_width", "line_width"), nozzle_mm)
    every = numbers["min_feature_mm"] or numbers["beads"] * width_mm
    first = numbers["first_layer_min_feature_mm"] or numbers["min_feature_mm"] or numbers["beads"] * first_mm
    if not every > 0:
        raise InputError("beads is 0 and so is min_feature_mm: give one of them")
    return Settings(every, first, config["mode"], numbers["keep_gaps_mm"] or None, numbers["pixel_mm"] or None)


def _number(name: str, value: object) -> float:
    try:
        number = float(str(value))
    except ValueError:
        number = -1.0
    if not 0 <= number < 1000:
        raise InputError(f"layerfix's {name} is {value!r}; it is a number from 0 to 1000")
    return number


def _first(text: str | None, of_mm: float) -> float:
    """The first number of an option: "0.4", "0.4,0.6", or "105%" of something. 0 for none."""
    part = (text or "").replace(";", ",").split(",")[0].strip()
    try:
        return of_mm * float(part[:-1]) / 100 if part.endswith("%") else float(part)
    except ValueError:
        return 0.0


def _width(host_value: Callable[[str], str | None], names: tuple[str, ...], nozzle_mm: float) -> float:
    """The first of these line widths that is set; OrcaSlicer's own choice is 1.125 nozzles."""
    found = (_first(host_value(name), nozzle_mm) for name in names)
    return next((width for width in found if width > 0), 1.125 * nozzle_mm)
