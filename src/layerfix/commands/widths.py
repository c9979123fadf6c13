"""Extrusion widths as one call: open the part, suggest, band, estimate, and write every file asked for."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.commands.options import Correction, Options
from layerfix.commands.part import open_part
from layerfix.draw.canvas import SUFFIXES as DRAWINGS
from layerfix.errors import InputError, OutputError
from layerfix.fdm import settings_for
from layerfix.fdm.bands import banded
from layerfix.fdm.speeds import Speeds, written_time
from layerfix.fdm.width_plan import WidthPlan, with_first_layer
from layerfix.files import already_written, check_apart, check_input, check_target
from layerfix.formats import write
from layerfix.formats.solid.width_files import SLICERS
from layerfix.layers.widths import Rule, Widths, suggest_widths
from layerfix.mesh.empty import empty_between, told_of_gaps
from layerfix.units import format_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.fdm import PathSettings
    from layerfix.fdm.speeds import ByArea
    from layerfix.formats.options import Own
    from layerfix.printers import Printer
    from layerfix.stack import Gaps, Layer

SUFFIXES = (".3mf", ".gcode", ".csv", ".json", *DRAWINGS)


@dataclass(frozen=True)
class WidthOptions:
    """What the user asked for; None is "as the printer's file says"."""

    min_mm: float | None = None
    max_mm: float | None = None
    step_mm: float = 0.05
    loss_mm: float = 0.0
    rule: Rule = "opening"
    bands: int = 6
    band_height_mm: float | None = None
    slicer: str | None = None


@dataclass(frozen=True)
class WidthSummary:
    """What was suggested and chosen.

    Times and filament are of beads alone, without travels: with the printer's usual width everywhere, with the
    narrowest of the range everywhere (which prints every layer that is not too thin), and as chosen.
    """

    source: str
    targets: tuple[str, ...]
    layers: int
    range_mm: tuple[float, float]
    step_mm: float
    too_thin: int
    too_thin_z_mm: tuple[tuple[float, float], ...]
    ranges: tuple[tuple[float, float, float], ...]
    usual_width_mm: float
    seconds_before: float
    seconds_narrowest: float
    seconds_after: float
    filament_before_mm: float
    filament_after_mm: float
    volume_mm3: float
    first_layer_width_mm: float
    finer_layers: int
    melting_share: float
    limit: str
    seconds: float
    notes: tuple[str, ...] = ()


def suggest(
    source: Path,
    targets: Sequence[Path],
    options: Options,
    wanted: WidthOptions,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> WidthSummary:
    """Suggest a width for every layer of a mesh and write each of `targets` (by suffix, see SUFFIXES).

    Raises InputError for a printer without a nozzle and widths it cannot lay, OutputError for targets, before any
    work where it can.
    """
    started = time.perf_counter()
    printer = options.printer
    if printer is None:
        raise InputError("extrusion widths depend on the nozzle and its speeds: give --printer")
    settings = settings_for(printer)
    low, high = wanted.min_mm or settings.range_mm[0], wanted.max_mm or settings.range_mm[1]
    for width in (low, high):
        settings.check_width(width)
    if wanted.slicer is not None and wanted.slicer not in SLICERS:
        raise InputError(f"slicer '{wanted.slicer}' is not known; choose from {', '.join(SLICERS)}")
    models = [path for path in targets if path.suffix.lower() == ".3mf"]
    if wanted.slicer is not None and not models:
        raise InputError(f"--slicer {wanted.slicer}: goes with a .3mf, and none of the outputs is one")
    check_input(source, folders=False)
    for path in targets:
        _check(path, source, options.run.force)
        if targets.count(path) > 1:
            raise OutputError(f"{path}: is named twice; every output needs a name of its own")
    px, py = options.frame.pixel_mm or printer.pixel_mm
    if abs(px - py) > 1e-9 * px and any(path.suffix.lower() == ".gcode" for path in targets):
        raise InputError(f"pixels of {format_mm(px)} × {format_mm(py)}: G-code needs square pixels; use one pitch")
    feature_mm = options.correction.min_feature_mm or low
    mesh, stack, _ = open_part(source, replace(options, correction=Correction(feature_mm)))
    stack = stack.with_workers(options.run.workers)
    gaps: list[Gaps] = []
    suggested = suggest_widths(
        stack.map(_Gathering(gaps), pixels_only=True),
        min_mm=low,
        max_mm=high,
        step_mm=wanted.step_mm,
        loss_mm=wanted.loss_mm,
        rule=wanted.rule,
    )
    layer_mm = float(np.median(stack.z_mm[:, 1] - stack.z_mm[:, 0]))
    height_mm = 5 * layer_mm if wanted.band_height_mm is None else wanted.band_height_mm
    chosen = banded(suggested, wanted.bands, min_height_mm=height_mm)
    summary = _add_up(source, targets, suggested, chosen, printer, settings, started)
    told = [*stack.notes, *_told_of(suggested, gaps, wanted)]
    bodies = len(mesh.bodies.names) if mesh.bodies is not None else 1
    if models and bodies > 1:
        told.append(f"{mesh.name}: its {bodies} bodies become one object of the .3mf")
    plan = WidthPlan(mesh, stack, suggested, chosen, printer, settings)

    def watch(index: int, layer: Layer) -> None:
        progress(index + 1, len(stack))

    in_order = sorted(targets, key=lambda path: path.suffix.lower() == ".json")  # which says what was told of all
    for k, path in enumerate(in_order):
        own: Own = {"slicer": wanted.slicer} if path.suffix.lower() == ".3mf" and wanted.slicer else {}
        plan = replace(plan, summary=asdict(replace(summary, notes=tuple(told))))
        with already_written(*in_order[:k]):
            write(path, plan, printer, force=options.run.force, watch=watch, tell=told.append, **own)
    return replace(summary, seconds=time.perf_counter() - started, notes=tuple(told))


@dataclass(frozen=True)
class _Gathering:
    """Layers as they are; what slicing closed in them is gathered."""

    gaps: list[Gaps]

    def __call__(self, layer: Layer) -> Layer:
        if layer.gaps is not None:
            self.gaps.append(layer.gaps)
        return layer


def _told_of(widths: Widths, gaps: Sequence[Gaps], wanted: WidthOptions) -> list[str]:
    """A word about an open mesh, layers that are empty, and steps of which none was taken."""
    words = empty_between((widths.area_mm2 > 0).tolist(), widths.z_mm.tolist())
    words += told_of_gaps(gaps)
    low, high = widths.range_mm
    if high - low < wanted.step_mm * (1 - 1e-9) and high > low:
        words.append(
            f"a step of {format_mm(wanted.step_mm)} is more than the range: only {format_mm(low)} and"
            f" {format_mm(high)} are tried"
        )
    return words


def _check(path: Path, source: Path, force: bool) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: widths are written as {' '.join(SUFFIXES)}")
    check_apart(path, source)
    check_target(path, force=force)


def _add_up(
    source: Path,
    targets: Sequence[Path],
    suggested: Widths,
    chosen: Widths,
    printer: Printer,
    settings: PathSettings,
    started: float,
) -> WidthSummary:
    speeds, usual_mm = Speeds(printer), settings.width_mm
    own_mm = settings.first_layer_width_mm

    def taken(width_mm: NDArray[np.float64]) -> ByArea:
        laid = with_first_layer(replace(chosen, width_mm=width_mm), own_mm)
        shells = settings.top_layers, settings.bottom_layers
        return speeds.by_area(laid, laid.width_mm, perimeters=settings.perimeters, density=settings.density,
                              shells=shells)  # fmt: skip

    before, narrowest = (taken(np.full(len(chosen), width)) for width in (usual_mm, suggested.range_mm[0]))
    after = taken(chosen.width_mm)
    share = after.melting_s / after.seconds if after.seconds else 0.0
    most = printer.max_volumetric_speed_mm3_s
    if most and share > 0.5:
        limit = f"melting: {most:g} mm³/s are reached in {100 * share:.0f} % of the time; there, wider is not faster"
    elif most:
        limit = f"the speeds set for the printer; melting ({most:g} mm³/s) limits {100 * share:.0f} % of the time"
    else:
        limit = "the speeds set for the printer; how much it can melt is not known (max_volumetric_speed_mm3_s)"
    finer = ~suggested.too_thin & (suggested.width_mm < usual_mm - 1e-9)
    thin = np.flatnonzero(suggested.too_thin)
    stretches = np.split(thin, np.flatnonzero(np.diff(thin) > 1) + 1) if len(thin) else []
    too_thin_z = tuple((float(suggested.z_mm[s[0], 0]), float(suggested.z_mm[s[-1], 1])) for s in stretches)
    return WidthSummary(
        source=str(source),
        targets=tuple(map(str, targets)),
        layers=len(chosen),
        range_mm=suggested.range_mm,
        step_mm=suggested.step_mm,
        too_thin=len(thin),
        too_thin_z_mm=too_thin_z,
        ranges=tuple(chosen.ranges()),
        usual_width_mm=usual_mm,
        seconds_before=before.seconds,
        seconds_narrowest=narrowest.seconds,
        seconds_after=after.seconds,
        filament_before_mm=before.filament_mm,
        filament_after_mm=after.filament_mm,
        volume_mm3=after.volume_mm3,
        first_layer_width_mm=float(with_first_layer(chosen, own_mm).width_mm[0]),
        finer_layers=int(finer.sum()),
        melting_share=share,
        limit=limit,
        seconds=time.perf_counter() - started,
    )


def lines_of(summary: WidthSummary) -> list[tuple[str, str]]:
    """(name, value) of what a user wants to see."""
    low, high = summary.range_mm
    rows = [("layers", f"{summary.layers}, widths from {format_mm(low)} to {format_mm(high)}")]
    if summary.too_thin:
        shown = ", ".join(f"{a:.2f} to {b:.2f}" for a, b in summary.too_thin_z_mm[:6])
        more = " …" if len(summary.too_thin_z_mm) > 6 else ""
        rows.append(("too thin", f"{summary.too_thin} layers, correct these: z = {shown}{more} mm"))
    rows += [("band", f"{format_mm(width)} from z = {a:.2f} to {b:.2f} mm") for a, b, width in summary.ranges]
    if summary.ranges and abs(summary.ranges[0][2] - summary.first_layer_width_mm) > 1e-9:
        rows.append(("layer 0", f"{format_mm(summary.first_layer_width_mm)}, the printer's own for its first layer"))
    rows += _figures(summary)
    rows.append(("limit", summary.limit))
    rows += [("advice", text) for text in _advice(summary)]
    rows += [("note", note) for note in summary.notes]
    rows += [("written", target) for target in summary.targets]
    return rows


def _figures(summary: WidthSummary) -> list[tuple[str, str]]:
    """Time and filament, each against the usual width, the time against the narrowest, too."""
    usual, low = summary.usual_width_mm, summary.range_mm[0]
    after = summary.seconds_after
    rows = [("time", f"{written_time(after)} of laying beads alone (no travel, corners and cooling)")]
    against = [(usual, summary.seconds_before), (low, summary.seconds_narrowest)]
    for width, seconds in against[: 1 if abs(low - usual) < 1e-9 else 2]:
        rows.append(("", f"{_change(after, seconds)} {format_mm(width)} everywhere ({written_time(seconds)})"))
    metres, cubic = summary.filament_after_mm / 1000, summary.volume_mm3 / 1000
    change = _change(summary.filament_after_mm, summary.filament_before_mm)
    amount = f"about {metres:.3g} m, {cubic:.3g} cm³ by the layers' areas"
    rows.append(("filament", f"{amount}, {change} {format_mm(usual)} everywhere"))
    return rows


def _change(after: float, before: float) -> str:
    percent = round(100 * (after / before - 1), 1) if before else 0.0
    return f"{percent:+.1f} % against" if percent else "as with"


def _advice(summary: WidthSummary) -> list[str]:
    """Whether it is worth it; nothing where time is saved."""
    usual = format_mm(summary.usual_width_mm)
    if summary.seconds_after <= 0.995 * summary.seconds_before:
        return []
    if summary.finer_layers:
        return [
            f"{summary.finer_layers} layers have parts that {usual} everywhere would lose: that is what it is for"
        ]
    speed = "faster" if summary.seconds_after > 1.005 * summary.seconds_before else "as fast"
    thin = "; correct the thin layers first (layerfix fix)" if summary.too_thin else ""
    return [f"not worth it: {usual} everywhere prints the same layers and is {speed}{thin}"]
