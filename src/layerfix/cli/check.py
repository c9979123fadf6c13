"""``layerfix check``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import cloup

from layerfix.cli.shared import (
    FORCE,
    FRAME,
    JSON,
    MESH,
    PRINTER,
    WORKERS,
    kernels_ready,
    options_from,
    progress,
    rows_text,
)
from layerfix.cli.types import Length
from layerfix.errors import InputError


@cloup.command()
@cloup.argument("source", metavar="IN", type=cloup.Path(path_type=Path))
@cloup.option_group(
    "Printer and correction",
    PRINTER,
    cloup.option("--min-feature", "min_feature_mm", type=Length(), help="Smallest dot or bead it makes: 0.4mm."),
    cloup.option("--mode", type=cloup.Choice(["as_printed", "add_only"]), help="How it would be corrected."),
)
@cloup.option_group("Pixels and layers (of a mesh, or of images that do not say)", *FRAME)
@cloup.option_group(
    "A mesh as IN",
    *MESH,
    cloup.option(
        "--axes",
        default="z",
        metavar="AXES",
        help="xyz: along x and y, too, where layers cannot see. [default: z]",
    ),
)
@cloup.option_group(
    "G-code made of IN",
    cloup.option("--gcode", type=cloup.Path(path_type=Path), help="Say what this file leaves out of IN, instead."),
    cloup.option("--strict", is_flag=True, help="End with 1 if it leaves out anything."),
)
@cloup.option_group(
    "Running",
    cloup.option("--markdown", is_flag=True, help="Print a table for a pull request."),
    cloup.option("--report", type=cloup.Path(path_type=Path), help="Also write a page to look at (.html)."),
    FORCE,
    WORKERS,
    JSON,
)
def check(
    source: Path,
    printer: str | None,
    as_json: bool,
    markdown: bool,
    axes: str,
    gcode: Path | None,
    strict: bool,
    **given: Any,
) -> None:
    """Say what the printer would lose of IN, and where; nothing is written.

    IN is a mesh, a resin job or PNG images, as in `layerfix fix`. Ends with 1 if something would be lost, with 0 if
    not, with 2 if it cannot be read.

    \b
    Examples:
      layerfix check part.stl -p prusa-mk3s-0.4
      layerfix check job.sl1 --min-feature 0.15mm --json
      layerfix check project.3mf --gcode project.gcode --strict
    """
    if as_json and markdown:
        raise InputError("--json and --markdown: one of the two")
    if gcode is not None:
        _check_gcode(
            source, gcode, printer, as_json, strict, {**given, "markdown": markdown, "axes": axes.strip("z")}
        )
        return
    if strict:
        raise InputError("--strict goes with --gcode; without it, `check` ends with 1 if something would be lost")
    with kernels_ready():
        from layerfix.commands import check as commands
    with progress(f"checking {source.name}") as shown:
        verdict = commands.check(source, options_from(printer, given), shown, axes=axes)
    if as_json:
        click.echo(json.dumps(asdict(verdict)))
    else:
        click.echo(commands.markdown_of(verdict) if markdown else rows_text(commands.lines_of(verdict)))
    if not verdict.ok:
        raise click.exceptions.Exit(1)


def _check_gcode(
    source: Path, gcode: Path, printer: str | None, as_json: bool, strict: bool, given: dict[str, Any]
) -> None:
    """Say what a G-code leaves out; ends with 1 only if that is asked for."""
    for name in ("markdown", "axes", "report", "min_feature_mm", "mode", "layer_mm", "first_layer_mm"):
        if given.pop(name, None):
            raise InputError(f"--{name.removesuffix('_mm').replace('_', '-')} does not go with --gcode")
    with kernels_ready():
        from layerfix.commands import gcode_check as commands
    with progress(f"checking {gcode.name}") as shown:
        verdict = commands.check_gcode(source, gcode, options_from(printer, given), shown)
    click.echo(json.dumps(asdict(verdict)) if as_json else rows_text(commands.lines_of(verdict)))
    if strict and not verdict.ok:
        raise click.exceptions.Exit(1)
