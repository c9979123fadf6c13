"""The page that `layerfix report`, and `--report` of other commands, write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.commands.options import min_feature_of
from layerfix.errors import OutputError
from layerfix.files import check_apart, check_target
from layerfix.units import format_mm

if TYPE_CHECKING:
    from layerfix.commands.options import Options
    from layerfix.commands.part import Placing
    from layerfix.layers.correction import Mode
    from layerfix.layers.verdict import LayerVerdict
    from layerfix.stack import LayerStack

Progress = Callable[[int, int], None]


def check_page(page: Path, source: Path, target: Path | None, *, force: bool) -> None:
    """Raises OutputError for a report that is not .html, or is where something else is."""
    if page.suffix.lower() not in (".html", ".htm"):
        raise OutputError(f"{page}: the report is a page; call it .html")
    check_apart(page, source)
    if target is not None and (page.absolute() == target.absolute() or target.absolute() in page.absolute().parents):
        raise OutputError(f"{page}: is where the output goes; choose another place for the report")
    if page.is_dir():
        raise OutputError(f"{page}: is a folder; the report is a file")
    check_target(page, force=force)


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
    widths_mm: Sequence[float] = (),
    placed: Placing | None = None,
    progress: Progress = lambda done, total: None,
) -> tuple[int, int, int, tuple[str, ...]]:
    """Write the page of layers before and after; (layers, how many are shown, places in the table, notes)."""
    from layerfix.layers.correction import telling_paths
    from layerfix.report.collect import About, collect, file_facts
    from layerfix.report.directions import directions_of
    from layerfix.report.page import write_page

    asked = options.correction.min_feature_mm or (options.printer.min_feature_mm if options.printer else None)
    about = About(
        title=source.name,
        inputs=tuple(file_facts(path) for path in (source, fixed) if path is not None),
        settings=tuple(_settings(stack, options, mode if fixed is None else None)),
        feature_mm=asked,
        verdicts=tuple(verdicts),
        widths_mm=tuple(widths_mm),
        orientation=directions_of(placed.search) if placed is not None and placed.search is not None else None,
    )
    found = collect(stack, telling_paths(after), about, progress)
    write_page(target, found, force=options.run.force)
    meta = found.meta
    return len(stack), len(meta["layers"]["shown"]), len(meta["places"]), tuple(meta["notes"])


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
