"""Every file layerfix reads and writes layers from and to: one module a format, one table."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from layerfix.errors import InputError, OutputError
from layerfix.files import reading
from layerfix.formats import png_stack
from layerfix.formats.options import Hints, WriteOptions
from layerfix.mesh import SUFFIXES as MESH_SUFFIXES
from layerfix.stack import LayerStack, pitch_mm

if TYPE_CHECKING:
    from layerfix.formats.encoding import Watch
    from layerfix.printers import Printer


class Format(NamedTuple):
    """suffix "" is a folder."""

    suffix: str
    name: str
    read: Callable[[Path, Hints], LayerStack]
    write: Callable[[Path, LayerStack, WriteOptions], None]


FORMATS = (
    Format("", "folder of PNG images", png_stack.read_folder, png_stack.write_folder),
    Format(".zip", "zip of PNG images", png_stack.read_zip, png_stack.write_zip),
)


def known_suffixes() -> str:
    """For messages: ``a folder, .zip``."""
    return ", ".join(f.suffix or "a folder" for f in FORMATS)


def read(
    path: str | Path,
    *,
    printer: Printer | None = None,
    pixel_mm: float | tuple[float, float] | None = None,
    layer_mm: float | None = None,
    first_layer_mm: float | None = None,
) -> LayerStack:
    """A folder or zip of PNG images as a LayerStack, decoded layer by layer when asked.

    The pitch and layer height come from the arguments, else from the file, else from `printer`.
    Raises InputError naming the file for one that is missing, unknown, broken or without a pitch.
    """
    path = Path(path)
    hints = Hints(printer, None if pixel_mm is None else pitch_mm(pixel_mm), layer_mm, first_layer_mm)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        return png_stack.read_folder(path, hints)
    with reading(path):
        is_zip = zipfile.is_zipfile(path)
    if is_zip and path.suffix.lower() not in MESH_SUFFIXES:
        return png_stack.read_zip(path, hints)
    raise InputError(
        f"{path}: not a file that layerfix knows; it reads meshes ({' '.join(MESH_SUFFIXES)}), and layers from"
        f" {known_suffixes()}"
    )


def write(
    path: str | Path,
    stack: LayerStack,
    printer: Printer | None = None,
    *,
    force: bool = False,
    bits: int = 8,
    watch: Watch | None = None,
) -> None:
    """Write a stack in the format that the suffix names; a path without a suffix is a folder of PNG images.

    force   replace what is there
    bits    1 or 8, for PNG images
    watch   told of each layer in order: its index, and the layer without its pixels
    Raises OutputError for an unknown suffix, an existing target without `force`, and whatever the system
    refuses; then nothing is left behind.
    """
    path = Path(path)
    format_for(path).write(path, stack, WriteOptions(printer, force, bits, watch))


def format_for(path: Path) -> Format:
    """The format that the suffix of an output names."""
    suffix = path.suffix.lower()
    for known in FORMATS:
        if known.suffix == suffix:
            return known
    raise OutputError(f"{path}: no writer for '{path.suffix}'; layerfix writes {known_suffixes()}")
