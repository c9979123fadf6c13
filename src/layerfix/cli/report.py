"""``layerfix report`` and ``layerfix show``: for those who would rather look."""

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

CORRECTION = cloup.option_group(
    "Printer and correction",
    PRINTER,
    cloup.option("--min-feature", "min_feature_mm", type=Length(), help="Smallest dot or bead it makes: 0.4mm."),
    cloup.option("--mode", type=cloup.Choice(["as_printed", "add_only"]), help="[default: the printer's]"),
    cloup.option("--spurs", type=cloup.Choice(["metric", "paper"]), help="[default: metric]"),
    cloup.option("--keep-gaps", "keep_gaps_mm", type=Length(), help="Parts stay apart and holes open."),
)


@cloup.command()
@cloup.argument("source", metavar="IN", type=cloup.Path(path_type=Path))
@cloup.argument("fixed", metavar="[FIXED]", type=cloup.Path(path_type=Path), required=False)
@cloup.option("-o", "--output", "target", metavar="OUT.html", type=cloup.Path(path_type=Path), required=True)
@CORRECTION
@cloup.option_group("Pixels and layers (of a mesh, or of images that do not say)", *FRAME)
@cloup.option_group("A mesh as IN", *MESH)
@cloup.option_group("Running", WORKERS, FORCE, JSON)
def report(source: Path, fixed: Path | None, target: Path, printer: str | None, as_json: bool, **given: Any) -> None:
    """Write a page that shows every layer of IN before and after correction, and the part in 3D.

    IN is a mesh, a resin job or PNG images, as in `layerfix fix`. With FIXED, a file of the same layers, the page
    shows what differs between the two. The page is one file and opens from disk in any browser.

    \b
    Examples:
      layerfix report part.stl -p prusa-mk3s-0.4 -o report.html
      layerfix report job.sl1 fixed.sl1 -o report.html
    """
    with kernels_ready():
        from layerfix.commands import report as commands
    with progress(f"looking at {source.name}") as shown:
        written = commands.report(source, fixed, target, options_from(printer, given), shown)
    click.echo(json.dumps(asdict(written)) if as_json else rows_text(commands.lines_of(written)))


@cloup.command()
@cloup.argument("source", metavar="IN", type=cloup.Path(path_type=Path))
@cloup.option("-o", "--output", "target", metavar="OUT.png", type=cloup.Path(path_type=Path), required=True)
@cloup.option("--layer", "index", type=int, help="Which, counted from 0.")
@cloup.option("--strip", is_flag=True, help="Layers that change, up to 24 of them, small.")
@CORRECTION
@cloup.option_group(
    "Pixels and layers (of a mesh, or of images that do not say)",
    FRAME[0],
    cloup.option("--layer-height", "layer_mm", type=Length(), help="Layer height: 0.05mm."),
    FRAME[2],
)
@cloup.option_group("A mesh as IN", *MESH)
@cloup.option_group("Running", WORKERS, FORCE, JSON)
def show(
    source: Path, target: Path, index: int | None, strip: bool, printer: str | None, as_json: bool, **given: Any
) -> None:
    """Draw a layer of IN before and after correction, what changed and the skeleton; or many layers.

    \b
    Examples:
      layerfix show part.stl -p prusa-mk3s-0.4 --layer 12 -o layer.png
      layerfix show job.sl1 --min-feature 0.15mm --strip -o strip.png
    """
    if strip == (index is not None):
        raise InputError("give either --layer or --strip")
    with kernels_ready():
        from layerfix.commands import show as commands
    with progress(f"looking at {source.name}") as shown:
        done = commands.show(source, target, index, options_from(printer, given), shown)
    click.echo(json.dumps(asdict(done)) if as_json else rows_text(commands.lines_of(done)))
