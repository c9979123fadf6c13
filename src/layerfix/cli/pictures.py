"""``layerfix draw`` and ``layerfix demo``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click
import cloup

from layerfix.cli.shared import FORCE, JSON, kernels_ready, progress, rows_text, summary_table


@cloup.command()
@cloup.argument("source", metavar="IN.gcode", type=cloup.Path(path_type=Path))
@cloup.argument("target", metavar="OUT", type=cloup.Path(path_type=Path))
@cloup.option("--layer", "index", type=cloup.IntRange(0), default=0, show_default=True, help="Which, counted from 0.")
@FORCE
@JSON
def draw(source: Path, target: Path, index: int, force: bool, as_json: bool) -> None:
    """Draw the beads of one layer of a G-code file, of any slicer, as .png or .svg.

    \b
    Example:
      layerfix draw part.gcode layer.png --layer 12
    """
    with kernels_ready():
        from layerfix.commands.draw import draw_gcode
    drawn = draw_gcode(source, target, index, force=force)
    click.echo(json.dumps(drawn) if as_json else rows_text([(name, str(value)) for name, value in drawn.items()]))


@cloup.command()
@cloup.argument("folder", metavar="[DIR]", type=cloup.Path(path_type=Path), default=Path("layerfix-demo"))
@cloup.option("--force", is_flag=True, help="Replace DIR if it exists.")
@JSON
def demo(folder: Path, force: bool, as_json: bool) -> None:
    """Correct a built-in test part and draw it before and after.

    Writes the part, its layers before and after, and a picture to DIR (layerfix-demo).
    """
    with kernels_ready():
        from layerfix.commands.demo import run_demo, what_to_look_at
    with progress("correcting the test part") as shown:
        summary = run_demo(folder, force=force, progress=shown)
    click.echo(json.dumps(asdict(summary)) if as_json else f"{summary_table(summary)}\n\n{what_to_look_at(folder)}")
