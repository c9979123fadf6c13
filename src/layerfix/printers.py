"""Printers: what one TOML file says about a machine. Those shipped live in ``sample_printers/``."""

from __future__ import annotations

import difflib
import re
import sys
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.units import format_mm

PROCESSES = ("resin", "fdm", "powder")
MIRRORS = ("", "x", "y", "xy")
GCODE_FLAVORS = ("marlin", "marlin2", "klipper", "reprap", "griffin")
GCODE_PLACEHOLDERS = ("{nozzle_c}", "{bed_c}", "{first_layer_nozzle_c}", "{first_layer_bed_c}")


@dataclass(frozen=True)
class Key:
    """What a value in a printer's file must be, and means."""

    kind: type
    count: int  # how many in brackets; 1 is a plain value
    least: float | None  # None: above 0, for there is no length of 0
    unit: str
    meaning: str
    choices: tuple[str, ...] = ()
    most: float = sys.float_info.max  # neither inf nor nan is a measure

    def allows(self, number: float) -> bool:
        return (number > 0 if self.least is None else number >= self.least) and number <= self.most

    @property
    def limits(self) -> str:
        if self.least is None:
            return "above 0"
        return f"{self.least:g} or more" if self.most == sys.float_info.max else f"{self.least:g} to {self.most:g}"


