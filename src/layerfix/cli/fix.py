"""``layerfix fix``."""

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
    SCHEDULER,
    WORKERS,
    kernels_ready,
    options_from,
    progress,
    summary_table,
)
from layerfix.cli.types import Area, Length, Percent, Range
from layerfix.console import one_line


@cloup.command()
@cloup.argument("source", metavar="IN", type=cloup.Path(path_type=Path))
@cloup.argument("more", metavar="OUT", nargs=-1, type=cloup.Path(path_type=Path))
@cloup.option_group(
    "Printer and correction",
    PRINTER,
    cloup.option("--min-feature", "min_feature_mm", type=Length(), help="Smallest dot or bead it makes: 0.4mm."),
    cloup.option(
        "--mode",
        type=cloup.Choice(["as_printed", "add_only"]),
        help="as_printed rounds corners as the tool does; add_only never removes. [default: the printer's]",
    ),
    cloup.option(
        "--spurs",
        type=cloup.Choice(["metric", "paper"]),
        help="How far thin features reach: measured, at every angle alike, or as the paper counts. [default: metric]",
    ),
    cloup.option(
        "--first-layer-min-feature", "first_layer_min_feature_mm", type=Length(), help="The same of the first layer."
    ),
    cloup.option(
        "--ignore-below", "ignore_below_mm2", type=Area(), help="Leave smaller specks as they are: 0.01mm2."
    ),
    cloup.option(
        "--ignore-specks",
        is_flag=True,
        default=None,
        help="Leave parts with nothing below and nothing above as they are.",
    ),
    cloup.option(
        "--min-layers", type=cloup.IntRange(1, 100), help="What is of fewer layers becomes so many high. [default: 1]"
    ),
    cloup.option(
        "--keep-gaps", "keep_gaps_mm", type=Length(), help="Parts stay apart and holes open, by at least so much."
    ),
    cloup.option(
        "--keep-out",
        type=cloup.Path(path_type=Path),
        help="A mesh (or layers) to add nothing in: bores, mating faces. Material goes to the other side.",
    ),
    cloup.option(
        "--grow",
        type=cloup.Choice(["both", "inward", "outward"]),
        help="outward: holes stay; inward: the outside does.",
    ),
)
@cloup.option_group("Pixels and layers (of a mesh, or of images that do not say)", *FRAME)
@cloup.option_group(
    "A mesh as IN",
    *MESH,
    cloup.option(
        "--orient",
        is_flag=False,
        flag_value="race",
        type=cloup.Choice(["race", "quick", "anneal", "direct"]),
        help="Turn it first, to where it needs the least correction and fits: see `layerfix orient`.",
    ),
    cloup.option(
        "--axes",
        metavar="xyz",
        help="What is thin along x or y, which layers cannot see, is thickened first: xyz, xz, yz. [default: z]",
    ),
    cloup.option(
        "--fill",
        type=cloup.Choice(["nonzero", "even_odd", "positive"]),
        help="Which parts of overlapping shells are solid. [default: nonzero]",
    ),
    cloup.option(
        "--z-sampling",
        type=cloup.Choice(["rescue", "middle", "overlap"]),
        help="rescue: mid-planes, and what they miss; middle: mid-planes alone; overlap: what fills half a layer."
        " [default: rescue]",
    ),
    cloup.option("--min-overlap", type=Percent(), help="How much of a layer, for overlap. [default: 50%]"),
    cloup.option(
        "--antialias/--no-antialias",
        default=None,
        help="Greys in images and jobs: how much of a pixel is covered. [default: as the printer's panel]",
    ),
)
@cloup.option_group(
    "Images or a job as IN",
    cloup.option("--threshold", type=cloup.IntRange(1, 255), help="Grey value that is solid. [default: 128]"),
    cloup.option(
        "--grey-floor",
        type=cloup.IntRange(0, 255),
        help="Grey value of strokes that count though they nowhere reach the threshold; 0: never. [default: 32]",
    ),
)
@cloup.option_group("PNG images as OUT", cloup.option("--bits", type=cloup.Choice(["1", "8"]), help="[default: 8]"))
@cloup.option_group(
    "A mesh as OUT (.stl .3mf .obj .ply .glb)",
    cloup.option(
        "--surface",
        type=cloup.Choice(["smooth", "voxels", "layers"]),
        help="smooth: IN with what was thin thicker, its own facets elsewhere; voxels: the boundary of the pixels;"
        " layers: outlines, one on the other. [default: smooth of a mesh, else layers]",
    ),
    cloup.option("--smooth", is_flag=True, default=None, help="Voxels without stairs; no pixel changes."),
    cloup.option(
        "--only-changes",
        is_flag=True,
        default=None,
        help="Only what was added (red) and removed (blue), for .3mf, .ply and .glb.",
    ),
)
@cloup.option_group(
    "Outlines or a mesh as OUT (.svg .geojson .cli, and meshes)",
    cloup.option(
        "--tolerance",
        "tolerance_mm",
        type=Length(),
        help="How far simplification may move outlines and surfaces. [default: half a pixel; of voxels nothing]",
    ),
    cloup.option("--ascii", is_flag=True, default=None, help="Text instead of binary, for .cli."),
)
@cloup.option_group(
    "G-code as OUT",
    cloup.option("--width", "width_mm", type=Length(), help="Extrusion width. [default: the printer's]"),
    cloup.option("--perimeters", type=cloup.IntRange(1), help="Loops along the outline. [default: 2]"),
    cloup.option("--infill", "density", type=Percent(), help="Density of the sparse infill. [default: 20%]"),
    cloup.option("--seam", type=cloup.Choice(["nearest", "rear", "random"]), help="Where loops start."),
    cloup.option("--skirt", "skirt_loops", type=cloup.IntRange(0), help="Loops round the part. [default: 1]"),
    cloup.option(
        "--start-gcode", type=cloup.Path(path_type=Path), help="File with what comes before the first layer."
    ),
    cloup.option("--end-gcode", type=cloup.Path(path_type=Path), help="File with what comes after the last layer."),
)
@cloup.option_group(
    "Running",
    cloup.option("--layers", type=Range(), help="Only these layers, counted from 0: 12, or 10:20."),
    cloup.option("--picture", type=cloup.Path(path_type=Path), help="Also draw the most changed layer (.png)."),
    cloup.option("--report", type=cloup.Path(path_type=Path), help="Also write a page to look at (.html)."),
    WORKERS,
    FORCE,
    JSON,
)
@cloup.option_group(
    "Many files: layerfix fix IN IN … --out-dir DIR",
    cloup.option("--out-dir", metavar="DIR", type=cloup.Path(path_type=Path), help="Each result under its own name."),
    cloup.option(
        "--out-type", metavar="SUFFIX", help="What is written: 3mf, gcode, zip … [default: as IN or the printer]"
    ),
)
@cloup.option_group("Many machines: a file is a task, of one file a slab of its layers", SCHEDULER)
def fix(
    source: Path,
    more: tuple[Path, ...],
    printer: str | None,
    as_json: bool,
    out_dir: Path | None,
    out_type: str | None,
    scheduler: str | None,
    **given: Any,
) -> None:
    """Correct IN and write the layers to OUT.

    IN is a mesh (.stl .obj .ply .off .3mf .glb .gltf), a resin job (.sl1 .sl1s .m1 .goo .ctb .photon .cbddlp
    .nanodlp .cws, Chitubox .zip), or PNG images (a folder, .zip or .png). OUT is a job of the same kind as IN; a
    new .sl1, .sl1s or .goo; a folder (no suffix) or .zip of PNG images; .gcode; a mesh for any slicer or service
    (.stl .3mf .obj .ply .glb); or their outlines as .svg, .geojson or .cli. `layerfix formats` lists them all.

    \b
    Examples:
      layerfix fix part.stl part.gcode -p prusa-mk3s-0.4
      layerfix fix part.stl fixed.3mf -p prusa-mk3s-0.4
      layerfix fix part.stl layers -p prusa-sl1s
      layerfix fix part.3mf layers.zip --pixel 50um --layer 0.05mm --min-feature 0.4mm
      layerfix fix job.sl1 fixed.sl1 --min-feature 0.15mm
      layerfix fix layers.zip fixed.zip --min-feature 0.15mm --mode add_only
      layerfix fix a.stl b.stl c.stl --out-dir fixed -p prusa-sl1s
    """
    if out_dir is not None:
        _fix_many([source, *more], out_dir, out_type, scheduler, printer, as_json, given)
        return
    if out_type is not None:
        raise click.UsageError("--out-type goes with --out-dir")
    if not more:
        raise click.UsageError("Missing argument 'OUT'.")
    if len(more) > 1:
        extra = " ".join(str(path) for path in more[1:])
        raise click.UsageError(f"Got unexpected extra arguments ({extra}). Several inputs go with --out-dir DIR.")
    target = more[0]
    with kernels_ready():
        from layerfix.commands.project import fix_file as run
        from layerfix.formats import load_kernels

        load_kernels(target)
    with progress(f"correcting {source.name}") as shown:
        summary = run(source, target, options_from(printer, {**given, "scheduler": scheduler}), shown)
    click.echo(json.dumps(asdict(summary)) if as_json else summary_table(summary))


def _fix_many(
    sources: list[Path],
    folder: Path,
    out_type: str | None,
    scheduler: str | None,
    printer: str | None,
    as_json: bool,
    given: dict[str, Any],
) -> None:
    """Each into the folder; ends with 2 if one could not be corrected."""
    with kernels_ready():
        from layerfix.commands.batch import fix_all
    suffix = None if out_type is None else "" if out_type == "folder" else out_type
    with progress(f"correcting {len(sources)} files") as shown:
        batch = fix_all(sources, folder, options_from(printer, given), suffix, scheduler, shown)
    if as_json:
        failed = [{"source": source, "error": reason} for source, reason in batch.failed]
        click.echo(json.dumps({"done": [asdict(summary) for summary in batch.done], "failed": failed}))
    elif batch.done:
        click.echo("\n\n".join(map(summary_table, batch.done)))
    for _, reason in batch.failed:
        click.echo(f"layerfix: {one_line(reason)}", err=True)
    if batch.failed:
        raise click.exceptions.Exit(2)
