"""The commands. Each parses, makes one call and prints; heavy imports wait until a command needs them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from layerfix import __version__
from layerfix.cli_types import Area, Length, Percent, Pitch, Range, Scale
from layerfix.errors import InputError
from layerfix.units import format_mm

if TYPE_CHECKING:
    from layerfix.commands.fix import Summary
    from layerfix.commands.options import Options


@cloup.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@cloup.version_option(__version__, prog_name="layerfix")
def layerfix() -> None:
    """Correct the layers of a 3D print so that thin walls and pins survive printing.

    \b
    Start here:
      layerfix demo                                      a built-in part, before and after
      layerfix check part.stl -p prusa-mk3s-0.4          what a printer would lose
      layerfix fix part.stl layers.zip -p prusa-sl1s     a mesh into corrected layer images
      layerfix printers                                  the printers it knows
    """


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
FORCE = cloup.option("--force", is_flag=True, help="Replace outputs that exist.")
JSON = cloup.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")


@layerfix.command()
@cloup.argument("source", metavar="IN", type=cloup.Path(path_type=Path))
@cloup.argument("target", metavar="OUT", type=cloup.Path(path_type=Path))
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
    "Outlines or a mesh as OUT (.svg .geojson .cli .stl .3mf)",
    cloup.option(
        "--tolerance",
        "tolerance_mm",
        type=Length(),
        help="How far simplification may move outlines. [default: half a pixel]",
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
)
@cloup.option_group(
    "Running",
    cloup.option("--layers", type=Range(), help="Only these layers, counted from 0: 12, or 10:20."),
    cloup.option("--picture", type=cloup.Path(path_type=Path), help="Also draw the most changed layer (.png)."),
    WORKERS,
    FORCE,
    JSON,
)
def fix(source: Path, target: Path, printer: str | None, as_json: bool, **given: Any) -> None:
    """Correct IN and write the layers to OUT.

    IN is a mesh (.stl .obj .ply .off .3mf .glb .gltf), a resin job (.sl1 .sl1s .m1 .goo .ctb .photon .cbddlp
    .nanodlp .cws, Chitubox .zip), or PNG images (a folder, .zip or .png). OUT is a job of the same kind as IN; a
    new .sl1, .sl1s or .goo; a folder (no suffix) or .zip of PNG images; .gcode; a .3mf or .stl mesh of the
    corrected layers for any slicer; or their outlines as .svg, .geojson or .cli. `layerfix formats` lists them all.

    \b
    Examples:
      layerfix fix part.stl part.gcode -p prusa-mk3s-0.4
      layerfix fix part.stl fixed.3mf -p prusa-mk3s-0.4
      layerfix fix part.stl layers -p prusa-sl1s
      layerfix fix part.3mf layers.zip --pixel 50um --layer 0.05mm --min-feature 0.4mm
      layerfix fix job.sl1 fixed.sl1 --min-feature 0.15mm
      layerfix fix layers.zip fixed.zip --min-feature 0.15mm --mode add_only
    """
    with _kernels_ready():
        from layerfix.commands.fix import fix as run
        from layerfix.formats import load_kernels

        load_kernels(target)
    with _progress(f"correcting {source.name}") as progress:
        summary = run(source, target, _options(printer, given), progress)
    click.echo(json.dumps(asdict(summary)) if as_json else _table(summary))


@layerfix.command()
@cloup.argument("source", metavar="IN", type=cloup.Path(path_type=Path))
@cloup.option_group(
    "Printer and correction",
    PRINTER,
    cloup.option("--min-feature", "min_feature_mm", type=Length(), help="Smallest dot or bead it makes: 0.4mm."),
    cloup.option("--mode", type=cloup.Choice(["as_printed", "add_only"]), help="How it would be corrected."),
)
@cloup.option_group("Pixels and layers (of a mesh, or of images that do not say)", *FRAME)
@cloup.option_group("A mesh as IN", *MESH)
@cloup.option_group(
    "Running",
    cloup.option("--markdown", is_flag=True, help="Print a table for a pull request."),
    WORKERS,
    JSON,
)
def check(source: Path, printer: str | None, as_json: bool, markdown: bool, **given: Any) -> None:
    """Say what the printer would lose of IN, and where; nothing is written.

    IN is a mesh, a resin job or PNG images, as in `layerfix fix`. Ends with 1 if something would be lost, with 0 if
    not, with 2 if it cannot be read.

    \b
    Examples:
      layerfix check part.stl -p prusa-mk3s-0.4
      layerfix check job.sl1 --min-feature 0.15mm --json
    """
    if as_json and markdown:
        raise InputError("--json and --markdown: one of the two")
    with _kernels_ready():
        from layerfix.commands import check as commands
    with _progress(f"checking {source.name}") as progress:
        verdict = commands.check(source, _options(printer, given), progress)
    if as_json:
        click.echo(json.dumps(asdict(verdict)))
    else:
        click.echo(commands.markdown_of(verdict) if markdown else _rows(commands.lines_of(verdict)))
    if not verdict.ok:
        raise click.exceptions.Exit(1)


@layerfix.command()
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
    with _kernels_ready():
        from layerfix.commands import widths as width_job
    names = ("min_mm", "max_mm", "step_mm", "loss_mm", "rule", "bands", "band_height_mm", "slicer")
    wanted = {name: given.pop(name) for name in names}
    wanted["loss_mm"] = wanted["loss_mm"] or 0.0
    wanted["rule"] = wanted["rule"] or "opening"
    with _progress(f"measuring {source.name}") as progress:
        options = _options(printer, given)
        summary = width_job.suggest(source, targets, options, width_job.WidthOptions(**wanted), progress)
    click.echo(json.dumps(asdict(summary)) if as_json else _rows(width_job.lines_of(summary)))


@layerfix.command()
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
    with _kernels_ready():
        from layerfix.commands.draw import draw_gcode
    drawn = draw_gcode(source, target, index, force=force)
    click.echo(json.dumps(drawn) if as_json else _rows([(name, str(value)) for name, value in drawn.items()]))


@layerfix.command()
@cloup.argument("folder", metavar="[DIR]", type=cloup.Path(path_type=Path), default=Path("layerfix-demo"))
@cloup.option("--force", is_flag=True, help="Replace DIR if it exists.")
@JSON
def demo(folder: Path, force: bool, as_json: bool) -> None:
    """Correct a built-in test part and draw it before and after.

    Writes the part, its layers before and after, and a picture to DIR (layerfix-demo).
    """
    with _kernels_ready():
        from layerfix.commands.demo import run_demo, what_to_look_at
    with _progress("correcting the test part") as progress:
        summary = run_demo(folder, force=force, progress=progress)
    click.echo(json.dumps(asdict(summary)) if as_json else f"{_table(summary)}\n\n{what_to_look_at(folder)}")


@layerfix.group(invoke_without_command=True)
@cloup.option("--process", type=cloup.Choice(["resin", "fdm", "powder"]), help="Only these.")
@cloup.option("--search", metavar="TEXT", default="", help="Only those with TEXT in maker, model or name.")
@cloup.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
@cloup.pass_context
def printers(ctx: click.Context, process: str | None, search: str, as_json: bool) -> None:
    """List the printers that --printer takes, or show one.

    A line has the name, maker and model, process, pixels or nozzle, and the minimum printable feature.

    \b
    Examples:
      layerfix printers --search "elegoo saturn"
      layerfix printers show prusa-sl1s
    """
    from layerfix.printers import find_printers, listing

    if ctx.invoked_subcommand:
        if process or search or as_json:
            raise click.UsageError(f"options of '{ctx.invoked_subcommand}' go after it", ctx)
        return
    found = find_printers(process, search)
    if as_json:
        click.echo(json.dumps([asdict(p) for p in found]))
    else:
        click.echo("\n".join(listing(found)) or "no such printer", err=not found)


@printers.command("show")
@cloup.argument("name")
@cloup.option("--json", "as_json", is_flag=True, help="Print the values as JSON.")
def show_printer(name: str, as_json: bool) -> None:
    """Show all that is known of a printer.

    NAME is one of those that `layerfix printers` lists, or your own .toml file.
    """
    from layerfix.printers import description, load_printer

    printer = load_printer(name)
    click.echo(json.dumps(asdict(printer)) if as_json else "\n".join(description(printer)))


@layerfix.command()
@JSON
def formats(as_json: bool) -> None:
    """List the kinds of files: what is read, what is written, and which options go with it."""
    from layerfix.commands.formats import lines_of, list_formats

    found = list_formats()
    click.echo(json.dumps(found) if as_json else "\n".join(lines_of(found)))


@layerfix.command()
@cloup.argument("shell", type=cloup.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of a shell.

    \b
    bash:  eval "$(layerfix completion bash)"       in ~/.bashrc
    zsh:   eval "$(layerfix completion zsh)"        in ~/.zshrc
    fish:  layerfix completion fish | source        in ~/.config/fish/config.fish
    """
    from click.shell_completion import get_completion_class

    found = get_completion_class(shell)
    if found is None:
        raise InputError(f"no completion for {shell}")
    click.echo(found(layerfix, {}, "layerfix", "_LAYERFIX_COMPLETE").source())


