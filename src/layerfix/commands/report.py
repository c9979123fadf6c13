"""`layerfix report`: layers before and after correction as a page to look at."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.commands.fix import as_asked, opened, usual_mode
from layerfix.commands.mesh_file import mesh_in
from layerfix.commands.options import min_feature_of
from layerfix.commands.pages import check_page, report_on
from layerfix.files import check_apart, check_input
from layerfix.formats import find_format, read
from layerfix.layers.verdict import judge
from layerfix.layers.widths import suggest_widths
from layerfix.mesh.slicing import slice_like
from layerfix.report.collect import check_alike

if TYPE_CHECKING:
    from layerfix.commands.options import Options
    from layerfix.layers.correction import Mode
    from layerfix.layers.verdict import LayerVerdict
    from layerfix.stack import LayerStack

Progress = Callable[[int, int], None]


def _silent(done: int, total: int) -> None:
    """Nobody is told."""


@dataclass(frozen=True)
class Written:
    """What `layerfix report --json` prints: where the page is, its size, how many layers, how many of them are in it,
    its notes."""

    source: str
    fixed: str | None
    target: str
    bytes: int
    layers: int
    layers_shown: int
    places: int
    notes: tuple[str, ...]
    seconds: float


def report(source: Path, fixed: Path | None, target: Path, options: Options, progress: Progress = _silent) -> Written:
    """Write the page of `source`, corrected, or beside `fixed`, a file of the same layers.

    Raises InputError for what cannot be read or does not match, OutputError for what cannot be written.
    """
    started = time.perf_counter()
    check_input(source)
    check_page(target, source, None, force=options.run.force)
    if fixed is not None:
        check_input(fixed)
        check_apart(target, fixed)
    stack, placed = opened(source, options)
    stack = stack.with_workers(options.run.workers)
    mode = options.correction.mode or usual_mode(options.printer, stack)
    if fixed is None:
        after = as_asked(stack, placed, mode, options)
        verdicts, widths_mm = _judged(stack, options, mode, progress), _widths(stack, options)
    else:
        after, verdicts, widths_mm = _other(fixed, stack, options), [], []
        check_alike(stack, after, (str(source), str(fixed)))
        if options.correction.min_feature_mm is not None or options.printer is not None:
            verdicts = _judged(stack, options, mode, progress)
    found = report_on(source, stack, after, target, options, mode, fixed=fixed, verdicts=verdicts,
                      widths_mm=widths_mm, placed=placed, progress=progress)  # fmt: skip
    return Written(str(source), str(fixed) if fixed else None, str(target), target.stat().st_size, *found,
                   time.perf_counter() - started)  # fmt: skip


def _judged(stack: LayerStack, options: Options, mode: Mode, progress: Progress) -> list[LayerVerdict]:
    verdicts = []
    spurs = options.correction.spurs or "metric"
    for verdict in judge(stack, min_feature_mm=min_feature_of(options), add_only=mode == "add_only", spurs=spurs):
        verdicts.append(verdict)
        progress(len(verdicts), len(stack))
    return verdicts


def _widths(stack: LayerStack, options: Options) -> list[float]:
    """Suggested extrusion widths, for a printer with a nozzle whose beads are wider than two pixels."""
    settings = options.path_settings()
    if settings is None or settings.range_mm[0] < 2 * max(stack.pixel_mm):
        return []
    found = suggest_widths(stack, min_mm=settings.range_mm[0], max_mm=settings.range_mm[1])
    return [round(float(width), 4) for width in found.width_mm]


def _other(path: Path, stack: LayerStack, options: Options) -> LayerStack:
    """The layers of a file on the frame of a stack."""
    found, _ = find_format(path)
    if found.mesh is not None:
        mesh = mesh_in(path, options.slicing)
        return slice_like(mesh, stack, hairlines=True, z_sampling="rescue").with_workers(options.run.workers)
    given = {name: value for name, value in asdict(options.greys).items() if value is not None}
    layer_mm, first_mm = (float(high - low) for low, high in (stack.z_mm[-1], stack.z_mm[0]))
    other = read(path, printer=options.printer, pixel_mm=stack.pixel_mm, layer_mm=layer_mm, first_layer_mm=first_mm,
                 **given)  # fmt: skip
    return other.with_workers(options.run.workers)


def lines_of(written: Written) -> list[tuple[str, str]]:
    """What a user wants to see."""
    shown = f"{written.layers}" if written.layers_shown == written.layers else (
        f"{written.layers}, of which {written.layers_shown} are in the page"
    )  # fmt: skip
    return [
        ("layers", shown),
        ("places", f"{written.places} to look at"),
        ("size", f"{written.bytes / 1e6:.1f} MB"),
        ("time", f"{written.seconds:.2f} s"),
        *(("note", note) for note in written.notes),
        ("written", written.target),
    ]
