"""Closed surfaces as solids that can be united and simplified: what manifold3d is for.

Its booleans keep triangles that nothing crosses, corner by corner, and say where each came from.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import manifold3d
import numpy as np

from layerfix.mesh.bodies import NO_COLOUR
from layerfix.mesh.outward import faces_outwards
from layerfix.mesh.triangles import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Faces = NDArray[np.int32]


def solid_of(
    vertices: Floats, faces: Faces, ident: int | None = None, colours: NDArray[np.int32] | None = None
) -> manifold3d.Manifold | None:
    """A closed surface, counter-clockwise from outside; None if it is not a 2-manifold.

    ident    a number from `new_ident`, by which its triangles are known later
    colours  (m,) of triangles, from NO_COLOUR on: what is cut of one keeps it
    """
    known: dict[str, NDArray[np.generic]] = {}
    if ident is not None:
        known["run_index"] = np.array([0, 3 * len(faces)], np.uint64)
        known["run_original_id"] = np.array([ident], np.uint32)
    if colours is not None:
        known["face_id"] = (colours.astype(np.int64) - NO_COLOUR).astype(np.uint64)
    mesh = manifold3d.Mesh64(
        vert_properties=np.ascontiguousarray(vertices), tri_verts=faces.astype(np.uint64), **known
    )
    solid = manifold3d.Manifold(mesh)
    return solid if solid.status() == manifold3d.Error.NoError else None


def can_be_solid(mesh: Mesh) -> bool:
    """Whether `whole_solid` makes one of it; asked without uniting anything."""
    vertices, faces, _ = _welded(mesh)
    return solid_of(vertices, faces) is not None and faces_outwards(vertices, faces)


def whole_solid(mesh: Mesh, ident: int | None = None) -> manifold3d.Manifold | None:
    """The mesh as one solid whose shells do not cross each other; None if it is no closed 2-manifold, or inside out.

    Shells that overlap are united: slic3r 1.3 drops layers of others, and a union says what is inside.
    """
    vertices, faces, kept = _welded(mesh)
    solid = solid_of(vertices, faces, ident, None if mesh.bodies is None else mesh.bodies.colours[kept])
    if solid is None:
        return None
    if not faces_outwards(vertices, faces):
        return None
    shells = solid.decompose()
    if len(shells) == 1 or any(shell.volume() <= 0 for shell in shells):
        return solid
    return united(shells)


def new_ident() -> int:
    """A number that no other solid has."""
    return int(manifold3d.Manifold.reserve_ids(1))


def united(solids: list[manifold3d.Manifold]) -> manifold3d.Manifold:
    """All that is in any of them."""
    return manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)


def simplified(solid: manifold3d.Manifold, tolerance_mm: float) -> manifold3d.Manifold:
    """With fewer triangles, no place of the surface moved by more than the tolerance."""
    return solid.simplify(tolerance_mm)


def without_pockets(solid: manifold3d.Manifold, least_mm3: float, ident: int) -> manifold3d.Manifold:
    """Filled: closed-in hollows under least_mm3 that are not of triangles with `ident` alone."""
    parts = solid.decompose()
    small = [part for part in parts if part.volume() < 0 and -part.volume() < least_mm3]
    filled = [part for part in small if set(part.to_mesh64().run_original_id) != {ident}]
    if not filled:
        return solid
    gone = {id(part) for part in filled}
    return manifold3d.Manifold.compose([part for part in parts if id(part) not in gone])


def colours_of(solid: manifold3d.Manifold) -> NDArray[np.int32]:
    """(m,) colours of the triangles that `triangles_of` gives, where they had some."""
    return (np.asarray(solid.to_mesh64().face_id).astype(np.int64) + NO_COLOUR).astype(np.int32)


def triangles_of(solid: manifold3d.Manifold) -> tuple[Floats, Faces, NDArray[np.uint32]]:
    """((n, 3) vertices, (m, 3) faces, (m,) ident of each)."""
    mesh = solid.to_mesh64()
    runs = np.diff(np.asarray(mesh.run_index)) // 3
    ident = np.repeat(np.asarray(mesh.run_original_id, np.uint32), runs)
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int32), ident


def welded(mesh: Mesh) -> tuple[Floats, Faces]:
    """Vertices that are equal to the bit as one, without triangles that then have no area."""
    return _welded(mesh)[:2]


def _welded(mesh: Mesh) -> tuple[Floats, Faces, NDArray[np.bool_]]:
    """`welded`, and (m,) which triangles are left."""
    vertices, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = number.reshape(-1)[mesh.faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices, np.ascontiguousarray(faces[keep], np.int32), keep
