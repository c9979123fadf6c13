"""``layerfix orient``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from layerfix.cli.shared import (
    FORCE,
    FRAME,
    JSON,
    MESH,
    PRINTER,
    SCHEDULER,
    WORKERS,
    kernels_ready,
    options_from,
    rows_text,
    terminal,
)
from layerfix.cli.types import Length, Weights

if TYPE_CHECKING:
    from collections.abc import Callable

    from layerfix.orientation.search import State

METHODS = ["race", "quick", "anneal", "direct"]


@cloup.command()
@cloup.argument("source", metavar="IN", type=cloup.Path(path_type=Path))
@cloup.option_group(
    "What is written",
    cloup.option(
        "-o",
        "--output",
        "targets",
        metavar="OUT",
        multiple=True,
        type=cloup.Path(path_type=Path),
        help="The part as it should stand (.stl .3mf .obj), all figures and the 4 × 4 transform (.json), or a map of"
        " all directions (.png .svg), or a page with the layers and that map (.html); may be given several times.",
    ),
    cloup.option(
        "--pareto",
        "fronts",
        metavar="OUT",
        multiple=True,
        type=cloup.Path(path_type=Path),
        help="Poses that nothing beats in every aim: a table (.csv .json) or a picture (.png .svg).",
    ),
)
@cloup.option_group(
    "Printer and correction",
    PRINTER,
    cloup.option("--min-feature", "min_feature_mm", type=Length(), help="Smallest dot or bead it makes: 0.4mm."),
    cloup.option("--mode", type=cloup.Choice(["as_printed", "add_only"]), help="How it would be corrected."),
    cloup.option("--spurs", type=cloup.Choice(["metric", "paper"]), help="As in `layerfix fix`. [default: metric]"),
    cloup.option("--fit", is_flag=True, help="Only poses that fit the printer."),
)
@cloup.option_group("Pixels and layers", *FRAME, *MESH)
@cloup.option_group(
    "Search",
    cloup.option(
        "--method",
        type=cloup.Choice(METHODS),
        default="race",
        show_default=True,
        help="race: many directions on some layers, the best in full; quick: fewer; anneal: the paper's simulated"
        " annealing; direct: DIRECT.",
    ),
    cloup.option(
        "--weights",
        type=Weights(),
        help="What is minimised: added=1,removed=1,support=0.2 … also overhang, height, staircase, contact."
        " [default: added=1,removed=1]",
    ),
    cloup.option(
        "--cooling", type=cloup.Choice(["exponential", "linear", "logarithmic"]), help="Of anneal. [exponential]"
    ),
    cloup.option("--evaluations", type=cloup.IntRange(2), help="Of anneal and direct. [default: 300]"),
    cloup.option("--seed", type=cloup.IntRange(0), default=0, show_default=True, help="Of anneal."),
)
@cloup.option_group(
    "Running",
    cloup.option("--log", type=cloup.Path(path_type=Path), help="A line of JSON for every evaluation."),
    cloup.option("--resume", is_flag=True, help="Go on from the log, to the same end."),
    SCHEDULER,
    cloup.option("--processes", type=cloup.IntRange(1), help="Processes instead of threads."),
    WORKERS,
    FORCE,
    JSON,
)
def orient(
    source: Path,
    targets: tuple[Path, ...],
    fronts: tuple[Path, ...],
    printer: str | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Find the build direction in which IN, a mesh, needs the least correction.

    Ctrl-C keeps the best so far, and writes it. In `layerfix fix --orient` it is one step with the correction.

    \b
    Examples:
      layerfix orient part.stl -p prusa-sl1s -o best.stl -o directions.png
      layerfix orient part.stl --pixel 0.1mm --layer 0.1mm --min-feature 0.8mm --json
      layerfix orient part.stl -p prusa-mk3s-0.4 --weights support=0.2 --pareto trade.csv --fit
    """
    with kernels_ready():
        from layerfix.commands import orient as commands
        from layerfix.orientation.find import Options
    own = {name: given.pop(name) for name in ("fit", "log", "resume", "scheduler", "processes")}
    names = ("method", "weights", "cooling", "evaluations", "seed")
    search = {name: value for name in names if (value := given.pop(name)) is not None}
    wanted = commands.OrientOptions(Options(**search), fronts=fronts, **own)
    with searching(source.name) as shown:
        found = commands.orient(source, targets, options_from(printer, given), wanted, shown)
    written = [*targets, *fronts]
    click.echo(json.dumps(found.summary()) if as_json else rows_text(commands.lines_of(found, written)))


@contextmanager
def searching(name: str) -> Iterator[Callable[[State], None]]:
    """A bar with what is done, the best so far and the time left on a terminal; nothing in a pipe.

    A Ctrl-C whose exception something swallowed is raised once more.
    """
    stopped: list[int] = click.get_current_context().obj
    raised: list[int] = []

    def stop_if_told() -> None:
        if stopped and not raised:
            raised.append(1)
            raise KeyboardInterrupt

    console = terminal()
    if console is None:
        yield lambda state: stop_if_told()
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(f"turning {name}", total=None)

        def show(state: State) -> None:
            stop_if_told()
            best = f", best {state.best:.3f}" if state.best == state.best else ""
            bar.update(task, description=f"{state.doing}{best}", completed=state.done, total=state.total)

        yield show
