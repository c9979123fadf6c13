"""The whole line as one call: open what the user names, correct it, write it, and add up what happened."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from layerfix.commands.machines import hint_of, job_printers, told_of_heights, told_of_machine
from layerfix.commands.mesh_file import mesh_in
from layerfix.commands.notes import doubts
from layerfix.commands.options import Options, flag, min_feature_of, refuse_given
from layerfix.commands.pages import check_page
from layerfix.commands.part import Placing, check_more_than_a_dot, open_part
from layerfix.commands.summary import Summary, add_up
from layerfix.errors import InputError, OutputError
from layerfix.files import already_written, check_apart, check_input, check_target, whole_file
from layerfix.formats import (
    check_before,
    check_options,
    find_format,
    find_writer,
    holds_greys,
    options_for_layers,
    read,
    write,
)
from layerfix.layers.correction import correct
from layerfix.mesh.empty import empty_ends
from layerfix.mesh.slicing import plate_mm, slice_like, sliced_mesh
from layerfix.units import counted, format_mm

if TYPE_CHECKING:
    from layerfix.layers.correction import Mode
    from layerfix.mesh.triangles import Mesh
    from layerfix.printers import Printer
    from layerfix.stack import Layer, LayerStack
    from layerfix.surface.kinds import Kind


def fix(
    source: Path,
    target: Path,
    options: Options,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Summary:
    """Correct `source` (a mesh, a job, images) into `target`.

    progress is called with (layers done, layers in all).
    Raises InputError and OutputError before any work where it can; then nothing is written.
    """
    started = time.perf_counter()
    check_paths(source, target, options)
    check_before(target, options.printer, options.output)
    check_options(target, options.output, options_for_layers(target), flag)
    paths = options.path_settings()
    stack, placed = opened(source, _antialiased(source, target, options), progress)
    check_options(target, options.output, find_writer(target, stack).takes, flag)
    min_feature_mm = min_feature_of(options, lambda: hint_of(source, job_printers(stack)))
    mesh = sliced_mesh(stack)
    if mesh is not None:
        check_more_than_a_dot(mesh, min_feature_mm)
    surface = _surface(target, stack, options)
    mode = _mode(target, stack, surface, options)
    if options.run.layers is not None:
        stack = _chosen(source, stack, options.run.layers)
    tolerance_mm = options.output.get("tolerance_mm")
    if tolerance_mm is not None and tolerance_mm > min_feature_mm:
        raise InputError(
            f"tolerance {format_mm(tolerance_mm)} is larger than the minimum feature of"
            f" {format_mm(min_feature_mm)}: it would take away what was corrected"
        )
    told = [*doubts(tolerance_mm, paths, min_feature_mm), *_doubts_of(stack, options)]
    told += _told_of_surface(surface, mesh, options)
    fixed = as_asked(stack, placed, mode, options)
    done: list[Layer] = []

    def watch(index: int, layer: Layer) -> None:
        done.append(layer)
        progress(index + 1, len(fixed))

    run = options.run
    output = dict(options.output) if surface is None else {**options.output, "surface": surface}
    with _made_there(fixed, surface, options) as layers:
        write(target, layers, options.printer, force=run.force, watch=watch, tell=told.append, advance=progress,
              **output)  # fmt: skip
    summary = add_up(source, target, fixed, min_feature_mm, mode, done, started, told)
    if run.report:
        from layerfix.commands.pages import report_on

        with already_written(target):
            report_on(source, stack, fixed, run.report, options, mode, placed=placed, progress=progress)
    if run.picture:
        with already_written(target):
            draw_layer(stack, fixed, summary.most_changed_layer, run.picture, force=run.force)
    return summary


def _made_there(fixed: LayerStack, surface: Kind | None, options: Options) -> AbstractContextManager[LayerStack]:
    """The layers, made on the workers of a scheduler if there is one. Raises InputError for what goes only here."""
    if options.run.scheduler is None:
        return nullcontext(fixed)
    if surface in ("smooth", "voxels"):
        raise InputError(
            f"--scheduler spreads the layers of one file, and the {surface} surface is of all of them at once: leave"
            " --scheduler out, take --surface layers, or give the file with --out-dir, where files are spread"
        )
    free = options.correction.keep_out
    if free is not None and find_format(free)[0].mesh is None:
        raise InputError(f"--keep-out {free}: layers stay on this machine; with --scheduler give a mesh")
    from layerfix.commands.slabs import on_workers

    return on_workers(fixed, options.run.scheduler)


def as_asked(stack: LayerStack, placed: Placing | None, mode: Mode, options: Options) -> LayerStack:
    """The layers corrected as the options say. Raises InputError as `correct` does.

    placed: how the part was turned and moved after it was read (`Part.placed`)
    """
    how, min_feature_mm = options.correction, min_feature_of(options)
    first_mm = how.first_layer_min_feature_mm if not (options.run.layers or (0,))[0] else None
    return correct(
        stack,
        min_feature_mm=min_feature_mm if first_mm is None else [first_mm, *[min_feature_mm] * (len(stack) - 1)],
        mode=mode,
        spurs=how.spurs or "metric",
        ignore_below_mm2=how.ignore_below_mm2 or 0.0,
        ignore_specks=bool(how.ignore_specks),
        keep_gaps_mm=how.keep_gaps_mm,
        keep_out=_keep_out(stack, placed, options),
        grow=how.grow or "both",
        min_layers=how.min_layers or 1,
    ).with_workers(options.run.workers)


def _surface(target: Path, stack: LayerStack, options: Options) -> Kind | None:
    """Which surface a target is written as; None if it is none. Raises InputError for one that cannot be."""
    if "surface" not in options_for_layers(target):
        return None
    given, output, how = options.output.get("surface"), options.output, options.correction
    if given is None and (output.get("smooth") or output.get("only_changes")):
        return "voxels"
    to_the_pixel = _to_the_pixel(options)
    if given is None:
        from layerfix.surface.kinds import keeps_a_mesh

        taken = how.mode == "as_printed" or to_the_pixel or options.run.layers is not None
        return "smooth" if not taken and keeps_a_mesh(stack) else "layers"
    if given == "smooth" and to_the_pixel:
        raise InputError("--surface smooth: what is kept free or raised is so to the pixel; take --surface voxels")
    if given == "smooth" and options.run.layers is not None:
        raise InputError("--surface smooth is of all layers; take --surface voxels for some")
    kind: Kind = given
    return kind


def _to_the_pixel(options: Options) -> list[str]:
    """The options given that keep free or raise something to the pixel, which no smooth surface does."""
    how = options.correction
    given = {
        "--keep-gaps": how.keep_gaps_mm is not None,
        "--keep-out": how.keep_out is not None,
        "--min-layers": (how.min_layers or 1) > 1,
    }
    return [option for option, is_given in given.items() if is_given]


def _told_of_surface(surface: Kind | None, mesh: Mesh | None, options: Options) -> list[str]:
    """A word about a mesh that becomes its layers because of an option that is not about surfaces."""
    if surface != "layers" or mesh is None or options.output.get("surface") is not None:
        return []
    named = _to_the_pixel(options)
    named += ["--layers"] if options.run.layers is not None else []
    named += ["--fill"] if (options.slicing.fill or "nonzero") != "nonzero" else []
    if not named:
        return []
    return [
        f"because of {' and '.join(named)} the surface is that of the layers, with their steps, not the smooth one;"
        " --surface voxels keeps the part's own where nothing changed"
    ]


def _mode(target: Path, stack: LayerStack, surface: Kind | None, options: Options) -> Mode:
    """The user's, else add_only for what keeps the input's facets, else the printer's."""
    if surface != "smooth":
        return options.correction.mode or usual_mode(options.printer, stack)
    if options.correction.mode == "as_printed":
        raise InputError(f"{target}: a smooth surface only adds to the mesh; --surface voxels rounds corners, too")
    return "add_only"


