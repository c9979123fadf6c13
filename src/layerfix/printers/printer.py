"""Printers: what one TOML file says about a machine. Those shipped live in ``sample_printers/``."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.printers.folder import printer_folder, printer_names
from layerfix.printers.index import Entry, find_printers
from layerfix.printers.keys import GCODE_PLACEHOLDERS, KEYS
from layerfix.printers.text import aligned, title_of, written
from layerfix.units import format_mm

_REQUIRED = ("maker", "model", "process", "layer_mm", "layer_range_mm", "min_feature_mm")
NEAREST = 4  # names that an error proposes, at most
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
    build_mm: tuple[float, float, float] | None  # of a service, which has machines of many sizes, None
    layer_mm: float
    min_feature_mm: float
    pixel_mm: tuple[float, float]
    layer_range_mm: tuple[float, float]
    first_layer_mm: float | None = None
    format: str = ""
    slicer_names: tuple[str, ...] = ()

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
    bed_origin_mm: tuple[float, float] | None = None
    round_bed: bool | None = None
    start_gcode: str | None = None  # with `GCODE_PLACEHOLDERS` for the temperatures, and no others
    end_gcode: str | None = None

    min_wall_mm: float | None = None
    min_free_wall_mm: float | None = None
    min_wire_mm: float | None = None
    min_free_wire_mm: float | None = None
    min_detail_mm: float | None = None
    min_engraving_mm: float | None = None
    min_gap_mm: float | None = None
    source: str | None = None

    @property
    def mode(self) -> Literal["as_printed", "add_only"]:
        """The correction mode that suits the process: a mask can draw sharp corners, a round tool cannot; a service
        prints what it is sent, so nothing is taken from that.
        """
        return "add_only" if self.process in ("resin", "service") else "as_printed"

    @property
    def room_mm(self) -> tuple[float, float, float]:
        """`build_mm`, or no limit."""
        return self.build_mm or (math.inf, math.inf, math.inf)

    @property
    def title(self) -> str:
        """Maker and model, but "Original Prusa SL1S", not "Prusa Research Original Prusa SL1S"."""
        return title_of(self.maker, self.model)


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
    near = _near_printers(str(name))
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise InputError(f"no printer '{name}': {hint}`layerfix printers` lists them, or give your own .toml file")


def _near_printers(name: str) -> list[str]:
    """Names of those that were probably meant: with all of the word in them, else spelled like it."""
    found = [entry.name for entry in find_printers(text=name.replace("-", " "))]
    return sorted(found, key=len)[:NEAREST] or _near(name.lower(), printer_names())


def description(printer: Printer) -> list[str]:
    """A line for each value that is known: key, value with its unit, meaning."""
    rows = [("name", printer.name, "that of its file")]
    for key, wanted in KEYS.items():
        value = getattr(printer, key)
        if (
            value is not None and value != () and (value != "" or printer.pixels)
        ):  # without a panel, nothing is mirrored
            listed = key.startswith("axis_") or wanted.count == 0
            between = " to " if key.endswith("_range_mm") else ", " if listed else " × "
            text = written(value, between)
            rows.append((key, f"{text} {wanted.unit}".rstrip(), wanted.meaning))
    return aligned(rows)


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
    needed = _REQUIRED if data.get("process") == "service" else (*_REQUIRED[:3], "build_mm", *_REQUIRED[3:])
    missing = [key for key in needed if key not in data]
    if missing:
        raise InputError(f"{path}: missing {', '.join(missing)}")
    values = {"build_mm": None} | {key: _value(path, key, value) for key, value in data.items()}
    if "pixel_mm" not in values:
        values["pixel_mm"] = _derived_pitch(path, values)
    _check_agreement(path, values)
    return Printer(name=path.stem, **values)


def _value(path: Path, key: str, value: Any) -> Any:
    """The value as its key wants it. Raises InputError for another kind, number or choice."""
    wanted = KEYS[key]
    kind, count = wanted.kind, wanted.count
    items = value if count != 1 and isinstance(value, list) else [value]
    if len(items) != (count or len(items)) or not all(_is(kind, v) for v in items):
        several = f"{count or 'some'} {_NAMES[kind].removeprefix('a ').removesuffix('s')}s in brackets"
        name = several if count != 1 else _NAMES[kind]
        raise InputError(f"{path}: {key} = {value!r}; it is {name}")
    if wanted.choices and value not in wanted.choices:
        raise InputError(f"{path}: {key} = '{value}'; choose from {', '.join(c or repr(c) for c in wanted.choices)}")
    if kind in (int, float) and not all(map(wanted.allows, items)):
        raise InputError(f"{path}: {key} = {value!r}; it must be {wanted.limits}")
    return tuple(map(kind, items)) if count != 1 else kind(value)


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
        check_gcode(f"{path}: {key}", values.get(key, ""))
    if values.get("format", ".") and not values.get("format", ".").startswith("."):
        raise InputError(f"{path}: format = '{values['format']}'; it is a suffix such as .sl1")
    for axis, pixels, pitch, size in zip(
        "xy", values.get("pixels", ()), values["pixel_mm"], values["build_mm"] or (), strict=False
    ):
        if abs(pixels * pitch / size - 1) > 0.005:
            raise InputError(
                f"{path}: pixels × pixel_mm is {pixels * pitch:.4g} mm along {axis}, build_mm says {size:.4g} mm"
            )


def check_gcode(where: str, text: str) -> None:
    """Raises InputError, beginning with `where`, for start or end code with other placeholders than ours."""
    # A brace without its partner too: nothing would fill it, and the printer would get it as it is.
    for found in re.findall(r"\{[^{}\r\n]*\}?|\}", text):
        if found not in GCODE_PLACEHOLDERS:
            raise InputError(f"{where} has {found}; it may have {', '.join(GCODE_PLACEHOLDERS)}")


def _derived_pitch(path: Path, values: dict[str, Any]) -> tuple[float, float]:
    """A panel's pitch is its size over its pixels; a nozzle's raster has eight pixels a nozzle width, that for a
    service sixteen a minimum feature.
    """
    if "pixels" in values and values["build_mm"]:
        (x_mm, y_mm, _), (x_px, y_px) = values["build_mm"], values["pixels"]
        return x_mm / x_px, y_mm / y_px
    if "nozzle_mm" in values:
        pitch = values["nozzle_mm"] / 8
        return pitch, pitch
    if values["process"] == "service":
        return values["min_feature_mm"] / 16, values["min_feature_mm"] / 16
    raise InputError(f"{path}: missing pixel_mm (or pixels, or nozzle_mm, from which it follows)")


def listing(printers: Iterable[Printer | Entry]) -> list[str]:
    """A line for each printer: name, maker and model, process, raster, minimum feature."""
    return aligned([(p.name, p.title, p.process, _raster(p), f"min {format_mm(p.min_feature_mm)}") for p in printers])


def _raster(printer: Printer | Entry) -> str:
    if printer.pixels:
        return f"{written(printer.pixels)} px"
    if printer.nozzle_mm:
        return f"{format_mm(printer.nozzle_mm)} nozzle"
    return f"{format_mm(printer.pixel_mm[0])} pitch"
