"""Triangle meshes in millimetres: load, check, rotate. trimesh reads the files."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.files import whole_file
from layerfix.mesh.read_3mf import read_3mf
from layerfix.units import format_mm, mm_per_unit

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".3mf", ".glb", ".gltf")

# Files without a unit are read as mm, as every slicer does. A part whose longest side is outside these
# bounds was almost surely drawn in metres or inches (too small) or micrometres (too large).
PLAUSIBLE_MM = (2.0, 2500.0)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle soup in mm, checked once here and trusted afterwards.

    vertices  (n, 3) float64, x y z in mm, z up; a vertex may be listed more than once (as in STL)
    faces     (m, 3) int32 indices, counter-clockwise seen from outside
    name      what messages call it
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    name: str = "mesh"

    def __post_init__(self) -> None:
        """Raises InputError for wrong shapes, no triangles, and coordinates that are not finite."""
        vertices = np.ascontiguousarray(self.vertices, np.float64)
        faces = np.ascontiguousarray(self.faces, np.int32)
        if vertices.ndim != 2 or faces.ndim != 2 or vertices.shape[1] != 3 or faces.shape[1] != 3:
            raise InputError(
                f"{self.name}: vertices {np.shape(self.vertices)} and faces {np.shape(self.faces)};"
                " a mesh has (n, 3) vertices and (m, 3) faces"
            )
        if not len(faces):
            raise InputError(f"{self.name}: the mesh has no triangles")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(
                f"{self.name}: a face names vertex {faces.max()} of {len(vertices)}"
                if faces.max() >= len(vertices)
                else f"{self.name}: a face names vertex {faces.min()}"
            )
        used = np.zeros(len(vertices), np.bool_)
        used[faces] = True
        if not used.all():  # vertices of no triangle count for nothing, least of all for the size
            vertices, faces = vertices[used], (np.cumsum(used, dtype=np.int32) - 1)[faces].astype(np.int32)
        if not np.isfinite(vertices).all():
            bad = np.count_nonzero(~np.isfinite(vertices).all(axis=1))
            raise InputError(f"{self.name}: {bad} of {len(vertices)} vertices are NaN or infinite")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @property
    def bounds_mm(self) -> NDArray[np.float64]:
        """(2, 3): the lowest and the highest corner of the triangles."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Extents along x, y, z."""
        low, high = self.bounds_mm
        x, y, z = (high - low).tolist()
        return x, y, z

    @property
    def volume_mm3(self) -> float:
        """Signed volume: negative when the mesh is inside out; overlapping bodies count twice."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    def transformed(self, matrix: ArrayLike) -> Mesh:
        """Turned and scaled by a (3, 3) `matrix`; one that mirrors also flips the triangles."""
        m = np.asarray(matrix, np.float64)
        faces = self.faces if np.linalg.det(m) > 0 else self.faces[:, ::-1]
        return replace(self, vertices=self.vertices @ m.T, faces=faces)

    def moved(self, offset_mm: ArrayLike) -> Mesh:
        """Shifted by (x, y, z) mm."""
        return replace(self, vertices=self.vertices + np.asarray(offset_mm, np.float64))


def load_mesh(path: str | Path, *, unit: str | None = None) -> Mesh:
    """Read STL (ASCII, binary), OBJ, PLY, OFF, 3MF (all build items) or GLB as one Mesh in mm.

    `unit` is what one unit of the file is ("mm", "in", "m", …). Without it: what a 3MF says, metres for
    GLB (its specification says so, and that y is up), mm for the others; but for 3MF a longest side outside
    2 mm … 2.5 m is an error.
    Raises InputError naming the file for a missing, unreadable, empty or implausible one.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: '{path.suffix}' is not a mesh; known are {' '.join(SUFFIXES)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; a mesh is a file")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    vertices, faces, read_in = _read(path, suffix, unit)
    loaded = Mesh(vertices, faces.astype(np.int32), path.name)
    if not unit and suffix != ".3mf":  # which says its unit, and means it
        _check_plausible(loaded, path, read_in)
    return loaded


def _read(path: Path, suffix: str, unit: str | None) -> tuple[NDArray[np.float64], NDArray[np.int64], str]:
    """(vertices in mm, faces, the unit they were read in)."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if suffix == ".3mf":
                return *read_3mf(path, unit), unit or "mm"
            import trimesh

            scene = trimesh.load_scene(str(path), process=False)
            mesh = scene.to_mesh() if scene.geometry else None
            if mesh is None or not hasattr(mesh, "faces") or not len(mesh.faces):
                raise InputError(f"{path}: the mesh has no triangles")
            if suffix == ".off":
                _check_off(path)
    except InputError:
        raise
    except Exception as problem:
        # trimesh's readers raise whatever their parsers raise (struct, lxml, zipfile, numpy errors);
        # all of them mean that this file is not what its suffix says.
        reason = " ".join(str(problem).split()) or type(problem).__name__
        raise InputError(f"{path}: not a readable {suffix} mesh ({reason[:160]})") from problem
    read_in = unit or scene.units or "mm"
    vertices = np.asarray(mesh.vertices) * mm_per_unit(read_in)
    if suffix in (".glb", ".gltf"):
        vertices = vertices[:, [0, 2, 1]] * (1, -1, 1)  # glTF has y up, printers z
    return vertices, np.asarray(mesh.faces), read_in


def _check_off(path: Path) -> None:
    """An OFF file has as many lines as its header says; trimesh reads a file that is cut short all the same."""
    with path.open(encoding="latin-1") as file:
        words = [line.partition("#")[0].split() for line in file]
    lines = [line for line in words if line]
    header = lines[0][1:] or lines[1]
    body = len(lines) - (1 if lines[0][1:] else 2)
    if body < int(header[0]) + int(header[1]):
        raise InputError(f"{path}: the file is cut short: {body} lines of {int(header[0]) + int(header[1])}")


def _check_plausible(mesh: Mesh, path: Path, read_in: str) -> None:
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
    raise InputError(
        f"{path}: the part is {size} mm, which is {'tiny' if longest < low else 'huge'}; the file may be in"
        f" another unit: {hint}--unit {same} to keep this size"
    )


def stl_header(text: str, triangles: int) -> bytes:
    """The first 84 bytes of a binary STL."""
    return f"binary STL, {text}, mm".encode("ascii", "replace")[:80].ljust(80) + triangles.to_bytes(4, "little")


def stl_triangles(corners: NDArray[np.float64]) -> NDArray[np.void]:
    """(n, 3, 3) corners of triangles as the records of a binary STL."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.zeros(len(corners), record)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    triangles["corners"] = corners
    return triangles


def save_stl(path: str | Path, mesh: Mesh, *, force: bool = False) -> None:
    """Write a binary STL. Raises OutputError for an existing `path` without `force` and what the system refuses."""
    with whole_file(Path(path), force=force) as file:
        file.write(stl_header(mesh.name, len(mesh.faces)))
        file.write(stl_triangles(mesh.vertices[mesh.faces]).tobytes())
