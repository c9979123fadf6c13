"""Triangle meshes in millimetres: load, check, rotate. trimesh reads the files."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.errors import InputError
from layerfix.files import whole_file
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
        if not np.isfinite(vertices).all():
            bad = np.count_nonzero(~np.isfinite(vertices).all(axis=1))
            raise InputError(f"{self.name}: {bad} of {len(vertices)} vertices are NaN or infinite")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @property
    def bounds_mm(self) -> NDArray[np.float64]:
        """(2, 3): the lowest and the highest corner of the triangles."""
        used = self.vertices[np.unique(self.faces)] if len(self.faces) < len(self.vertices) // 3 else self.vertices
        return np.array([used.min(axis=0), used.max(axis=0)])

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
    GLB (its specification says so), mm for the others, and a longest side outside 2 mm … 2.5 m is an error.
    Raises InputError naming the file for a missing, unreadable, empty or implausible one.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: '{path.suffix}' is not a mesh; known are {' '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    scene = _read_scene(path)
    mesh = scene.to_mesh() if scene.geometry else None
    if mesh is None or not hasattr(mesh, "faces") or not len(mesh.faces):
        raise InputError(f"{path}: the mesh has no triangles")
    read_in = unit or scene.units or "mm"
    loaded = Mesh(np.asarray(mesh.vertices) * mm_per_unit(read_in), mesh.faces, path.name)
    if not unit:
        _check_plausible(loaded, path, read_in)
    return loaded


def _read_scene(path: Path) -> Any:
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return trimesh.load_scene(str(path), process=False)
    except Exception as problem:
        # trimesh's readers raise whatever their parsers raise (struct, lxml, zipfile, numpy errors);
        # all of them mean that this file is not what its suffix says.
        reason = " ".join(str(problem).split()) or type(problem).__name__
        raise InputError(f"{path}: not a readable {path.suffix} mesh ({reason[:160]})") from problem


def _check_plausible(mesh: Mesh, path: Path, read_in: str) -> None:
    longest = max(mesh.size_mm)
    low, high = PLAUSIBLE_MM
    if low <= longest <= high:
        return
    size = " × ".join(f"{s:.4g}" for s in mesh.size_mm)
    if longest == 0:
        raise InputError(f"{path}: all vertices are one point; the mesh has no size")
    if longest < low:
        choices = [u for u in ("in", "cm", "m") if low <= longest / mm_per_unit(read_in) * mm_per_unit(u) <= high]
        hint = " or ".join(
            f"--unit {u} ({format_mm(longest / mm_per_unit(read_in) * mm_per_unit(u))})" for u in choices
        )
    else:
        hint = f"--unit um ({format_mm(longest / mm_per_unit(read_in) * 1e-3)})"
    hint = f"try {hint}, or " if hint else ""
    raise InputError(
        f"{path}: the part is {size} mm, which is {'tiny' if longest < low else 'huge'}; the file may be in"
        f" another unit: {hint}--unit {read_in} to keep this size"
    )


def save_stl(path: str | Path, mesh: Mesh, *, force: bool = False) -> None:
    """Write a binary STL. Raises OutputError for an existing `path` without `force` and what the system refuses."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = mesh.vertices[mesh.faces]
    triangles = np.zeros(len(corners), record)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    triangles["corners"] = corners
    with whole_file(Path(path), force=force) as file:
        file.write(f"binary STL, {mesh.name}, mm".encode("ascii", "replace")[:80].ljust(80))
        file.write(len(corners).to_bytes(4, "little"))
        file.write(triangles.tobytes())
