"""Reading and writing files: recognised by what is in them, written as their suffix says (`table` has the rows)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

from layerfix.errors import InputError, OutputError
from layerfix.files import check_input
from layerfix.formats.options import Own, WriteOptions, own_options
from layerfix.formats.probe import Probe
from layerfix.formats.reopening import reopened
from layerfix.formats.table import AS_LAYERS, FORMATS, Format, Writer, function, kind_of, recognising, rows

if TYPE_CHECKING:
    from layerfix.formats.options import Watch
    from layerfix.mesh.triangles import Mesh
    from layerfix.printers import Printer
    from layerfix.stack import LayerStack

__all__ = ["Format", "WriteOptions", "Writer", "find_format", "find_writer", "read", "write"]


def read(
    path: str | Path,
    *,
    printer: Printer | None = None,
    pixel_mm: float | tuple[float, float] | None = None,
    layer_mm: float | None = None,
    first_layer_mm: float | None = None,
    threshold: int = 128,
    grey_floor: int = 32,
) -> LayerStack:
    """A sliced job, or a folder, a zip or one of images, as a LayerStack that decodes each layer when asked.

    The pitch and layer height come from the arguments, else from the file, else from `printer`.
    threshold   grey value from which a pixel is solid, 1 … 255
    grey_floor  grey value from which a stroke that nowhere reaches `threshold` is solid all the same; 0: never
    Raises InputError naming the file for one that is missing, unknown, broken or without a pitch, and for a mesh
    (`load_mesh`, `slice_mesh`).
    """
    from layerfix.formats.hints import Hints
    from layerfix.stack import pitch_mm

    if not 1 <= threshold <= 255 or not 0 <= grey_floor <= 255:
        raise InputError(f"threshold {threshold}, grey floor {grey_floor}: grey values are 1 to 255 (floor: or 0)")
    pitch = None if pixel_mm is None else pitch_mm(pixel_mm)
    found, probe = find_format(path)
    if found.layers is None:
        raise InputError(f"{path}: a mesh; layers are cut from it: slice_mesh(load_mesh(…), …)")
    hints = Hints(printer, pitch, layer_mm, first_layer_mm, threshold, grey_floor)
    stack: LayerStack = function(found.layers)(probe, hints)
    stack = replace(stack, notes=(*stack.notes, *hints.told))
    return reopened(stack, found.layers, probe.path, hints)


def find_format(path: str | Path) -> tuple[Format, Probe]:
    """What a file is, by what is in it; by its suffix where nothing in it tells.

    Raises InputError for one that is missing, unknown, or known and not read (saying what to do instead).
    """
    path = Path(path)
    check_input(path)
    probe = Probe(path)
    if probe.is_folder and any(probe.suffix in row.suffixes for row in FORMATS if row.mesh):
        raise InputError(f"{path}: is a folder; a mesh is a file")
    found = next((row for row in recognising() if row.recognises is not None and row.recognises(probe)), None)
    if found is None:  # broken, perhaps: then the reader of what it is called says how
        found = next((row for row in rows() if row.by_name and probe.suffix in row.suffixes), None)
    if found is None:
        raise InputError(
            f"{path}: not a file that layerfix knows; it reads meshes ({suffixes('mesh')}), and layers from"
            f" {suffixes('layers')}"
        )
    if found.refusal:
        raise InputError(f"{path}: {found.refusal.format(path=path, suffix=path.suffix)}")
    return found, probe


def suffixes(what: str) -> str:
    """For messages: ``a folder, .zip``; of all that is read as "mesh" or "layers", or written from "layers"."""
    chosen = {
        "mesh": [row for row in rows() if row.mesh is not None],
        "layers": [row for row in rows() if row.layers is not None],
        "written": [row for row in rows() if "layers" in row.writers],
    }[what]
    found = dict.fromkeys(suffix or "a folder" for row in chosen for suffix in row.suffixes)
    return (" " if what == "mesh" else ", ").join(found)


class Found(NamedTuple):
    """What writes a value to a path: the function, the options it takes, and the value as it takes it."""

    write: Callable[..., None]
    options: type[WriteOptions]
    value: Any
    known: dict[str, Any]  # options that the value brings along
    kernels: tuple[str, ...] = ()

    @property
    def takes(self) -> tuple[str, ...]:
        """The options that are still open."""
        return tuple(name for name in own_options(self.options) if name not in self.known)


def write(
    path: str | Path,
    value: object,
    printer: Printer | str | None = None,
    *,
    force: bool = False,
    watch: Watch | None = None,
    tell: Callable[[str], None] | None = None,
    advance: Callable[[int, int], None] | None = None,
    **own: Unpack[Own],
) -> None:
    """Write a LayerStack (or Contours, Toolpaths, a WidthPlan, a Mesh) in the format that the suffix names.

    A path without a suffix is a folder of PNG images. A stack that was read from a job and goes to a job of the
    same format keeps every byte that did not change.

    printer  a Printer, or its name, for formats that need one
    force    replace what is there
    watch    told of each layer in order: its index, and the layer without its pixels
    tell     told in a sentence what a user should know of what was written
    advance  told of what is to be done after the last layer: (done, in all)
    own      what this format's writer takes (`layerfix.formats.options`): bits for PNG images; tolerance_mm for
             outlines and meshes; surface, smooth, only_changes for meshes; ascii for .cli; paths, width_mm,
             perimeters, density, seam, skirt_loops for .gcode; slicer for a .3mf of a WidthPlan
    Raises OutputError for an unknown suffix, a value that the format does not hold, an option that its writer does
    not take, an existing target without `force`, and whatever the system refuses; then nothing is left behind.
    """
    path = Path(path)
    found = find_writer(path, value)
    given = {name: option for name, option in own.items() if option is not None}
    brought = [name for name in given if name in found.known]
    if brought:
        raise OutputError(f"{path}: {brought[0]}: {type(value).__name__} bring their own; give it when they are made")
    check_options(path, given, found.takes)
    if isinstance(printer, str):
        from layerfix.printers import load_printer

        printer = load_printer(printer)
    options = found.options(printer, force, watch, tell, advance, **found.known, **given)
    found.write(path, found.value, options)


def holds_greys(path: Path) -> bool:
    """Whether layers are written to a path of that name with their greys."""
    suffix = path.suffix.lower()
    return any(suffix in row.suffixes and "layers" in row.writers and row.greys for row in rows())


def find_writer(path: Path, value: object) -> Found:
    """What writes `value` to `path`. Raises OutputError if nothing does, saying what to pass, or where else to."""
    if path.name == "-":
        raise OutputError("-: nothing is written to standard output; name a file")
    kind = kind_of(value)
    if kind == "layers" and _in_place(path, value):
        from layerfix.formats.jobs.container import rewrite

        return Found(rewrite, WriteOptions, value, {})
    suffix = path.suffix.lower()
    named = []
    for row in rows():  # those of other distributions are loaded only if it comes to them
        if suffix not in row.suffixes:
            continue
        named.append(row)
        writer = row.writers.get(kind or "")
        if writer is not None:
            return Found(function(writer.function), writer.options, value, {}, writer.kernels)
        writer = row.writers.get("layers")
        if writer is not None and kind in AS_LAYERS:
            stack, known = AS_LAYERS[kind](value)
            if known.keys() <= set(own_options(writer.options)):
                return Found(function(writer.function), writer.options, stack, known, writer.kernels)
    raise OutputError(f"{path}: {_why_not(path, value, kind, named)}")


def _in_place(path: Path, value: Any) -> bool:
    return value.container is not None and path.suffix.lower() in value.container.suffixes


def _why_not(path: Path, value: object, kind: str | None, named: list[Format]) -> str:
    """Why nothing writes this value here, and what would be."""
    what = type(value).__name__
    if what == "Layer":
        return "one layer does not know its frame; pass a stack of one: stack[3:4]"
    if kind is None:
        return f"{what} is not written; pass a LayerStack, Contours, Toolpaths, a WidthPlan or a Mesh"
    if not named:
        return f"no writer for '{path.suffix}'; layerfix writes {suffixes('written')}"
    other = [suffix or "a folder" for row in rows() if kind in row.writers for suffix in row.suffixes[:1]]
    if any(row.rewritten for row in named) and kind == "layers":
        return (
            f"{named[0].name} are written only from jobs of the same kind; layerfix can write this one to"
            f" {', '.join(dict.fromkeys(other))}"
        )
    if kind in AS_LAYERS and not other:
        return f"{named[0].name} do not hold {what}; pass its layers: .stack"
    if not any(row.writers for row in named):
        return f"{named[0].name} is only read; a {what} goes to {', '.join(dict.fromkeys(other))}"
    return f"{named[0].name} do not hold a {what}; it goes to {', '.join(dict.fromkeys(other))}"


def options_for_layers(path: Path) -> tuple[str, ...]:
    """What the writer of layers takes that the suffix of `path` names; nothing where only jobs are rewritten."""
    writers = (row.writers.get("layers") for row in rows() if path.suffix.lower() in row.suffixes)
    return next((own_options(writer.options) for writer in writers if writer is not None), ())


def check_options(
    path: Path, names: Iterable[str], takes: Sequence[str], called: Callable[[str], str] = lambda name: name
) -> None:
    """Raises OutputError for options that the writer of `path` does not take, saying what they go with.

    called  what the user calls an option; "" for one that has no such name
    """
    wrong = [name for name in names if name not in takes]
    if not wrong:
        return
    where = {name: _goes_with(name) for name in wrong}
    said = "; ".join(
        f"{called(name)} goes with {where[name]}" if where[name] else f"{called(name)} is no option of any format"
        for name in wrong
    )
    here = path.suffix or "a folder"
    own = ", ".join(filter(None, map(called, takes))) or "no options of its own"
    raise OutputError(f"{path}: {said}; {here} takes {own}")


def _goes_with(name: str) -> str:
    found = (
        suffix or "a folder"
        for row in rows()
        for writer in row.writers.values()
        if name in own_options(writer.options)
        for suffix in row.suffixes
    )
    return ", ".join(dict.fromkeys(found))


def check_before(path: Path, printer: Printer | None, own: Mapping[str, Any] | None = None) -> None:
    """Whatever can be refused before there is a value: a printer that the writer of this suffix cannot write for.

    own  what that writer is to be told
    """
    suffix = path.suffix.lower()
    if printer is not None and suffix and suffix == printer.format and not _is_written(suffix):
        raise OutputError(
            f"{path}: new {suffix} jobs of {printer.title} are not written here; write images (a folder or .zip) and"
            f" let UVtools make the {suffix} of them, or correct a job that a slicer made"
        )
    for row in rows():
        if path.suffix.lower() in row.suffixes:
            for writer in row.writers.values():
                if writer.check is not None:
                    function(writer.check)(path, printer, own or {})
            return


def _is_written(suffix: str) -> bool:
    """Whether something writes or rewrites files of that suffix."""
    return any(suffix in row.suffixes and (row.writers or row.rewritten) for row in rows())


def load_kernels(path: Path) -> None:
    """Import what the writers of a suffix need, before any progress is shown; kernels load when first called."""
    import importlib

    for row in rows():
        if path.suffix.lower() in row.suffixes:
            for writer in row.writers.values():
                for module in writer.kernels:
                    importlib.import_module(module)
            return


def read_mesh(path: Path, **options: Any) -> Mesh:
    """The mesh in a file that `find_format` says holds one."""
    found, _ = find_format(path)
    mesh: Mesh = function(found.mesh or "layerfix.mesh.load:load_mesh")(path, **options)
    return mesh
