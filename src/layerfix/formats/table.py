"""Every kind of file that layerfix reads or writes: one row each. To add one is one file and one row.

Rows name their functions as ``"package.module:function"`` and load them when first needed, so the table costs
nothing. Other distributions add rows through the entry-point group ``layerfix.formats``: each entry point is a
`Format` or a sequence of them. They are asked after the rows here, and one that is broken reports itself (a
`LayerfixWarning`) and blocks nothing.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

from layerfix.errors import LayerfixWarning
from layerfix.formats.options import (
    CliOptions,
    GcodeOptions,
    OutlineOptions,
    PngOptions,
    SurfaceOptions,
    WidthModelOptions,
    WriteOptions,
)
from layerfix.formats.probe import has_suffix, is_folder, is_zip_with, starts

if TYPE_CHECKING:
    from layerfix.formats.probe import Probe

GROUP = "layerfix.formats"
_CONTOURS = ("layerfix.outlines.contours",)
_SURFACE = ("layerfix.outlines.contours", "layerfix.surface.cubes")
_PATHS = ("layerfix.fdm.toolpaths",)
UVTOOLS = (
    "which layerfix does not read; UVtools does the rest: `UVtoolsCmd extract {path} layers -c Layers`, then correct"
    " the folder layers with layerfix, then `UVtoolsCmd run {path} import.uvtop -o fixed{suffix}`, where import.uvtop"
    ' is a saved "import layers" operation of the corrected images with import type Replace'
)


@dataclass(frozen=True)
class Writer:
    """What writes one kind of value: (path, value, options) → None.

    options  the class of what it takes; `layerfix.formats.options`
    kernels  modules to load beforehand
    check    refuses, by (path, printer, options of its own), what cannot be written whatever the value is
    """

    function: str | Callable[..., None]
    options: type[WriteOptions] = WriteOptions
    kernels: tuple[str, ...] = ()
    check: str | None = None


@dataclass(frozen=True)
class Format:
    """One kind of file.

    name        in the plural, as messages call it
    suffixes    of its files; "" is a folder
    recognises  whether a `Probe` is of this kind; None for a kind that is only written
    layers      reads it as layers: (Probe, Hints) → LayerStack
    mesh        reads it as a mesh: (path, unit=…, scale=…) → Mesh
    refusal     why it is recognised and not read, with {path} and {suffix}
    writers     by kind of value: "layers", "mesh", "widths" (`KINDS`)
    rewritten   a job that is corrected in place
    by_name     a file of no known content that is called so is given to this reader, which says what is wrong
    generic     recognises what may be something more special, too; it is asked last
    greys       layers are written with the greys that they carry
    """

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Probe], bool] | None = None
    layers: str | Callable[..., Any] | None = None
    mesh: str | Callable[..., Any] | None = None
    refusal: str = ""
    writers: Mapping[str, Writer] = field(default_factory=dict)
    rewritten: bool = False
    by_name: bool = False
    generic: bool = False
    greys: bool = False


# Values that can be written, by the name of their class.
KINDS = {
    "layerfix.stack.LayerStack": "layers",
    "layerfix.outlines.contours.Contours": "outlines",
    "layerfix.fdm.toolpaths.Toolpaths": "paths",
    "layerfix.fdm.width_plan.WidthPlan": "widths",
    "layerfix.mesh.triangles.Mesh": "mesh",
}
# Values that are layers and how to write them: the layers, and options of the layers' writer.
AS_LAYERS: dict[str, Callable[[Any], tuple[Any, dict[str, Any]]]] = {
    "outlines": lambda contours: (contours.stack, {"tolerance_mm": contours.tolerance_mm}),
    "paths": lambda paths: (paths.stack, {"paths": paths.settings, "width_mm": paths.width_mm}),
    "widths": lambda plan: (plan.corrected(), {"paths": plan.settings, "width_mm": plan.laid.width_mm}),
}


def _is_sl1(probe: Probe) -> bool:
    """A config.ini that names a jobDir."""
    if "config.ini" not in probe.entries:
        return False
    lines = probe.archive.text("config.ini").splitlines()
    return any(line.partition("=")[0].strip() == "jobDir" and "=" in line for line in lines)


def _is_nanodlp(probe: Probe) -> bool:
    """A plate.json beside a profile.json or slicer.json."""
    return "plate.json" in probe.entries and is_zip_with("profile.json", "slicer.json")(probe)


def _is_cws(probe: Probe) -> bool:
    """A slice.conf, or the name .cws and a G-code."""
    named = probe.suffix == ".cws" and any(name.lower().endswith(".gcode") for name in probe.entries)
    return named or is_zip_with("slice.conf")(probe)


def _is_3mf(probe: Probe) -> bool:
    """A zip with a model, which may be called as its author likes."""
    return any(name.lower().endswith(".model") for name in probe.entries)


def _is_images(probe: Probe) -> bool:
    """A zip with PNG files in it."""
    return any(name.lower().endswith(".png") for name in probe.entries)


def _is_mesh(name: str) -> Callable[[Probe], bool]:
    """A file that the readers of meshes take for this kind."""

    def recognises(probe: Probe) -> bool:
        from layerfix.mesh.load import kind_by_content

        if probe.is_folder:
            return False
        kind = kind_by_content(probe.head, probe.path.stat().st_size, probe.suffix)
        return kind is not None and kind.name == name

    return recognises


_MESH = "layerfix.mesh.load:load_mesh"
_IMAGES = "layerfix.formats.png.images"
_VECTOR = "layerfix.formats.vector"
_MODEL = "layerfix.formats.solid.model"
_WIDTHS = "layerfix.formats.solid.width_files"
_JOBS = "layerfix.formats.jobs"

_GCODE = Writer(f"{_VECTOR}.gcode:write", GcodeOptions, _PATHS, f"{_VECTOR}.gcode:check_codes")

FORMATS = (
    Format("folders of PNG images", ("",), is_folder, f"{_IMAGES}:read_folder",
           writers={"layers": Writer(f"{_IMAGES}:write_folder", PngOptions)}, greys=True),
    Format("GOO jobs (Elegoo)", (".goo",), starts(b"\x07\x00\x00\x00DLP\x00", at=4), f"{_JOBS}.goo:read",
           writers={"layers": Writer(f"{_JOBS}.goo:write", kernels=(f"{_JOBS}.runs",))}, rewritten=True, greys=True),
    Format("Photon and CBDDLP jobs", (".photon", ".cbddlp"), starts(b"\x19\x00\xfd\x12"), f"{_JOBS}.chitu:read",
           rewritten=True),
    Format("CTB jobs", (".ctb",), starts(b"\x86\x00\xfd\x12", b"\x06\x01\xfd\x12"), f"{_JOBS}.chitu:read",
           rewritten=True),
    Format("encrypted CTB jobs", (), starts(b"\x07\x01\xfd\x12"), refusal=f"an encrypted CTB, {UVTOOLS}"),
    Format("Anycubic's own jobs", (".pwsz",), lambda probe: starts(b"ANYCUBIC")(probe) or probe.suffix == ".pwsz",
           refusal=f"one of Anycubic's own formats, {UVTOOLS}"),
    Format("SL1, SL1S and M1 jobs (Prusa)", (".sl1", ".sl1s", ".m1"), _is_sl1, f"{_JOBS}.sl1:read",
           writers={"layers": Writer(f"{_JOBS}.sl1:write")}, rewritten=True, by_name=True, greys=True),
    Format("NanoDLP plates", (".nanodlp",), _is_nanodlp, f"{_JOBS}.nanodlp:read", rewritten=True,
           by_name=True),
    Format("Chitubox zips (run.gcode)", (".zip",), is_zip_with("run.gcode"), f"{_JOBS}.chitubox_zip:read",
           rewritten=True),
    Format("CWS jobs", (".cws",), _is_cws, f"{_JOBS}.cws:read", rewritten=True, by_name=True),
    Format("3MF", (".3mf",), _is_3mf, mesh=_MESH,
           writers={"layers": Writer(f"{_MODEL}:write_model_3mf", SurfaceOptions, _SURFACE),
                    "mesh": Writer(f"{_MODEL}:write_mesh_3mf"),
                    "widths": Writer(f"{_WIDTHS}:write_width_3mf", WidthModelOptions)}, by_name=True),
    Format("zips of PNG images", (".zip",), _is_images, f"{_IMAGES}:read_zip",
           writers={"layers": Writer(f"{_IMAGES}:write_zip", PngOptions)}, by_name=True, generic=True, greys=True),
    Format("PNG images", (".png",), starts(b"\x89PNG\r\n\x1a\n"), f"{_IMAGES}:read_image",
           writers={"layers": Writer(f"{_IMAGES}:write_image", PngOptions),
                    "widths": Writer(f"{_WIDTHS}:draw_width_plan")}, greys=True),
    Format("G-code", (".gcode",), has_suffix(".gcode"),
           refusal="G-code is not corrected, only drawn: `layerfix draw {path} layer.png`",
           writers={"layers": _GCODE}),
    Format("STL", (".stl",), _is_mesh("STL"), mesh=_MESH, by_name=True,
           writers={"layers": Writer(f"{_MODEL}:write_stl", SurfaceOptions, _SURFACE),
                    "mesh": Writer(f"{_MODEL}:write_mesh_stl")}),
    Format("OBJ", (".obj",), _is_mesh("OBJ"), mesh=_MESH, by_name=True,
           writers={"layers": Writer(f"{_MODEL}:write_obj", SurfaceOptions, _SURFACE),
                    "mesh": Writer(f"{_MODEL}:write_mesh_obj")}),
    Format("PLY", (".ply",), _is_mesh("PLY"), mesh=_MESH, by_name=True,
           writers={"layers": Writer(f"{_MODEL}:write_ply", SurfaceOptions, _SURFACE),
                    "mesh": Writer(f"{_MODEL}:write_mesh_ply")}),
    Format("OFF", (".off",), _is_mesh("OFF"), mesh=_MESH, by_name=True),
    Format("glTF", (".glb",), _is_mesh("glTF"), mesh=_MESH, by_name=True,
           writers={"layers": Writer(f"{_MODEL}:write_glb", SurfaceOptions, _SURFACE),
                    "mesh": Writer(f"{_MODEL}:write_mesh_glb")}),
    Format("glTF with files beside it", (".gltf",), _is_mesh("glTF"), mesh=_MESH, by_name=True),
    Format("SVG outlines", (".svg",),
           writers={"layers": Writer(f"{_VECTOR}.svg:write", OutlineOptions, _CONTOURS),
                    "widths": Writer(f"{_WIDTHS}:draw_width_plan")}),
    Format("GeoJSON outlines", (".geojson",),
           writers={"layers": Writer(f"{_VECTOR}.geojson:write", OutlineOptions, _CONTOURS)}),
    Format("Common Layer Interface files", (".cli",),
           writers={"layers": Writer(f"{_VECTOR}.common_layer:write", CliOptions, _CONTOURS)}),
    Format("tables of widths", (".csv",), writers={"widths": Writer(f"{_WIDTHS}:write_csv")}),
    Format("widths as JSON", (".json",), writers={"widths": Writer(f"{_WIDTHS}:write_json")}),
)  # fmt: skip


def function(named: str | Callable[..., Any]) -> Callable[..., Any]:
    """What a row names as "package.module:function"."""
    if not isinstance(named, str):
        return named
    module, _, name = named.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return found


@cache
def plugin_rows() -> tuple[Format, ...]:
    """The rows of other distributions. One that does not load is a LayerfixWarning."""
    from importlib.metadata import entry_points

    rows: list[Format] = []
    for entry in entry_points(group=GROUP):
        try:
            loaded = entry.load()
            found = [loaded] if isinstance(loaded, Format) else list(loaded)
            if not all(isinstance(row, Format) for row in found):
                raise TypeError(f"{entry.value} is not a Format or a sequence of them")
        except Exception as problem:  # someone else's code may raise anything
            whose = entry.dist.name if entry.dist is not None else "a distribution"
            warnings.warn(
                f"the formats '{entry.name}' of {whose} cannot be used: {type(problem).__name__}: {problem}",
                LayerfixWarning,
                stacklevel=2,
            )
            continue
        rows += found
    return tuple(rows)


def rows() -> Iterator[Format]:
    """All rows, those of other distributions last; they are looked for only when these are gone through."""
    yield from FORMATS
    yield from plugin_rows()


def recognising() -> Iterator[Format]:
    """All rows in the order in which a file is held against them: any zip may be images, but first something else."""
    yield from (row for row in FORMATS if not row.generic)
    yield from plugin_rows()
    yield from (row for row in FORMATS if row.generic)


def kind_of(value: object) -> str | None:
    """Which of KINDS a value is, by the names of its classes: nothing is imported to find out."""
    classes = (f"{c.__module__}.{c.__qualname__}" for c in type(value).__mro__)
    return next((KINDS[name] for name in classes if name in KINDS), None)