# fmt: off
KEYS: dict[str, Key] = {
    # every process             kind, how many, least, unit, meaning
    "maker":                      Key(str,   1, None, "",       "as on its plate"),
    "model":                      Key(str,   1, None, "",       "as on its plate"),
    "process":                    Key(str,   1, None, "",       "what draws a layer: panel, nozzle, beam", PROCESSES),
    "build_mm":                   Key(float, 3, None, "mm",     "(x, y, z) it can print"),
    "layer_mm":                   Key(float, 1, None, "mm",     "usual layer height"),
    "first_layer_mm":             Key(float, 1, None, "mm",     "of the first layer, if it differs"),
    "layer_range_mm":             Key(float, 2, None, "mm",     "lowest and highest layer"),
    "min_feature_mm":             Key(float, 1, None, "mm",     "default minimum printable feature"),
    "pixel_mm":                   Key(float, 2, None, "mm",     "(x, y) pitch of the layer image"),
    "format":                     Key(str,   1, None, "",       "suffix of its own job files"),
    # resin
    "pixels":                     Key(int,   2, None, "px",     "(columns, rows) of the layer image in a job file"),
    "mirror":                     Key(str,   1, None, "",       "axes the panel shows mirrored", MIRRORS),
    "antialias_bits":             Key(int,   1, 1,    "",       "bits of grey that job file and panel hold", most=8),
    "exposure_s":                 Key(float, 1, None, "s",      "light on, each layer"),
    "bottom_exposure_s":          Key(float, 1, None, "s",      "light on, each bottom layer"),
    "bottom_layers":              Key(int,   1, 0,    "",       "how many layers are bottom layers"),
    "transition_layers":          Key(int,   1, 0,    "",       "layers from bottom exposure to the usual one"),
    "light_off_s":                Key(float, 1, 0,    "s",      "wait before the light, each layer"),
    "lift_mm":                    Key(float, 1, 0,    "mm",     "lift after a layer"),
    "lift_mm_min":                Key(float, 1, None, "mm/min", "its speed"),
    "bottom_lift_mm":             Key(float, 1, 0,    "mm",     "lift after a bottom layer"),
    "bottom_lift_mm_min":         Key(float, 1, None, "mm/min", "its speed"),
    "retract_mm_min":             Key(float, 1, None, "mm/min", "speed of the way back"),
    "light_pwm":                  Key(int,   1, 0,    "of 255", "brightness of the light", most=255),
    "bottom_light_pwm":           Key(int,   1, 0,    "of 255", "brightness for bottom layers", most=255),
    # fdm
    "nozzle_mm":                  Key(float, 1, None, "mm",     "bore of the nozzle"),
    "filament_mm":                Key(float, 1, None, "mm",     "diameter of the filament"),
    "extrusion_width_mm":         Key(float, 1, None, "mm",     "usual bead of an outer wall"),
    "first_layer_width_mm":       Key(float, 1, None, "mm",     "bead of the first layer"),
    "width_range_mm":             Key(float, 2, None, "mm",     "narrowest and widest bead"),
    "max_volumetric_speed_mm3_s": Key(float, 1, None, "mm³/s",  "most it can melt"),
    "gcode_flavor":               Key(str,   1, None, "",       "dialect of its G-code", GCODE_FLAVORS),
    "relative_extrusion":         Key(bool,  1, None, "",       "E counts from the last move (M83)"),
    "external_perimeter_mm_s":    Key(float, 1, None, "mm/s",   "speed of the outer walls"),
    "perimeter_mm_s":             Key(float, 1, None, "mm/s",   "of the walls inside them"),
    "infill_mm_s":                Key(float, 1, None, "mm/s",   "of sparse infill"),
    "solid_infill_mm_s":          Key(float, 1, None, "mm/s",   "of solid infill"),
    "top_infill_mm_s":            Key(float, 1, None, "mm/s",   "of the solid infill that shows on top"),
    "gap_fill_mm_s":              Key(float, 1, None, "mm/s",   "of beads that fill gaps between walls"),
    "first_layer_mm_s":           Key(float, 1, None, "mm/s",   "of all beads of the first layer"),
    "travel_mm_s":                Key(float, 1, None, "mm/s",   "of moves that print nothing"),
    "bridge_mm_s":                Key(float, 1, None, "mm/s",   "of beads laid over air"),
    "bridge_flow":                Key(float, 1, None, "",       "their material, as a share of the usual", most=2),
    "acceleration_mm_s2":         Key(float, 1, None, "mm/s²",  "usual acceleration"),
    "travel_acceleration_mm_s2":  Key(float, 1, None, "mm/s²",  "of travels, if it differs"),
    "axis_mm_s":                  Key(float, 4, None, "mm/s",   "fastest X, Y, Z, E"),
    "axis_mm_s2":                 Key(float, 4, None, "mm/s²",  "most of X, Y, Z, E"),
    "axis_jerk_mm_s":             Key(float, 4, None, "mm/s",   "what they may change at once"),
    "junction_deviation_mm":      Key(float, 1, None, "mm",     "of corners, instead of jerk"),
    "retract_mm":                 Key(float, 1, 0,    "mm",     "filament drawn back before a travel"),
    "retract_mm_s":               Key(float, 1, None, "mm/s",   "its speed"),
    "retract_lift_mm":            Key(float, 1, 0,    "mm",     "lift of the nozzle meanwhile"),
    "retract_before_travel_mm":   Key(float, 1, 0,    "mm",     "shortest travel with a retraction"),
    "nozzle_c":                   Key(float, 1, 0,    "°C",     "heat of the nozzle", most=500),
    "first_layer_nozzle_c":       Key(float, 1, 0,    "°C",     "the same for the first layer", most=500),
    "bed_c":                      Key(float, 1, 0,    "°C",     "heat of the bed", most=200),
    "first_layer_bed_c":          Key(float, 1, 0,    "°C",     "the same for the first layer", most=200),
    "fan_percent":                Key(float, 1, 0,    "%",      "part cooling from the second layer on", most=100),
    "start_gcode":                Key(str,   1, None, "",       "what comes before the first layer"),
    "end_gcode":                  Key(str,   1, None, "",       "what comes after the last layer"),
}
# fmt: on
_REQUIRED = ("maker", "model", "process", "build_mm", "layer_mm", "layer_range_mm", "min_feature_mm")
_NAMES = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}


