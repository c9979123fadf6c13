"""Every file layerfix reads and writes layers from and to: one module a format, one table.

Files are recognised by what is in them; the suffix decides only what is written.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from layerfix.errors import InputError, OutputError
from layerfix.files import reading
from layerfix.formats.jobs import chitu, chitubox_zip, cws, goo, nanodlp, sl1
from layerfix.formats.jobs.container import rewrite
from layerfix.formats.jobs.zips import Archive
from layerfix.formats.options import Hints, WriteOptions
from layerfix.formats.png import images as png_stack
from layerfix.formats.solid import model
from layerfix.formats.vector import common_layer, gcode, geojson, svg
from layerfix.mesh.triangles import SUFFIXES as MESH_SUFFIXES
from layerfix.stack import LayerStack, pitch_mm

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from layerfix.fdm import PathSettings
    from layerfix.formats.encoding import Watch
    from layerfix.printers import Printer


class Format(NamedTuple):
    """One kind of file. suffixes: "" is a folder. write: None where only a job of the kind can be rewritten."""

    suffixes: tuple[str, ...]
    name: str
    write: Callable[[Path, LayerStack, WriteOptions], None] | None
    reads: bool = True


class ZipKind(NamedTuple):
    """A job that is a zip: how its entries give it away, and how it is read."""

    recognises: Callable[[Archive], bool]
    read: Callable[[Archive, Hints], LayerStack]


FORMATS = (
    Format(("",), "folder of PNG images", png_stack.write_folder),
    Format((".zip",), "zip of PNG images", png_stack.write_zip),
    Format(gcode.SUFFIXES, "G-code", gcode.write, False),
    Format((".3mf",), "3MF meshes", model.write_model_3mf, False),
    Format((".stl",), "STL meshes", model.write_stl, False),
    Format((".svg",), "SVG outlines", svg.write, False),
    Format((".geojson",), "GeoJSON outlines", geojson.write, False),
    Format((".cli",), "Common Layer Interface files", common_layer.write, False),
    Format(sl1.SUFFIXES, "Prusa SL1, SL1S and M1 jobs", sl1.write),
    Format(goo.SUFFIXES, "Elegoo GOO jobs", goo.write),
    Format(chitu.PHOTON_SUFFIXES, "Photon and CBDDLP jobs", None),
    Format(chitu.CTB_SUFFIXES, "CTB jobs", None),
    Format((".nanodlp",), "NanoDLP plates", None),
    Format(cws.SUFFIXES, "CWS jobs", None),
)
ZIP_KINDS = (
    ZipKind(sl1.recognises, sl1.read),
    ZipKind(nanodlp.recognises, nanodlp.read),
    ZipKind(chitubox_zip.recognises, chitubox_zip.read),
    ZipKind(cws.recognises, cws.read),
    ZipKind(lambda archive: True, png_stack.read_zip),
)


class BinaryKind(NamedTuple):
    """A job in a format of its own: how its first bytes give it away, and how it is read."""

    recognises: Callable[[bytes], bool]
    read: Callable[[Path, Hints], LayerStack]


BINARY_KINDS = (BinaryKind(goo.recognises, goo.read), BinaryKind(chitu.recognises, chitu.read))
HEAD_BYTES = 16


def known_suffixes(*, read: bool = False) -> str:
    """For messages: ``a folder, .zip``; of all that is written, or that layers are read from."""
    return ", ".join(suffix or "a folder" for f in FORMATS if f.reads or not read for suffix in f.suffixes)


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
    """A sliced job, or a folder or zip of images, as a LayerStack that decodes each layer when asked.

    The pitch and layer height come from the arguments, else from the file, else from `printer`.
    threshold   grey value from which a pixel is solid, 1 … 255
    grey_floor  grey value from which a stroke that nowhere reaches `threshold` is solid all the same; 0: never
    Raises InputError naming the file for one that is missing, unknown, broken or without a pitch.
    """
    path = Path(path)
    if not 1 <= threshold <= 255 or not 0 <= grey_floor <= 255:
        raise InputError(f"threshold {threshold}, grey floor {grey_floor}: grey values are 1 to 255 (floor: or 0)")
    pitch = None if pixel_mm is None else pitch_mm(pixel_mm)
    hints = Hints(printer, pitch, layer_mm, first_layer_mm, threshold, grey_floor)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        return png_stack.read_folder(path, hints)
    with reading(path):
        is_zip = zipfile.is_zipfile(path)
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    refused = refusal(path, head)
    if refused:
        raise InputError(refused)
    for binary in BINARY_KINDS:
        if binary.recognises(head):
            return binary.read(path, hints)
    if is_zip and path.suffix.lower() not in MESH_SUFFIXES:
        archive = Archive(path)
        return next(kind for kind in ZIP_KINDS if kind.recognises(archive)).read(archive, hints)
    raise InputError(
        f"{path}: not a file that layerfix knows; it reads meshes ({' '.join(MESH_SUFFIXES)}), and layers from"
        f" {known_suffixes(read=True)}"
    )


def refusal(path: Path, head: bytes) -> str | None:
    """Why a recognised kind of file is not read, and what to do instead."""
    if head[:4] == chitu.ENCRYPTED.to_bytes(4, "little"):
        kind = "an encrypted CTB"
    elif path.suffix.lower() in gcode.SUFFIXES:
        return f"{path}: G-code is not corrected, only drawn: `layerfix draw {path} layer.png`"
    elif head[:8] == b"ANYCUBIC" or path.suffix.lower() == ".pwsz":
        kind = "one of Anycubic's own formats"
    else:
        return None
    return (
        f"{path}: {kind}, which layerfix does not read; UVtools does the rest:"
        f" `UVtoolsCmd extract {path} layers -c Layers`, then correct the folder layers with layerfix, then"
        f" `UVtoolsCmd run {path} import.uvtop -o fixed{path.suffix}`, where import.uvtop is a saved"
        ' "import layers" operation of the corrected images with import type Replace'
    )


def write(
    path: str | Path,
    stack: LayerStack,
    printer: Printer | None = None,
    *,
    force: bool = False,
    bits: int = 8,
    watch: Watch | None = None,
    tolerance_mm: float | None = None,
    ascii: bool = False,
    paths: PathSettings | None = None,
    width_mm: ArrayLike | None = None,
    tell: Callable[[str], None] | None = None,
) -> None:
    """Write a stack in the format that the suffix names; a path without a suffix is a folder of PNG images.

    A stack that was read from a job and goes to a job of the same format keeps every byte that did not change.

    force   replace what is there
    bits    1 or 8, for PNG images
    watch   told of each layer in order: its index, and the layer without its pixels
    tolerance_mm  of outlines and meshes, as in `trace_contours`
    ascii   for .cli: text instead of binary
    paths   for .gcode: how beads are laid, instead of what the printer's file says
    width_mm  for .gcode: extrusion width of each layer, (layers,)
    tell    told in a sentence what a user should know of what was written
    Raises OutputError for an unknown suffix, an existing target without `force`, and whatever the system
    refuses; then nothing is left behind.
    """
    path = Path(path)
    widths = None if width_mm is None else np.broadcast_to(np.asarray(width_mm, np.float64), (len(stack),))
    options = WriteOptions(printer, force, bits, watch, tolerance_mm, ascii, paths, widths, tell)
    writer_for(path, stack)(path, stack, options)


def writer_for(path: Path, stack: LayerStack) -> Callable[[Path, LayerStack, WriteOptions], None]:
    """What writes `stack` to `path`. Raises OutputError if nothing does."""
    if stack.container is not None and path.suffix.lower() in stack.container.suffixes:
        return rewrite
    found = format_for(path)
    if found.write is None:
        raise OutputError(
            f"{path}: {found.name} are written only from jobs of the same kind; layerfix can write this one to"
            f" {', '.join(f.suffixes[0] or 'a folder' for f in FORMATS if f.write)}"
        )
    return found.write


def format_for(path: Path) -> Format:
    """The format that the suffix of an output names."""
    if path.name == "-":
        raise OutputError("-: layers are not written to standard output; name a file")
    suffix = path.suffix.lower()
    for known in FORMATS:
        if suffix in known.suffixes:
            return known
    raise OutputError(f"{path}: no writer for '{path.suffix}'; layerfix writes {known_suffixes()}")
