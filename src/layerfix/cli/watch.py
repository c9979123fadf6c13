"""``layerfix watch``."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any, TypeVar

import click
import cloup

from layerfix.cli.fix import fix
from layerfix.cli.shared import kernels_ready, options_from

NOT_HERE = (
    "source",
    "more",
    "picture",
    "report",
    "as_json",
    "layers",
    "out_dir",
    "out_type",
    "scheduler",
)  # of `fix`: of one file, not of many
Function = TypeVar("Function", bound=Callable[..., Any])


def options_of_fix(function: Function) -> Function:
    """Give a command the options of `layerfix fix`, in their groups."""
    # Copies, groups and all: a command takes the groups of its options for its own.
    own = deepcopy([parameter for parameter in fix.params if parameter.name not in NOT_HERE])
    function.__click_params__ = [*getattr(function, "__click_params__", []), *reversed(own)]  # type: ignore[attr-defined]  # where click looks for them
    return function


@cloup.command()
@cloup.argument("folder", metavar="DIR", type=cloup.Path(path_type=Path))
@cloup.option_group(
    "Watching",
    cloup.option("--out", metavar="DIR", required=True, type=cloup.Path(path_type=Path), help="Where they go."),
    cloup.option("--once", is_flag=True, help="End when all that is there is corrected; 1 if some of it failed."),
    cloup.option(
        "--settle", "settle_s", type=cloup.FloatRange(0), default=2.0, show_default=True,
        help="Seconds for which a job's size must stay the same before it is touched.",
    ),
    cloup.option(
        "--interval", "interval_s", type=cloup.FloatRange(0.01), default=1.0, show_default=True,
        help="Seconds between two looks.",
    ),
    cloup.option("--json", "as_json", is_flag=True, help="Print a line of JSON for every job."),
)  # fmt: skip
@options_of_fix
def watch(
    folder: Path, printer: str | None, out: Path, once: bool, settle_s: float, interval_s: float, as_json: bool,
    **given: Any,
) -> None:  # fmt: skip
    """Correct every job that is put into DIR, exactly once, into the folder --out, under the same name.

    Jobs, zips and folders of images, and meshes: whatever `layerfix fix` corrects into a file of its own kind. A job
    is not touched until it has stopped growing; outputs appear whole; a run that was killed is gone on with. The
    folder --out holds a log (layerfix-watch.log) and a journal of what is done. Ctrl-C ends it.

    \b
    Examples:
      layerfix watch exported --out corrected -p prusa-sl1s
      layerfix watch exported --out corrected --min-feature 0.15mm --once --json
    """
    with kernels_ready():
        from layerfix.commands.watch import Event, Watch

    def tell(event: Event) -> None:
        click.echo(json.dumps(event.as_dict()) if as_json else event.line())

    options = options_from(printer, given)
    failed = Watch(folder, out, options, tell, settle_s, interval_s).run(once=once)
    if failed:
        raise click.exceptions.Exit(1)
