"""Printers: what one TOML file says about a machine. Those shipped live in ``sample_printers/``."""

from __future__ import annotations

import difflib
import sys
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.units import format_mm

PROCESSES = ("resin", "fdm", "powder")
MIRRORS = ("", "x", "y", "xy")
GCODE_FLAVORS = ("marlin", "marlin2", "klipper", "reprap")


class Key(NamedTuple):
    """What a value in a printer's file must be, and means."""

    kind: type
    count: int  # how many numbers in brackets; 1 is a plain value
    least: float | None  # None: above 0, for there is no length of 0
    unit: str
    meaning: str
    choices: tuple[str, ...] = ()
    most: float = sys.float_info.max  # neither inf nor nan is a measure


# fmt: off
KEYS: dict[str, Key] = {
    # every process       kind, count, least, unit, meaning
    "maker":              Key(str,   1, None, "",   "as on its plate"),
    "model":              Key(str,   1, None, "",   "as on its plate"),
    "process":            Key(str,   1, None, "",   "what draws a layer: a panel, a nozzle, a beam", PROCESSES),
    "build_mm":           Key(float, 3, None, "mm", "(x, y, z) it can print"),
    "layer_mm":           Key(float, 1, None, "mm", "usual layer height"),
    "first_layer_mm":     Key(float, 1, None, "mm", "height of the first layer where it differs"),
    "layer_range_mm":     Key(float, 2, None, "mm", "lowest and highest layer"),
    "min_feature_mm":     Key(float, 1, None, "mm", "default minimum printable feature"),
    "pixel_mm":           Key(float, 2, None, "mm", "(x, y) pitch of the layer image"),
    "format":             Key(str,   1, None, "",   "suffix of its own job files"),
    # resin
    "pixels":             Key(int,   2, None, "px", "(columns, rows) of the layer image in a job file"),
    "mirror":             Key(str,   1, None, "",   "axes the panel shows mirrored", MIRRORS),
    "antialias_bits":     Key(int,   1, 1,    "",   "bits of grey that job file and panel hold", most=8),
    "exposure_s":         Key(float, 1, None, "s",  "light on, each layer"),
    "bottom_exposure_s":  Key(float, 1, None, "s",  "light on, each bottom layer"),
    "bottom_layers":      Key(int,   1, 0,    "",   "how many layers are bottom layers"),
    "transition_layers":  Key(int,   1, 0,    "",   "layers from bottom exposure to the usual one"),
    "light_off_s":        Key(float, 1, 0,    "s",  "wait before the light, each layer"),
    "lift_mm":            Key(float, 1, 0,    "mm", "lift after a layer"),
    "lift_mm_min":        Key(float, 1, None, "mm/min", "its speed"),
    "bottom_lift_mm":     Key(float, 1, 0,    "mm", "lift after a bottom layer"),
    "bottom_lift_mm_min": Key(float, 1, None, "mm/min", "its speed"),
    "retract_mm_min":     Key(float, 1, None, "mm/min", "speed of the way back"),
    "light_pwm":          Key(int,   1, 0,    "of 255", "brightness of the light", most=255),
    "bottom_light_pwm":   Key(int,   1, 0,    "of 255", "brightness for bottom layers", most=255),
    # fdm
    "nozzle_mm":          Key(float, 1, None, "mm", "bore of the nozzle"),
    "filament_mm":        Key(float, 1, None, "mm", "diameter of the filament"),
    "extrusion_width_mm": Key(float, 1, None, "mm", "usual bead of an outer wall"),
    "first_layer_width_mm":       Key(float, 1, None, "mm", "bead of the first layer"),
    "width_range_mm":             Key(float, 2, None, "mm", "narrowest and widest bead"),
    "max_volumetric_speed_mm3_s": Key(float, 1, None, "mm³/s", "most it can melt"),
    "gcode_flavor":       Key(str,   1, None, "",   "dialect of its G-code", GCODE_FLAVORS),
    "relative_extrusion": Key(bool,  1, None, "",   "E counts from the last move (M83)"),
}
# fmt: on
_REQUIRED = ("maker", "model", "process", "build_mm", "layer_mm", "layer_range_mm", "min_feature_mm")
_NAMES = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}


@dataclass(frozen=True)
class Printer:
    """One machine. `KEYS` tells what each value means; the names end in the units, and None is "not known".

    x runs along the columns and y down the rows of the layer image in the machine's own job files: `pixels` is
    (columns, rows), and `build_mm`, `pixel_mm` and `mirror` follow it, also where the panel stands on end (a
    Prusa SL1 is 1440 × 2560 px and 68 × 121 mm). `name` is that of the file, without ``.toml``.
    """

    name: str
    maker: str
    model: str
    process: str
    build_mm: tuple[float, float, float]
    layer_mm: float
    min_feature_mm: float
    pixel_mm: tuple[float, float]
    layer_range_mm: tuple[float, float]
    first_layer_mm: float | None = None
    format: str = ""

    pixels: tuple[int, int] | None = None
    mirror: str = ""
    antialias_bits: int | None = None
    exposure_s: float | None = None
    bottom_exposure_s: float | None = None
    bottom_layers: int | None = None
    transition_layers: int | None = None
    light_off_s: float | None = None
    lift_mm: float | None = None
    lift_mm_min: float | None = None
    bottom_lift_mm: float | None = None
    bottom_lift_mm_min: float | None = None
    retract_mm_min: float | None = None
    light_pwm: int | None = None
    bottom_light_pwm: int | None = None

    nozzle_mm: float | None = None
    filament_mm: float | None = None
    extrusion_width_mm: float | None = None
    first_layer_width_mm: float | None = None
    width_range_mm: tuple[float, float] | None = None
    max_volumetric_speed_mm3_s: float | None = None
    gcode_flavor: str | None = None
    relative_extrusion: bool | None = None

    @property
    def mode(self) -> str:
        """The correction mode that suits the process: a mask can draw sharp corners, a round tool cannot."""
        return "add_only" if self.process == "resin" else "as_printed"

    @property
    def title(self) -> str:
        """Maker and model, but "Original Prusa SL1S", not "Prusa Research Original Prusa SL1S"."""
        return self.model if self.maker.split()[0] in self.model else f"{self.maker} {self.model}"
