"""`layerfix report`: layers before and after correction as a page to look at."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.commands.fix import as_asked, check_page, min_feature_of, opened, usual_mode
from layerfix.files import check_apart, check_input
from layerfix.formats import find_format, read, read_mesh
from layerfix.layers.correction import telling_paths
from layerfix.layers.verdict import judge
from layerfix.mesh.slicing import slice_like
from layerfix.report.collect import About, check_alike, collect, file_facts
from layerfix.report.page import write_page
from layerfix.units import format_mm

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
    """What `layerfix report --json` prints: where the page is, its size, how many layers, which of them are in it."""

    source: str
    fixed: str | None
    target: str
    bytes: int
    layers: int
    layers_shown: int
    places: int
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
    stack, turned = opened(source, options)
    stack = stack.with_workers(options.run.workers)
    mode = options.correction.mode or usual_mode(options.printer, stack)
    if fixed is None:
        after = as_asked(stack, turned, mode, options)
        verdicts = _judged(stack, options, mode, progress)
    else:
        after, verdicts = _other(fixed, stack, options), []
        check_alike(stack, after, (str(source), str(fixed)))
    found = report_on(source, stack, after, target, options, mode, fixed=fixed, verdicts=verdicts, progress=progress)
    return Written(str(source), str(fixed) if fixed else None, str(target), target.stat().st_size, *found,
                   time.perf_counter() - started)  # fmt: skip


def report_on(
    source: Path,
    stack: LayerStack,
    after: LayerStack,
    target: Path,
    options: Options,
    mode: Mode,
    *,
    fixed: Path | None = None,
    verdicts: Sequence[LayerVerdict] = (),
    progress: Progress = _silent,
) -> tuple[int, int, int]:
    """Write the page of layers before and after; (layers, how many are in the page, places in its table)."""
    asked = options.correction.min_feature_mm or (options.printer.min_feature_mm if options.printer else None)
    about = About(
        title=source.name,
        inputs=tuple(file_facts(path) for path in (source, fixed) if path is not None),
        settings=tuple(_settings(stack, options, mode if fixed is None else None)),
        feature_mm=asked,
        verdicts=tuple(verdicts),
    )
    found = collect(stack, telling_paths(after), about, progress)
    write_page(target, found, force=options.run.force)
    return len(stack), len(found.meta["layers"]["shown"]), len(found.meta["places"])


def _judged(stack: LayerStack, options: Options, mode: Mode, progress: Progress) -> list[LayerVerdict]:
    verdicts = []
    spurs = options.correction.spurs or "metric"
    for verdict in judge(stack, min_feature_mm=min_feature_of(options), add_only=mode == "add_only", spurs=spurs):
        verdicts.append(verdict)
        progress(len(verdicts), len(stack))
    return verdicts


def _other(path: Path, stack: LayerStack, options: Options) -> LayerStack:
    """The layers of a file on the frame of a stack."""
    found, _ = find_format(path)
    if found.mesh is not None:
        mesh = read_mesh(path, unit=options.slicing.unit, scale=options.slicing.scale or 1.0)
        return slice_like(mesh, stack, hairlines=True, z_sampling="rescue").with_workers(options.run.workers)
    given = {name: value for name, value in asdict(options.greys).items() if value is not None}
    layer_mm, first_mm = (float(high - low) for low, high in (stack.z_mm[-1], stack.z_mm[0]))
    other = read(path, printer=options.printer, pixel_mm=stack.pixel_mm, layer_mm=layer_mm, first_layer_mm=first_mm,
                 **given)  # fmt: skip
    return other.with_workers(options.run.workers)


def _settings(stack: LayerStack, options: Options, mode: Mode | None) -> list[tuple[str, str]]:
    """What the result depends on."""
    printer, how = options.printer, options.correction
    rows = [("printer", f"{printer.maker} {printer.model} ({printer.name})")] if printer else []
    if mode is not None:
        rows += [("minimum feature", format_mm(min_feature_of(options))), ("mode", mode),
                 ("spurs", how.spurs or "metric")]  # fmt: skip
    x, y = stack.pixel_mm
    rows.append(("pixels", format_mm(x) if x == y else f"{format_mm(x)} × {format_mm(y)}"))
    heights = stack.z_mm[:, 1] - stack.z_mm[:, 0]
    rows.append(("layers", f"{len(stack)} of {format_mm(float(heights[-1]))}"))
    if abs(heights[0] - heights[-1]) > 1e-6:
        rows.append(("first layer", format_mm(float(heights[0]))))
    given = {name: value for name, value in asdict(how).items()
             if value is not None and name not in ("min_feature_mm", "mode", "spurs")}  # fmt: skip
    given |= {name: value for name, value in asdict(options.slicing).items() if value is not None}
    return rows + [(name.removesuffix("_mm").replace("_", " "), str(value)) for name, value in given.items()]


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
        ("written", written.target),
    ]