def _antialiased(source: Path, target: Path, options: Options) -> Options:
    """Of a mesh that becomes images or a job, greys if the printer shows them, unless the user says otherwise."""
    slicing, printer = options.slicing, options.printer
    if find_format(source)[0].mesh is None:
        return options
    takes = holds_greys(target) and options.output.get("bits") in (None, 8, "8")
    if slicing.antialias and not takes:
        raise InputError(f"--antialias goes with images of 8 bits and jobs; {target} holds no greys")
    if slicing.antialias is None and takes and printer is not None and (printer.antialias_bits or 1) > 1:
        return replace(options, slicing=replace(slicing, antialias=True))
    return options


def open_stack(source: Path, options: Options) -> LayerStack:
    """The layers of a mesh (sliced for the printer or the given pitch), of a job, or of images.

    Raises InputError for options that go with the other.
    """
    return opened(source, options)[0]


def opened(
    source: Path, options: Options, progress: Callable[[int, int], None] = lambda done, total: None
) -> tuple[LayerStack, Placing | None]:
    """(layers; how the mesh that they are of was turned and moved, as `Part.placed`)."""
    found, _ = find_format(source)
    if found.mesh is not None:
        part = open_part(source, options, progress)
        return part.stack, part.placed
    refuse_given(options.slicing, f"goes with meshes; {source} holds layers already")
    frame, greys = options.frame, {f: v for f, v in asdict(options.greys).items() if v is not None}
    stack = read(source, printer=options.printer, pixel_mm=frame.pixel_mm, layer_mm=frame.layer_mm,
                 first_layer_mm=frame.first_layer_mm, **greys)  # fmt: skip
    if empty_ends(stack) is None:
        raise InputError(f"{source}: nothing is solid in any of its {len(stack)} layers")
    told = [*told_of_machine(stack, options.printer), *told_of_heights(stack, math.inf, options.printer)]
    return replace(stack, notes=(*stack.notes, *told)) if told else stack, None


