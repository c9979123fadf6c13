"""Triangle meshes in millimetres: the value, and STL files of it.

A mesh may have parts: faces that are sliced on their own and of which only what lies outside, or inside, of other
meshes is solid. So negative volumes and clipped lattices stay exact, whatever state their surfaces are in: the
layers are combined, pixel by pixel, not the surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError, OutputError
from layerfix.files import whole_file
from layerfix.mesh.bodies import Bodies

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, eq=False)
class Clip:
    """A closed mesh that bounds a part: solid is only what lies inside of it, or only what lies outside."""

    mesh: Mesh
    inside: bool


@dataclass(frozen=True, eq=False)
class Part:
    """Faces of a mesh that are sliced on their own; their layers join those of all other faces.

    faces   (first, past the last) of the mesh's faces
    clips   what bounds them; all of them do
    united  overlapping shells unite, whatever the fill (beams and balls cross each other on purpose)
    """

    faces: tuple[int, int]
    clips: tuple[Clip, ...] = ()
    united: bool = False

    def changed(self, change: Callable[[Mesh], Mesh]) -> Part:
        """The part whose clips' meshes are `change` of these."""
        return replace(self, clips=tuple(Clip(change(clip.mesh), clip.inside) for clip in self.clips))


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle soup in mm, checked once here and trusted afterwards.

    vertices  (n, 3) float64, x y z in mm, z up; a vertex may be listed more than once (as in STL)
    faces     (m, 3) int32 indices, counter-clockwise seen from outside
    name      what messages call it
    notes     what a user should know of how it was read: what was left out
    parts     faces that are sliced on their own, apart from each other
    bodies    what the file keeps apart, and colours; None if it says nothing
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    name: str = "mesh"
    notes: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()
    bodies: Bodies | None = None

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
        if self.bodies is not None and not len(self.bodies.of) == len(self.bodies.colours) == len(faces):
            raise InputError(f"{self.name}: {len(self.bodies.of)} triangles have a body, of {len(faces)}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @cached_property
    def bounds_mm(self) -> NDArray[np.float64]:
        """(2, 3): the lowest and the highest corner of the triangles; of clipped ones, as far as the clip reaches."""
        bounds = np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])
        if any(clip.inside for part in self.parts for clip in part.clips):
            boxes = np.array([box for box in self._boxes() if (box[0] <= box[1]).all()])
            if len(boxes):
                bounds = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        bounds.flags.writeable = False
        return bounds

    def _boxes(self) -> list[NDArray[np.float64]]:
        """Bounds of each part, cut to what its clips leave of it, and of the faces of no part."""
        boxes = []
        for faces, part in self.pieces():
            corners = self.vertices[faces.reshape(-1)]
            box = np.array([corners.min(axis=0), corners.max(axis=0)])
            for clip in part.clips if part else ():
                if clip.inside:
                    low, high = clip.mesh.bounds_mm
                    box = np.array([np.maximum(box[0], low), np.minimum(box[1], high)])
            boxes.append(box)
        return boxes

    def pieces(self) -> list[tuple[NDArray[np.int32], Part | None]]:
        """The faces that are sliced together, and the part they are: first, with None, those of no part."""
        if not self.parts:
            return [(self.faces, None)]
        rest = np.ones(len(self.faces), np.bool_)
        pieces: list[tuple[NDArray[np.int32], Part | None]] = []
        for part in self.parts:
            first, stop = part.faces
            rest[first:stop] = False
            pieces.append((self.faces[first:stop], part))
        if rest.any():
            pieces.insert(0, (self.faces[rest], None))
        return [(faces, part) for faces, part in pieces if len(faces)]

    def body_meshes(self) -> list[Mesh]:
        """Each body as a mesh of its own, with its colours; the mesh itself if it has none."""
        if self.bodies is None:
            return [self]
        found = []
        for k, (name, item) in enumerate(zip(self.bodies.names, self.bodies.items, strict=True)):
            mine = self.bodies.of == k
            own = Bodies(np.zeros(int(mine.sum()), np.int32), (name,), (item,), self.bodies.colours[mine])
            found.append(Mesh(self.vertices, self.faces[mine], name or self.name, bodies=own))
        return found

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Extents along x, y, z."""
        low, high = self.bounds_mm
        x, y, z = (high - low).tolist()
        return x, y, z

    @property
    def is_clipped(self) -> bool:
        """Whether some of the triangles' volume is cut away: then they alone are not the part."""
        return any(part.clips for part in self.parts)

    @property
    def volume_mm3(self) -> float:
        """Signed volume of all triangles: negative when the mesh is inside out; overlapping bodies count twice.

        Clips of parts take nothing off: slice the mesh and ask the stack for what is really solid.
        """
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    def transformed(self, matrix: ArrayLike) -> Mesh:
        """Turned and scaled by a (3, 3) `matrix`; one that mirrors also flips the triangles."""
        m = np.asarray(matrix, np.float64)
        faces = self.faces if np.linalg.det(m) > 0 else self.faces[:, ::-1]
        parts = tuple(part.changed(lambda mesh: mesh.transformed(m)) for part in self.parts)
        return replace(self, vertices=self.vertices @ m.T, faces=faces, parts=parts)

    def scaled(self, factor: float) -> Mesh:
        """`factor` times as large. Raises InputError unless that is above 0."""
        if not 0 < factor < np.inf:
            raise InputError(f"scale {factor}: it must be above 0")
        parts = tuple(part.changed(lambda mesh: mesh.scaled(factor)) for part in self.parts)
        return replace(self, vertices=self.vertices * factor, parts=parts)

    def moved(self, offset_mm: ArrayLike) -> Mesh:
        """Shifted by (x, y, z) mm."""
        offset = np.asarray(offset_mm, np.float64)
        parts = tuple(part.changed(lambda mesh: mesh.moved(offset)) for part in self.parts)
        return replace(self, vertices=self.vertices + offset, parts=parts)


