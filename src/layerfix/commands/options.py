"""What a user asks of a command: small values, each of which belongs to one step. None is "as the printer or the
file says"; what is given and nothing takes is refused, by the name that the command line gives it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from layerfix.errors import InputError

if TYPE_CHECKING:
    from layerfix.fdm import PathSettings
    from layerfix.layers.correction import Mode
    from layerfix.layers.gaps import Grow
    from layerfix.layers.skeleton import Spurs
    from layerfix.mesh.slicing import Fill, ZSampling
    from layerfix.orientation.find import Method
    from layerfix.printers import Printer


@dataclass(frozen=True)
class Frame:
    """Pixels and layers, of a mesh that is sliced, or of images that do not say."""

    pixel_mm: tuple[float, float] | None = None
    layer_mm: float | None = None
    first_layer_mm: float | None = None


@dataclass(frozen=True)
class Slicing:
    """What only a mesh takes."""

    fill: Fill | None = None
    z_sampling: ZSampling | None = None
    min_overlap: float | None = None
    antialias: bool | None = None
    unit: str | None = None
    scale: float | None = None
    orient: Method | None = None
    axes: str | None = None


@dataclass(frozen=True)
class Greys:
    """What only images and jobs take."""

    threshold: int | None = None
    grey_floor: int | None = None


@dataclass(frozen=True)
class Correction:
    """What is corrected, and how."""

    min_feature_mm: float | None = None
    mode: Mode | None = None
    spurs: Spurs | None = None
    first_layer_min_feature_mm: float | None = None
    ignore_below_mm2: float | None = None
    ignore_specks: bool | None = None
    keep_gaps_mm: float | None = None
    keep_out: Path | None = None
    grow: Grow | None = None
    min_layers: int | None = None


@dataclass(frozen=True)
class Run:
    """How the work is done and where things go."""

    workers: int = 0
    force: bool = False
    layers: tuple[int, int] | None = None
    picture: Path | None = None
    report: Path | None = None
    scheduler: str | None = None


@dataclass(frozen=True)
class Options:
    """All of it. output: what the writer of the target is told, by the names of `layerfix.formats.options`."""

    printer: Printer | None = None
    frame: Frame = Frame()
    slicing: Slicing = Slicing()
    greys: Greys = Greys()
    correction: Correction = Correction()
    run: Run = Run()
    output: Mapping[str, Any] = field(default_factory=dict)

    def path_settings(self) -> PathSettings | None:
        """How G-code lays its beads: the printer's way with the user's changes; None without a nozzle."""
        if self.printer is None or self.printer.nozzle_mm is None:
            return None
        from layerfix.fdm import settings_for

        own = ("width_mm", "perimeters", "density", "seam", "skirt_loops")
        changes = {name: self.output[name] for name in own if self.output.get(name) is not None}
        if "width_mm" in changes:
            changes["first_layer_width_mm"] = changes["width_mm"]
        return replace(settings_for(self.printer), **changes)


def options_of(printer: Printer | None, given: Mapping[str, Any]) -> Options:
    """Options from what was given by name: each goes to the one that has a field for it, the rest to the writer."""
    parts: dict[str, Any] = {}
    left = {name: value for name, value in given.items() if value is not None}
    for name, kind in PARTS.items():
        own = {f.name: left.pop(f.name) for f in fields(kind) if f.name in left}
        parts[name] = kind(**own)
    return Options(printer, **parts, output=left)


PARTS: dict[str, Any] = {"frame": Frame, "slicing": Slicing, "greys": Greys, "correction": Correction, "run": Run}
# What the command line calls an option whose name does not say it.
FLAGS = {"density": "--infill", "skirt_loops": "--skirt", "paths": ""}


def flag(name: str) -> str:
    """``--min-feature`` of ``min_feature_mm``."""
    return FLAGS[name] if name in FLAGS else "--" + name.removesuffix("_mm").replace("_", "-")


def refuse_given(part: Slicing | Greys, why: str) -> None:
    """Raises InputError if anything in `part` was given; why: where it would be taken instead."""
    names = [f.name for f in fields(part) if getattr(part, f.name) is not None]
    if names:
        raise InputError(f"{', '.join(map(flag, names))}: {why}")


class Raster(NamedTuple):
    """Pixels, layers and minimum feature that a mesh is printed in."""

    pixel_mm: tuple[float, float]
    layer_mm: float
    first_layer_mm: float | None
    min_feature_mm: float


def raster_of(options: Options, name: object, hint: Callable[[], str] = lambda: "") -> Raster:
    """What was given, else the printer's. Raises InputError, naming the mesh, for what neither says."""
    from layerfix.layers.feature import check_feature_mm

    printer, frame = options.printer, options.frame
    pixel_mm = frame.pixel_mm or (printer.pixel_mm if printer else None)
    layer_mm = frame.layer_mm or (printer.layer_mm if printer else None)
    if pixel_mm is None or layer_mm is None:
        raise InputError(
            f"{name}: a mesh needs --printer, or --pixel and --layer (such as --pixel 50um --layer 0.05mm){hint()}"
        )
    first_mm = frame.first_layer_mm or (printer.first_layer_mm if printer and not frame.layer_mm else None)
    min_feature_mm = min_feature_of(options)
    check_feature_mm(min_feature_mm, pixel_mm)
    return Raster(pixel_mm, layer_mm, first_mm, min_feature_mm)


def min_feature_of(options: Options, hint: Callable[[], str] = lambda: "") -> float:
    """What was given, or the printer's. Raises InputError if there is neither; hint: what the file says of it."""
    if options.correction.min_feature_mm is not None:
        return options.correction.min_feature_mm
    if options.printer is None:
        raise InputError(f"no minimum feature: give --min-feature (such as --min-feature 0.4mm) or --printer{hint()}")
    return options.printer.min_feature_mm