def _options(printer: str | None, given: dict[str, Any]) -> Options:
    """What was given, sorted by whom it belongs to."""
    from layerfix.commands.options import options_of
    from layerfix.printers import load_printer

    if given.get("bits"):
        given["bits"] = int(given["bits"])
    return options_of(load_printer(printer) if printer else None, given)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with the time left on a terminal; nothing in a pipe."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    stopped = click.get_current_context().obj
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)

        def show(done: int, total: int) -> None:
            _abort_if(stopped)
            bar.update(task, description=what, completed=done, total=total)

        if not console.is_terminal:
            yield show
            return
        from layerfix.kernels import compiling_told

        with compiling_told(lambda _: bar.update(task, description="compiling kernels (once) …")):
            yield show


@contextmanager
def _kernels_ready() -> Iterator[None]:
    """Say so if the block takes long: the first run on a machine compiles the kernels and keeps them."""
    from rich.console import Console

    console = Console(stderr=True)
    stopped = click.get_current_context().obj
    if not console.is_terminal:
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


def _table(s: Summary) -> str:
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
    return _rows(rows)


def _thinnest(s: Summary) -> str:
    """With its precision, which is half a pixel."""
    assert s.thinnest_mm is not None
    if s.hairline_layers and s.thinnest_mm <= min(s.pixel_mm) * 1.01:
        return f"under {format_mm(min(s.pixel_mm))}"
    return f"{format_mm(round(s.thinnest_mm, 4))} (± {format_mm(max(s.pixel_mm) / 2)})"


def _rows(rows: Sequence[tuple[str, str]]) -> str:
    width = max(10, *(len(name) + 1 for name, _ in rows))
    return "\n".join(f"{name:{width}}{value}" for name, value in rows)