def _doubts_of(stack: LayerStack, options: Options) -> list[str]:
    """A word about what these layers make of options that are meant for others."""
    how, words = options.correction, []
    if how.keep_out is not None and sliced_mesh(stack) is None and find_format(how.keep_out)[0].mesh is not None:
        words.append(
            f"{how.keep_out.name} is placed from the frame's lower left corner, z from the plate: layers do not say"
            " where the part's own coordinates begin"
        )
    if (how.min_layers or 1) > len(stack):
        words.append(
            f"there are {counted(len(stack), 'layer')} in all, fewer than {how.min_layers}: what is of too few layers"
            " is as high as all of them"
        )
    return words


def _keep_out(stack: LayerStack, placed: Placing | None, options: Options) -> LayerStack | None:
    """What is to be kept free: a mesh in the part's coordinates, or layers of the same frame."""
    path = options.correction.keep_out
    if path is None:
        return None
    found, _ = find_format(path)
    if found.mesh is None:
        if options.slicing.orient is not None:
            raise InputError(f"--keep-out {path}: layers cannot be turned as --orient turns the part; give a mesh")
        return read(path, printer=options.printer, pixel_mm=stack.pixel_mm, layer_mm=options.frame.layer_mm,
                    first_layer_mm=options.frame.first_layer_mm)  # fmt: skip
    mesh = mesh_in(path, options.slicing, any_size=True)
    if placed is not None:
        mesh = mesh.transformed(placed.matrix[:3, :3]).moved(placed.matrix[:3, 3])
    _check_near(path, mesh, stack)
    return slice_like(mesh, stack)


def _check_near(path: Path, mesh: Mesh, stack: LayerStack) -> None:
    """Raises InputError for a mesh that lies outside of all layers: nothing would be kept free, without a word."""
    left, top = stack.origin_mm
    right, bottom = left + stack.width * stack.pixel_mm[0], top - stack.height * stack.pixel_mm[1]
    low, high = stack.z_mm[0, 0] + plate_mm(stack), stack.z_mm[-1, 1] + plate_mm(stack)
    ends = list(zip("xyz", *mesh.bounds_mm.tolist(), (left, bottom, low), (right, top, high), strict=True))
    for axis, first, last, begin, end in ends:
        if last <= begin or first >= end:
            raise InputError(
                f"--keep-out {path}: lies at {axis} = {first:.4g} to {last:.4g} mm, and the part's layers at"
                f" {begin:.4g} to {end:.4g} mm: nothing of it would be kept free"
            )


def draw_layer(stack: LayerStack, fixed: LayerStack, index: int, path: Path, *, force: bool) -> None:
    """Write the before/after picture of one layer."""
    from layerfix.draw.before_after import before_after

    bottom, top = fixed[index].z_mm
    picture = before_after(stack[index], fixed[index], stack.pixel_mm, title=f", z = {(bottom + top) / 2:.2f} mm")
    with whole_file(path, force=force) as file:
        picture.save(file, "PNG")


def check_paths(source: Path, target: Path, options: Options) -> None:
    """Raises InputError and OutputError for inputs that are not there and outputs that cannot be."""
    check_input(source)
    check_apart(target, source)
    check_target(target, force=options.run.force)
    picture = options.run.picture
    if options.run.report:
        check_page(options.run.report, source, target, force=options.run.force)
    if picture:
        if picture.suffix.lower() != ".png":
            raise OutputError(f"{picture}: the picture is written as PNG; call it .png")
        check_apart(picture, source)
        if picture.absolute() == target.absolute() or target.absolute() in picture.absolute().parents:
            raise OutputError(f"{picture}: is where the output goes; choose another place for the picture")
        if picture.is_dir():
            raise OutputError(f"{picture}: is a folder; the picture is a file")
        check_target(picture, force=options.run.force)


def _chosen(source: Path, stack: LayerStack, layers: tuple[int, int]) -> LayerStack:
    first, stop = layers
    if not 0 <= first < min(stop, len(stack)):
        raise InputError(f"{source}: layers {first} to {stop - 1} are not there; it has layers 0 to {len(stack) - 1}")
    return stack[first:stop]


def usual_mode(printer: Printer | None, stack: LayerStack) -> Mode:
    """The printer's mode; without one, that of resin printers for a resin job."""
    if printer:
        return printer.mode
    return "add_only" if stack.container is not None else "as_printed"
