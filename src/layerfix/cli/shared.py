"""Options that several commands take, and how commands show that they are at work and what came of it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click
import cloup

from layerfix.cli.types import Length, Pitch, Scale
from layerfix.units import format_mm

if TYPE_CHECKING:
    from rich.console import Console

    from layerfix.commands.options import Options
    from layerfix.commands.summary import Summary

PRINTER = cloup.option("-p", "--printer", metavar="NAME", help="A printer of `layerfix printers`, or your own .toml.")
FRAME = (
    cloup.option("--pixel", "pixel_mm", type=Pitch(), help="Pixel pitch: 50um, or 19umx24um."),
    cloup.option("--layer", "layer_mm", type=Length(), help="Layer height: 0.05mm."),
    cloup.option("--first-layer", "first_layer_mm", type=Length(), help="Height of the first layer, if it differs."),
)
MESH = (
    cloup.option("--unit", help="What one unit of the mesh is: mm, in, m … [default: as the file says, else mm]"),
    cloup.option("--scale", type=Scale(), help="Make the part so many times as large: 1:87, 50%, 2."),
)
WORKERS = cloup.option("--workers", type=cloup.IntRange(1), help="Threads. [default: one per core]")
SCHEDULER = cloup.option(
    "--scheduler", metavar="ADDRESS", help="Compute on the workers of a Dask scheduler: tcp://host:8786."
)
FORCE = cloup.option("--force", is_flag=True, help="Replace outputs that exist.")
# Set to "lines", progress is told a program that shows it in its own way.
PROGRESS = "LAYERFIX_PROGRESS"
# With one of these set, a pipe counts as a terminal (rich, "Environment variables").
FORCED = {"FORCE_COLOR", "TTY_COMPATIBLE"}
JSON = cloup.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")


def options_from(printer: str | None, given: dict[str, Any]) -> Options:
    """What was given, sorted by whom it belongs to."""
    from layerfix.commands.options import options_of
    from layerfix.printers import load_printer

    if given.get("bits"):
        given["bits"] = int(given["bits"])
    return options_of(load_printer(printer) if printer else None, with_codes(given))


def with_codes(given: dict[str, Any]) -> dict[str, Any]:
    """Start and end code read from the files that were named. Raises InputError for what cannot be read."""
    from layerfix.errors import InputError
    from layerfix.files import check_input, reading

    for key in ("start_gcode", "end_gcode"):
        path = given.get(key)
        if path is None:
            continue
        check_input(path, folders=False)
        try:
            with reading(path):
                given[key] = path.read_text(encoding="utf-8")
        except UnicodeDecodeError as problem:
            raise InputError(f"{path}: is no G-code: not text in UTF-8 ({problem.reason})") from problem
    return given


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with the time left on a terminal; in a pipe nothing, or lines for a program that has a bar of its own."""
    stopped = click.get_current_context().obj
    console = terminal()
    if console is None:
        yield _lines(stopped) if os.environ.get(PROGRESS) == "lines" else lambda done, total: _abort_if(stopped)
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from layerfix.kernels import compiling_told

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=None)

        def show(done: int, total: int) -> None:
            _abort_if(stopped)
            bar.update(task, description=what, completed=done, total=total)

        with compiling_told(lambda _: bar.update(task, description="compiling kernels (once) …")):
            yield show


def terminal() -> Console | None:
    """Where progress is drawn; None in a pipe, for which nothing has to be loaded that draws."""
    if sys.stderr is None or not (sys.stderr.isatty() or FORCED & os.environ.keys()):
        return None
    from rich.console import Console

    console = Console(stderr=True)
    return console if console.is_terminal else None


def _lines(stopped: list[int] | None) -> Callable[[int, int], None]:
    """Each whole percent as a line: ``layerfix: 37 %``. A command may begin anew for what comes next."""
    last = [-1]

    def show(done: int, total: int) -> None:
        _abort_if(stopped)
        percent = 100 * done // max(total, 1)
        if percent != last[0]:
            last[0] = percent
            click.echo(f"layerfix: {percent} %", err=True)

    return show


@contextmanager
def kernels_ready() -> Iterator[None]:
    """Say so if the block takes long: the first run on a machine compiles the kernels and keeps them."""
    console = terminal()
    stopped = click.get_current_context().obj
    if console is None:
        yield
        _abort_if(stopped)
        return
    import threading

    status = console.status("compiling the kernels for this machine (once, up to a minute) …")
    timer = threading.Timer(1.5, status.start)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        status.stop()
    _abort_if(stopped)


def _abort_if(stopped: list[int] | None) -> None:
    """End the command if a signal came whose exception a library swallowed."""
    if stopped:
        raise click.Abort


def summary_table(s: Summary) -> str:
    """The few lines a user wants to see."""
    rows = [
        ("layers", f"{s.layers} of {s.size_px[0]} × {s.size_px[1]} px"),
        ("changed", f"{s.layers_changed} ({s.mode}, minimum feature {format_mm(s.min_feature_mm)})"),
        ("thinnest", "nothing was too thin" if s.thinnest_mm is None
         else f"{_thinnest(s)} at z = {s.thinnest_z_mm:.3f} mm"),
        ("added", f"{s.added_mm3:.4g} mm³ ({s.added_percent:.3g} %)"),
        ("removed", f"{s.removed_mm3:.4g} mm³ ({s.removed_percent:.3g} %)"),
        ("time", f"{s.seconds:.2f} s"),
    ]  # fmt: skip
    if s.layers_with_gaps:
        rows.insert(
            1,
            (
                "open mesh",
                f"gaps closed in {s.layers_with_gaps} layers, the longest {format_mm(s.longest_gap_mm)}",
            ),
        )
    rows += [("note", note) for note in s.notes]
    rows.append(("written", s.target))
    return rows_text(rows)


def _thinnest(s: Summary) -> str:
    """With its precision."""
    assert s.thinnest_mm is not None
    if s.hairline_layers and s.thinnest_mm <= min(s.pixel_mm) * 1.01:
        return f"under {format_mm(min(s.pixel_mm))}"
    return f"{format_mm(round(s.thinnest_mm, 4))} (± {format_mm(s.within_mm)})"


def rows_text(rows: Sequence[tuple[str, str]]) -> str:
    """Names and values in two columns."""
    width = max(10, *(len(name) + 1 for name, _ in rows))
    return "\n".join(f"{name:{width}}{value}" for name, value in rows)
