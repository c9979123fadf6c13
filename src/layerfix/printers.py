"""Printers: what one TOML file says about a machine. Those shipped live in ``sample_printers/``."""

from __future__ import annotations

import difflib
import math
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from layerfix.errors import InputError
from layerfix.files import reading

PROCESSES = ("resin", "fdm", "powder")
MIRRORS = ("", "x", "y", "xy")


@dataclass(frozen=True)
class Printer:
    """One machine.

    name            the file's name without ``.toml``
    maker, model    as on its plate
    process         "resin" (a panel or projector draws the layer), "fdm" (a nozzle), "powder" (a beam)
    build_mm        (x, y, z) it can print
    layer_mm        usual layer height; layer_range_mm the (lowest, highest) it takes
    min_feature_mm  default minimum printable feature
    pixel_mm        (x, y) pitch of the panel, or of the raster that stands for the layer
    pixels          (x, y) of the panel; None where there is no panel
    mirror          axes the panel shows mirrored: "", "x", "y" or "xy"
    format          suffix of its native job file
    nozzle_mm       FDM only
    first_layer_mm  height of the first layer where it differs
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
    pixels: tuple[int, int] | None = None
    mirror: str = ""
    format: str = ""
    nozzle_mm: float | None = None
    first_layer_mm: float | None = None

    @property
    def mode(self) -> str:
        """The correction mode that suits the process: a mask can draw sharp corners, a round tool cannot."""
        return "add_only" if self.process == "resin" else "as_printed"


# key: (type of the value, how many of them; 1 is a plain value)
_KEYS: dict[str, tuple[type, int]] = {
    "maker": (str, 1),
    "model": (str, 1),
    "process": (str, 1),
    "build_mm": (float, 3),
    "layer_mm": (float, 1),
    "layer_range_mm": (float, 2),
    "first_layer_mm": (float, 1),
    "min_feature_mm": (float, 1),
    "pixel_mm": (float, 2),
    "pixels": (int, 2),
    "mirror": (str, 1),
    "format": (str, 1),
    "nozzle_mm": (float, 1),
}
_REQUIRED = ("maker", "model", "process", "build_mm", "layer_mm", "layer_range_mm", "min_feature_mm")


def printer_folder() -> Path:
    """Where the printers are: inside the installed package, or beside ``src`` in a checkout."""
    inside = Path(__file__).parent / "sample_printers"
    return inside if inside.is_dir() else Path(__file__).parents[2] / "sample_printers"


@cache
def printer_names() -> tuple[str, ...]:
    """Names of the shipped printers, sorted."""
    return tuple(sorted(p.stem for p in printer_folder().glob("*.toml")))


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
    near = difflib.get_close_matches(str(name).lower(), printer_names(), n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise InputError(f"no printer '{name}': {hint}`layerfix printers` lists them, or give your own .toml file")


def _parse(path: Path) -> Printer:
    try:
        with reading(path):
            text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise InputError(f"{path}: not a valid TOML file ({problem})") from problem
    for key in data:
        if key not in _KEYS:
            near = difflib.get_close_matches(key, _KEYS, n=3, cutoff=0.4)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(_KEYS)}"
            raise InputError(f"{path}: unknown key '{key}': {hint}")
    missing = [key for key in _REQUIRED if key not in data]
    if missing:
        raise InputError(f"{path}: missing {', '.join(missing)}")
    values = {key: _value(path, key, value) for key, value in data.items()}
    if values["process"] not in PROCESSES:
        raise InputError(f"{path}: process = '{values['process']}'; choose from {', '.join(PROCESSES)}")
    if "pixel_mm" not in values:
        values["pixel_mm"] = _derived_pitch(path, values)
    _check_agreement(path, values)
    return Printer(name=path.stem, **values)


def _check_agreement(path: Path, values: dict[str, Any]) -> None:
    """Raises InputError for values that are each well formed but cannot be, alone or together."""
    low, high = values["layer_range_mm"]
    if low > high:
        raise InputError(f"{path}: layer_range_mm = [{low}, {high}]; the lowest layer comes first")
    if values.get("mirror", "") not in MIRRORS:
        raise InputError(f"{path}: mirror = '{values['mirror']}'; choose from {', '.join(map(repr, MIRRORS))}")
    if values.get("format", ".") and not values.get("format", ".").startswith("."):
        raise InputError(f"{path}: format = '{values['format']}'; it is a suffix such as .sl1")
    for axis, pixels, pitch, size in zip(
        "xy", values.get("pixels", ()), values["pixel_mm"], values["build_mm"], strict=False
    ):
        if abs(pixels * pitch / size - 1) > 0.005:
            raise InputError(
                f"{path}: pixels × pixel_mm is {pixels * pitch:.4g} mm along {axis}, build_mm says {size:.4g} mm"
            )


def _value(path: Path, key: str, value: Any) -> Any:
    kind, count = _KEYS[key]
    items = value if count > 1 and isinstance(value, list) else [value]
    number = (int, float) if kind is float else kind
    if len(items) != count or not all(isinstance(v, number) and not isinstance(v, bool) for v in items):
        wanted = f"{count} numbers in brackets" if count > 1 else ("text" if kind is str else "a number")
        raise InputError(f"{path}: {key} = {value!r}; it is {wanted}")
    if kind is not str and not all(0 < v < math.inf for v in items):
        raise InputError(f"{path}: {key} = {value!r}; it must be above 0")
    return tuple(kind(v) for v in items) if count > 1 else kind(value)


def _derived_pitch(path: Path, values: dict[str, Any]) -> tuple[float, float]:
    """A panel's pitch is its size over its pixels; a nozzle's raster has eight pixels a nozzle width."""
    if "pixels" in values:
        (x_mm, y_mm, _), (x_px, y_px) = values["build_mm"], values["pixels"]
        return x_mm / x_px, y_mm / y_px
    if "nozzle_mm" in values:
        pitch = values["nozzle_mm"] / 8
        return pitch, pitch
    raise InputError(f"{path}: missing pixel_mm (or pixels, or nozzle_mm, from which it follows)")
