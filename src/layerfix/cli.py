"""The commands. Each parses, makes one call and prints; heavy imports wait until a command needs them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from layerfix import __version__
from layerfix.errors import InputError
from layerfix.units import format_mm, parse_length_mm

if TYPE_CHECKING:
    from layerfix.commands.fix import Options, Summary


class Length(click.ParamType[float]):
    """A length with a unit, in mm."""

    name = "length"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            return parse_length_mm(value)
        except InputError as problem:
            self.fail(str(problem), param, ctx)


class Pitch(click.ParamType[tuple[float, float]]):
    """One length, or two with an x between them: ``19umx24um``."""

    name = "pitch"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        parts = str(value).lower().replace("×", "x").split("x")
        if len(parts) > 2:
            self.fail(f"'{value}' is not a pitch: write 50um, or 19umx24um", param, ctx)
        sizes = [Length().convert(part, param, ctx) for part in parts]
        return sizes[0], sizes[-1]


class Range(click.ParamType[tuple[int, int]]):
    """Layers, counted from 0: ``12`` is one, ``10:20`` are ten."""

    name = "range"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        first, colon, stop = str(value).partition(":")
        try:
            found = int(first or 0), (int(stop) if stop else 1 << 30) if colon else int(first) + 1
        except ValueError:
            self.fail(f"'{value}' is not a range of layers: write 12, or 10:20", param, ctx)
        if not 0 <= found[0] < found[1]:
            self.fail(f"'{value}' holds no layer: they are counted from 0, and 10:20 ends before 20", param, ctx)
        return found


class Percent(click.ParamType[float]):
    """``20%``, ``20`` or ``0.2``, as 0.2."""

    name = "percent"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value).strip()
        try:
            share = float(text.removesuffix("%"))
            share /= 100 if text.endswith("%") or share > 1 else 1
        except ValueError:
            self.fail(f"'{value}' is not a share: write 20%, or 0.2", param, ctx)
        if not 0 <= share <= 1:
            self.fail(f"'{value}' is not between 0 % and 100 %: write 20%, or 0.2", param, ctx)
        return share


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="layerfix")
def layerfix() -> None:
    """Correct the layers of a 3D print so that thin walls and pins survive printing.

    \b
    Start here:
      layerfix demo                                      a built-in part, before and after
      layerfix fix part.stl layers.zip -p prusa-sl1s     a mesh into corrected layer images
      layerfix printers                                  the printers it knows
    """


@layerfix.command()
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("-p", "--printer", metavar="NAME", help="A printer of `layerfix printers`, or your own .toml file.")
@click.option("--pixel", "pixel_mm", type=Pitch(), help="Pixel pitch: 50um, or 19umx24um.")
@click.option("--layer", "layer_mm", type=Length(), help="Layer height: 0.05mm.")
@click.option("--first-layer", "first_layer_mm", type=Length(), help="Height of the first layer, if it differs.")
@click.option("--min-feature", "min_feature_mm", type=Length(), help="Smallest dot or bead the printer makes: 0.4mm.")
@click.option(
    "--mode",
    type=click.Choice(["as_printed", "add_only"]),
    help="as_printed rounds corners as the tool does; add_only never removes. [default: the printer's]",
)
@click.option(
    "--fill",
    type=click.Choice(["nonzero", "even_odd", "positive"]),
    default="nonzero",
    show_default=True,
    help="Which parts of overlapping shells are solid.",
)
@click.option("--unit", help="What one unit of the mesh is: mm, in, m … [default: as the file says, else mm]")
@click.option(
    "--bits",
    type=click.Choice(["1", "8"]),
    default="8",
    show_default=True,
    help="Bits a pixel of PNG images.",
)
@click.option(
    "--threshold",
    type=click.IntRange(1, 255),
    default=128,
    show_default=True,
    help="Grey value of an image from which a pixel is solid.",
)
@click.option(
    "--grey-floor",
    type=click.IntRange(0, 255),
    default=32,
    show_default=True,
    help="Grey value from which a stroke is a feature that nowhere reaches the threshold; 0: never.",
)
@click.option("--layers", type=Range(), help="Only these layers, counted from 0: 12, or 10:20.")
@click.option(
    "--tolerance",
    "tolerance_mm",
    type=Length(),
    help="How far simplification may move outlines and meshes. [default: half a pixel]",
)
@click.option("--ascii", is_flag=True, help="Text instead of binary, for .cli.")
@click.option("--width", "width_mm", type=Length(), help="G-code: extrusion width. [default: the printer's]")
@click.option("--perimeters", type=click.IntRange(1), help="G-code: loops along the outline. [default: 2]")
@click.option("--infill", "density", type=Percent(), help="G-code: density of the sparse infill. [default: 20%]")
@click.option("--seam", type=click.Choice(["nearest", "rear", "random"]), help="G-code: where loops start.")
@click.option("--skirt", "skirt_loops", type=click.IntRange(0), help="G-code: loops round the part. [default: 1]")
@click.option(
    "--picture", type=click.Path(path_type=Path), help="Also draw the most changed layer, before and after."
)
@click.option("--workers", type=click.IntRange(1), help="Threads. [default: one per core]")
@click.option("--force", is_flag=True, help="Replace OUT if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def fix(source: Path, target: Path, as_json: bool, **given: Any) -> None:
    """Correct IN and write the layers to OUT.

    IN is a mesh (.stl .obj .ply .off .3mf .glb), a resin job (.sl1 .sl1s .m1 .goo .ctb .photon .cbddlp
    .nanodlp .cws, Chitubox .zip), or a folder or zip of PNG images. OUT is a job of the same kind as IN; a new
    .sl1, .sl1s or .goo; a folder (no suffix) or .zip of PNG images; .gcode; a .3mf or .stl mesh of the corrected
    layers for any slicer; or their outlines as .svg, .geojson or .cli (Common Layer Interface).

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
        from layerfix.commands import fix as job

        job.load_kernels(target)
    options = _options(given)
    with _progress(f"correcting {source.name}") as progress:
        summary = job.fix(source, target, options, progress)
    click.echo(json.dumps(asdict(summary)) if as_json else _table(summary))


