"""Mesh files: what is in them decides how they are read; the suffix only where the content leaves a choice."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from layerfix.errors import InputError
from layerfix.files import reading
from layerfix.mesh.reading import HEAD_BYTES, Read, unreadable
from layerfix.mesh.triangles import Mesh
from layerfix.units import format_mm, mm_per_unit

# Files without a unit are read as mm, as every slicer does. A part whose longest side is outside these
# bounds was almost surely drawn in metres or inches (too small) or micrometres (too large).
PLAUSIBLE_MM = (2.0, 2500.0)


class MeshKind(NamedTuple):
    """One kind of mesh file. module: has `recognises(head, size)` and `read(path)`; loaded when a file needs it."""

    name: str
    suffixes: tuple[str, ...]
    module: str

    def recognises(self, head: bytes, size: int) -> bool:
        """Whether a file of `size` bytes that begins with `head` (HEAD_BYTES of it) is of this kind."""
        return bool(importlib.import_module(f"layerfix.mesh.{self.module}").recognises(head, size))

    def read(self, path: Path) -> Read:
        """The file's mesh in its own unit. Raises InputError, and whatever a broken file makes parsers raise."""
        read: Read = importlib.import_module(f"layerfix.mesh.{self.module}").read(path)
        return read


KINDS = (
    MeshKind("3MF", (".3mf",), "read_3mf"),
    MeshKind("glTF", (".glb", ".gltf"), "read_gltf"),
    MeshKind("PLY", (".ply",), "read_ply"),
    MeshKind("OFF", (".off",), "read_off"),
    MeshKind("STL", (".stl",), "read_stl"),
    MeshKind("OBJ", (".obj",), "read_obj"),
)
SUFFIXES = (".stl", ".obj", ".ply", ".off", ".3mf", ".glb", ".gltf")


def load_mesh(path: str | Path, *, unit: str | None = None, scale: float = 1.0, any_size: bool = False) -> Mesh:
    """Read STL (ASCII, binary), OBJ, PLY, OFF, 3MF (all build items) or glTF as one Mesh in mm.

    unit   what one unit of the file is ("mm", "in", "m", …). Without it: what a 3MF says, metres for glTF (its
           specification says so, and that y is up), mm for the others; but for 3MF a longest side outside
           2 mm … 2.5 m is an error
    scale  the part is made so many times as large (see `units.parse_scale` for "1:87" and "50%")
    any_size  it is not a part of its own (a bore to be kept free, say), and may be smaller or larger
    What was left out is in the mesh's notes.
    Raises InputError naming the file for a missing, unreadable, empty or implausible one.
    """
    path = Path(path)
    if not 0 < scale < math.inf:
        raise InputError(f"scale {scale}: it must be above 0")
    kind = recognised(path)
    try:
        with np.errstate(all="ignore"):  # vertices at infinity: refused by Mesh, not warned of
            mesh, said = kind.read(path)
        read_in = unit or said or "mm"
        mm = mm_per_unit(read_in)
    except InputError as problem:
        if str(path) in str(problem):
            raise
        raise InputError(f"{path}: {str(problem).removeprefix(f'{path.name}: ')}") from problem
    except (ValueError, TypeError, ArithmeticError, LookupError, EOFError, MemoryError, RecursionError) as problem:
        # What numpy, struct, json and zlib raise on a broken file (a TypeError: numbers that no array holds); that
        # they met it is all there is to say.
        reason = " ".join(str(problem).split()) or type(problem).__name__
        raise unreadable(path, kind.name, reason[:160]) from problem
    if mm * scale != 1:
        mesh = mesh.scaled(mm * scale)
    if not unit and not any_size and not (kind.name == "3MF" and said):  # which says its unit, and means it
        _check_plausible(mesh, path, read_in, scale)
    return mesh


def recognised(path: Path) -> MeshKind:
    """The kind of a file by its content; by its suffix where that fits several kinds, or none.

    Raises InputError for a file that is not there, is no file, or is neither a mesh by content nor by name.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; a mesh is a file")
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if not path.is_file():
        raise InputError(f"{path}: is a device or a pipe; a mesh is a file")
    with reading(path), path.open("rb") as file:
        head, size = file.read(HEAD_BYTES), path.stat().st_size
    found = kind_by_content(head, size, path.suffix) or _kind_by_name(path.suffix)
    if found is None:
        raise InputError(f"{path}: '{path.suffix}' is not a mesh; known are {' '.join(SUFFIXES)}")
    return found


def kind_by_content(head: bytes, size: int, suffix: str) -> MeshKind | None:
    """What a file of `size` bytes that begins with `head` is; if it may be several, what it is called; or None."""
    by_name = _kind_by_name(suffix)
    asked = [kind for kind in (by_name, *KINDS) if kind is not None]
    return next((kind for kind in asked if kind.recognises(head, size)), None)


def _kind_by_name(suffix: str) -> MeshKind | None:
    return next((kind for kind in KINDS if suffix.lower() in kind.suffixes), None)


def _check_plausible(mesh: Mesh, path: Path, read_in: str, scale: float) -> None:
    """Raises InputError, proposing units, if the part is so small or so large that its unit is in doubt."""
    longest = max(mesh.size_mm)
    low, high = PLAUSIBLE_MM
    if low <= longest <= high:
        return
    size = " × ".join(f"{s:.4g}" for s in mesh.size_mm)
    if longest == 0:
        raise InputError(f"{path}: all vertices are one point; the mesh has no size")
    in_unit = {u: longest / mm_per_unit(read_in) * mm_per_unit(u) for u in ("um", "mm", "in", "cm", "m")}
    fitting = [f"--unit {u} ({format_mm(mm)})" for u, mm in in_unit.items() if low <= mm <= high]
    hint = f"try {' or '.join(fitting)}, or " if fitting else ""
    same = next((u for u in in_unit if mm_per_unit(u) == mm_per_unit(read_in)), read_in)
    scaled = f" at {scale:g} times its size" if scale != 1 else ""
    raise InputError(
        f"{path}: the part is {size} mm{scaled}, which is {'tiny' if longest < low else 'huge'}; the file may be in"
        f" another unit: {hint}--unit {same} to keep this size"
    )