@dataclass(frozen=True)
class Printer:
    """One machine. `KEYS` tells what each value means; the names end in the units, and None is "not known".

    x runs along the columns and y along the rows of the layer image in the machine's own job files: `pixels` is
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
    external_perimeter_mm_s: float | None = None
    perimeter_mm_s: float | None = None
    infill_mm_s: float | None = None
    solid_infill_mm_s: float | None = None
    top_infill_mm_s: float | None = None
    gap_fill_mm_s: float | None = None
    first_layer_mm_s: float | None = None
    travel_mm_s: float | None = None
    bridge_mm_s: float | None = None
    bridge_flow: float | None = None
    acceleration_mm_s2: float | None = None
    travel_acceleration_mm_s2: float | None = None
    axis_mm_s: tuple[float, float, float, float] | None = None
    axis_mm_s2: tuple[float, float, float, float] | None = None
    axis_jerk_mm_s: tuple[float, float, float, float] | None = None
    junction_deviation_mm: float | None = None
    retract_mm: float | None = None
    retract_mm_s: float | None = None
    retract_lift_mm: float | None = None
    retract_before_travel_mm: float | None = None
    nozzle_c: float | None = None
    first_layer_nozzle_c: float | None = None
    bed_c: float | None = None
    first_layer_bed_c: float | None = None
    fan_percent: float | None = None
    start_gcode: str | None = None  # with `GCODE_PLACEHOLDERS` for the temperatures, and no others
    end_gcode: str | None = None

    @property
    def mode(self) -> Literal["as_printed", "add_only"]:
        """The correction mode that suits the process: a mask can draw sharp corners, a round tool cannot."""
        return "add_only" if self.process == "resin" else "as_printed"

    @property
    def title(self) -> str:
        """Maker and model, but "Original Prusa SL1S", not "Prusa Research Original Prusa SL1S"."""
        return self.model if self.maker.partition(" ")[0] in self.model else f"{self.maker} {self.model}"


def printer_folder() -> Path:
    """Where the printers are: inside the installed package, or beside ``src`` in a checkout."""
    inside = Path(__file__).parent / "sample_printers"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "sample_printers"


@cache
def printer_names() -> tuple[str, ...]:
    """Names of the shipped printers, sorted."""
    return tuple(sorted(p.stem for p in printer_folder().glob("*.toml")))


def find_printers(process: str | None = None, text: str = "") -> list[Printer]:
    """The shipped printers of one process (None: of all) whose maker, model or name has every word of `text`."""
    words = text.lower().split()
    return [
        printer
        for printer in map(load_printer, printer_names())
        if process in (None, printer.process)
        and all(word in f"{printer.name} {printer.maker} {printer.model}".lower() for word in words)
    ]


def load_printer(name: str | Path) -> Printer:
    """A shipped printer by name (``"prusa-sl1s"``), or one's own by path (``"my.toml"``).

    Raises InputError for an unknown name (naming the nearest), a missing file, and for a wrong key or value.
    """
    if str(name) in printer_names():
        return _parse(printer_folder() / f"{name}.toml")
    path = Path(name)
    if path.suffix.lower() == ".toml":
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        return _parse(path)
    near = _near(str(name).lower(), printer_names())
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise InputError(f"no printer '{name}': {hint}`layerfix printers` lists them, or give your own .toml file")


def listing(printers: Iterable[Printer]) -> list[str]:
    """A line for each printer: name, maker and model, process, raster, minimum feature."""
    rows = [(p.name, p.title, p.process, _raster(p), f"min {format_mm(p.min_feature_mm)}") for p in printers]
    return _aligned(rows)


def description(printer: Printer) -> list[str]:
    """A line for each value that is known: key, value with its unit, meaning."""
    rows = [("name", printer.name, "that of its file")]
    for key, wanted in KEYS.items():
        value = getattr(printer, key)
        if value is not None and (value != "" or printer.pixels):  # without a panel, nothing is mirrored
            between = " to " if key.endswith("_range_mm") else ", " if key.startswith("axis_") else " × "
            text = _written(value, between)
            rows.append((key, f"{text} {wanted.unit}".rstrip(), wanted.meaning))
    return _aligned(rows)


def _raster(printer: Printer) -> str:
    if printer.pixels:
        return f"{_written(printer.pixels)} px"
    if printer.nozzle_mm:
        return f"{format_mm(printer.nozzle_mm)} nozzle"
    return f"{format_mm(printer.pixel_mm[0])} pitch"


def _written(value: Any, between: str = " × ") -> str:
    if isinstance(value, tuple):
        return between.join(map(_written, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.7g}"
    lines = str(value).strip().splitlines() or ["none"]
    return lines[0] if len(lines) == 1 else f"{lines[0]} … ({len(lines)} lines)"  # G-code would break the columns


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def _near(word: str, known: Iterable[str]) -> list[str]:
    """Those that contain the word, else those spelled like it."""
    known = list(known)
    holding = [name for name in known if word and word in name]
    return holding[:4] or difflib.get_close_matches(word, known, n=3, cutoff=0.4)


def _parse(path: Path) -> Printer:
    try:
        with reading(path):
            text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as problem:  # TOML, UTF-8, a number without end, brackets without end
        raise InputError(f"{path}: not a valid TOML file ({problem})") from problem
    for key in data:
        if key not in KEYS:
            near = _near(key, KEYS)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(KEYS)}"
            raise InputError(f"{path}: unknown key '{key}': {hint}")
    missing = [key for key in _REQUIRED if key not in data]
    if missing:
        raise InputError(f"{path}: missing {', '.join(missing)}")
    values = {key: _value(path, key, value) for key, value in data.items()}
    if "pixel_mm" not in values:
        values["pixel_mm"] = _derived_pitch(path, values)
    _check_agreement(path, values)
    return Printer(name=path.stem, **values)


def _value(path: Path, key: str, value: Any) -> Any:
    """The value as its key wants it. Raises InputError for another kind, number or choice."""
    wanted = KEYS[key]
    kind, count = wanted.kind, wanted.count
    items = value if count > 1 and isinstance(value, list) else [value]
    if len(items) != count or not all(_is(kind, v) for v in items):
        name = f"{count} {_NAMES[kind].removeprefix('a ')}s in brackets" if count > 1 else _NAMES[kind]
        raise InputError(f"{path}: {key} = {value!r}; it is {name}")
    if wanted.choices and value not in wanted.choices:
        raise InputError(f"{path}: {key} = '{value}'; choose from {', '.join(c or repr(c) for c in wanted.choices)}")
    if kind in (int, float) and not all(map(wanted.allows, items)):
        raise InputError(f"{path}: {key} = {value!r}; it must be {wanted.limits}")
    return tuple(map(kind, items)) if count > 1 else kind(value)


def _is(kind: type, value: Any) -> bool:
    """Whether a TOML value is of a kind: whole numbers are numbers, true and false are not."""
    return isinstance(value, (int, float) if kind is float else kind) and isinstance(value, bool) == (kind is bool)


def _check_agreement(path: Path, values: dict[str, Any]) -> None:
    """Raises InputError for values that are each well formed but cannot be, alone or together."""
    for key in ("layer_range_mm", "width_range_mm"):
        low, high = values.get(key, (0, 0))
        if low > high:
            raise InputError(f"{path}: {key} = [{low}, {high}]; the lowest comes first")
    for key in ("start_gcode", "end_gcode"):
        # A brace without its partner too: nothing would fill it, and the printer would get it as it is.
        for found in re.findall(r"\{[^{}\r\n]*\}?|\}", values.get(key, "")):
            if found not in GCODE_PLACEHOLDERS:
                raise InputError(f"{path}: {key} has {found}; it may have {', '.join(GCODE_PLACEHOLDERS)}")
    if values.get("format", ".") and not values.get("format", ".").startswith("."):
        raise InputError(f"{path}: format = '{values['format']}'; it is a suffix such as .sl1")
    for axis, pixels, pitch, size in zip(
        "xy", values.get("pixels", ()), values["pixel_mm"], values["build_mm"], strict=False
    ):
        if abs(pixels * pitch / size - 1) > 0.005:
            raise InputError(
                f"{path}: pixels × pixel_mm is {pixels * pitch:.4g} mm along {axis}, build_mm says {size:.4g} mm"
            )


def _derived_pitch(path: Path, values: dict[str, Any]) -> tuple[float, float]:
    """A panel's pitch is its size over its pixels; a nozzle's raster has eight pixels a nozzle width."""
    if "pixels" in values:
        (x_mm, y_mm, _), (x_px, y_px) = values["build_mm"], values["pixels"]
        return x_mm / x_px, y_mm / y_px
    if "nozzle_mm" in values:
        pitch = values["nozzle_mm"] / 8
        return pitch, pitch
    raise InputError(f"{path}: missing pixel_mm (or pixels, or nozzle_mm, from which it follows)")
