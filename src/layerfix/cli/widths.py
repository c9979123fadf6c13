"""``layerfix widths``."""

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
        help="Where to: .3mf .gcode .csv .json .png .svg; may be given several times.",
    ),
    cloup.option(
        "--slicer",
        type=cloup.Choice(["prusa", "orca"]),
        help="Whose settings a .3mf holds: PrusaSlicer and SuperSlicer (default), or OrcaSlicer and Bambu Studio.",
    ),
)
@cloup.option_group(
    "Widths",
    PRINTER,
    cloup.option("--min", "min_mm", type=Length(), help="Narrowest width. [default: the printer's]"),
    cloup.option("--max", "max_mm", type=Length(), help="Widest width. [default: the printer's]"),
    cloup.option(
        "--step", "step_mm", type=Length(), default="0.05mm", show_default=True, help="Between widths tried."
    ),
    cloup.option("--loss", "loss_mm", type=Length(), help="Tips may come out blunter by this. [default: width / 4]"),
    cloup.option(
        "--rule",
        type=cloup.Choice(["opening", "thinning"]),
        help="By what the bead would lose, or by where thinning first leaves a line. [default: opening]",
    ),
    cloup.option("--bands", type=cloup.IntRange(1), default=6, show_default=True, help="At most so many by height."),
    cloup.option("--band-height", "band_height_mm", type=Length(), help="Lowest band. [default: five layers]"),
)
@cloup.option_group("Pixels and layers", *FRAME, *MESH)
@cloup.option_group("Running", WORKERS, FORCE, JSON)
def widths(source: Path, targets: tuple[Path, ...], printer: str | None, as_json: bool, **given: Any) -> None:
    """Suggest an extrusion width for every layer of IN, a mesh.

    The widest bead that prints a layer without losing or joining anything. Layers that are too thin for all widths
    get the narrowest and are listed: correct these (`layerfix fix`).

    \b
    Examples:
      layerfix widths part.stl -p prusa-mk3s-0.6 --min 0.6mm --max 1.2mm -o part.3mf
      layerfix widths part.stl -p prusa-mk3s-0.4 --bands 3 -o part.gcode -o widths.png -o widths.csv
    """
    with kernels_ready():
        from layerfix.commands import widths as width_job
    names = ("min_mm", "max_mm", "step_mm", "loss_mm", "rule", "bands", "band_height_mm", "slicer")
    wanted = {name: given.pop(name) for name in names}
    wanted["loss_mm"] = wanted["loss_mm"] or 0.0
    wanted["rule"] = wanted["rule"] or "opening"
    with progress(f"measuring {source.name}") as shown:
        options = options_from(printer, given)
        summary = width_job.suggest(source, targets, options, width_job.WidthOptions(**wanted), shown)
    click.echo(json.dumps(asdict(summary)) if as_json else rows_text(width_job.lines_of(summary)))