@layerfix.command()
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.option(
    "-p", "--printer", metavar="NAME", help="An FDM printer of `layerfix printers`, or your own .toml file."
)
@click.option(
    "-o",
    "--output",
    "targets",
    metavar="OUT",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Where to: .3mf .gcode .csv .json .png .svg; may be given several times.",
)
@click.option("--min", "min_mm", type=Length(), help="Narrowest width. [default: the printer's]")
@click.option("--max", "max_mm", type=Length(), help="Widest width. [default: the printer's]")
@click.option("--step", "step_mm", type=Length(), default="0.05mm", show_default=True, help="Between widths tried.")
@click.option("--loss", "loss_mm", type=Length(), help="Tips may come out blunter by this. [default: a quarter bead]")
@click.option(
    "--bands", type=click.IntRange(1), default=6, show_default=True, help="At most so many widths by height."
)
@click.option("--band-height", "band_height_mm", type=Length(), help="Lowest band. [default: five layers]")
@click.option(
    "--slicer",
    type=click.Choice(["prusa", "orca"]),
    default="prusa",
    show_default=True,
    help="Whose settings a .3mf holds: PrusaSlicer and SuperSlicer, or OrcaSlicer and Bambu Studio.",
)
@click.option("--layer", "layer_mm", type=Length(), help="Layer height. [default: the printer's]")
@click.option("--first-layer", "first_layer_mm", type=Length(), help="Height of the first layer, if it differs.")
@click.option("--pixel", "pixel_mm", type=Pitch(), help="Pixel pitch. [default: an eighth of the nozzle]")
@click.option("--unit", help="What one unit of the mesh is: mm, in, m … [default: as the file says, else mm]")
@click.option("--workers", type=click.IntRange(1), help="Threads. [default: one per core]")
@click.option("--force", is_flag=True, help="Replace outputs that exist.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
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
        from layerfix.commands.fix import Options
        from layerfix.printers import load_printer
    names = ("min_mm", "max_mm", "step_mm", "loss_mm", "bands", "band_height_mm", "slicer")
    wanted = {name: given.pop(name) for name in names}
    wanted["loss_mm"] = wanted["loss_mm"] or 0.0
    given["workers"] = given["workers"] or 0
    options = Options(printer=load_printer(printer) if printer else None, **given)
    with _progress(f"measuring {source.name}") as progress:
        summary = width_job.suggest(source, targets, options, width_job.WidthOptions(**wanted), progress)
    click.echo(json.dumps(asdict(summary)) if as_json else _rows(width_job.lines_of(summary)))


@layerfix.command()
@click.argument("source", metavar="IN.gcode", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--layer", "index", type=click.IntRange(0), default=0, show_default=True, help="Which, counted from 0.")
@click.option("--force", is_flag=True, help="Replace OUT if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print what was drawn as JSON.")
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
@click.argument("folder", metavar="[DIR]", type=click.Path(path_type=Path), default=Path("layerfix-demo"))
@click.option("--force", is_flag=True, help="Replace DIR if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
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
@click.option("--process", type=click.Choice(["resin", "fdm", "powder"]), help="Only these.")
@click.option("--search", metavar="TEXT", default="", help="Only those with TEXT in maker, model or name.")
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
@click.pass_context
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
@click.argument("name")
@click.option("--json", "as_json", is_flag=True, help="Print the values as JSON.")
def show_printer(name: str, as_json: bool) -> None:
    """Show all that is known of a printer.

    NAME is one of those that `layerfix printers` lists, or your own .toml file.
    """
    from layerfix.printers import description, load_printer

    printer = load_printer(name)
    click.echo(json.dumps(asdict(printer)) if as_json else "\n".join(description(printer)))


@layerfix.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
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


def _options(given: dict[str, Any]) -> Options:
    from layerfix.commands.fix import Options
    from layerfix.printers import load_printer

    printer = load_printer(given.pop("printer")) if given.get("printer") else given.pop("printer", None)
    return Options(printer=printer, bits=int(given.pop("bits")), workers=given.pop("workers") or 0, **given)


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
            bar.update(task, completed=done, total=total)

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
         else f"{format_mm(s.thinnest_mm)} at z = {s.thinnest_z_mm:.3f} mm"),
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


def _rows(rows: Sequence[tuple[str, str]]) -> str:
    width = max(10, *(len(name) + 1 for name, _ in rows))
    return "\n".join(f"{name:{width}}{value}" for name, value in rows)