def without_collapsed(mesh: Mesh) -> Mesh:
    """The mesh without triangles of which two corners are one place in 32-bit floats, as files of meshes hold them.

    The corners become one vertex, so that what was closed stays closed. The mesh itself if there are none.
    """
    if mesh.parts:
        return mesh
    written = mesh.vertices.astype(np.float32)
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    same = (written[edges[:, 0]] == written[edges[:, 1]]).all(axis=1)
    if not same.any():
        return mesh
    number = np.arange(len(mesh.vertices), dtype=np.int32)
    pairs = np.sort(edges[same], axis=1)
    while (number[pairs[:, 0]] != number[pairs[:, 1]]).any():  # as often as places in a row are one
        low = number[pairs].min(axis=1)
        for column in (0, 1):
            np.minimum.at(number, number[pairs[:, column]], low)
        number = number[number]
    faces = number[mesh.faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    bodies = mesh.bodies
    if bodies is not None:
        bodies = replace(bodies, of=bodies.of[keep], colours=bodies.colours[keep])
    return replace(mesh, faces=faces[keep], bodies=bodies)


def stl_header(text: str, triangles: int) -> bytes:
    """The first 84 bytes of a binary STL."""
    return f"binary STL, {text}, mm".encode("ascii", "replace")[:80].ljust(80) + triangles.to_bytes(4, "little")


def stl_triangles(corners: NDArray[np.float64]) -> NDArray[np.void]:
    """(n, 3, 3) corners of triangles as the records of a binary STL."""
    triangles = np.zeros(len(corners), STL_RECORD)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    triangles["corners"] = corners
    return triangles


def save_stl(path: str | Path, mesh: Mesh, *, force: bool = False) -> None:
    """Write a binary STL.

    Raises OutputError for an existing `path` without `force`, what the system refuses, and a mesh with clipped parts.
    """
    if mesh.is_clipped:
        raise OutputError(
            f"{path}: {mesh.name} has volumes that are cut out, and STL holds surfaces alone; slice it,"
            " and write the layers' surface"
        )
    with whole_file(Path(path), force=force) as file:
        file.write(stl_header(mesh.name, len(mesh.faces)))
        file.write(stl_triangles(mesh.vertices[mesh.faces]).tobytes())
