"""Added bodies shared out among the bodies of a mesh, each of which stays one of its own, with its colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from layerfix.mesh.bodies import NO_COLOUR
from layerfix.surface.solids import new_ident, whole_solid

if TYPE_CHECKING:
    import manifold3d
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh


class Share(NamedTuple):
    """A body of a mesh as a solid (None if it is not closed), and what is added to it."""

    mesh: Mesh
    solid: manifold3d.Manifold | None
    ident: int
    added: list[manifold3d.Manifold]


def shared_out(meshes: Sequence[Mesh], added: Sequence[manifold3d.Manifold]) -> list[Share]:
    """Each added body to the one that it has most in common with; to the first that is not closed if with none."""
    shares = []
    for mesh in meshes:
        ident = new_ident()
        shares.append(Share(mesh, whole_solid(mesh, ident), ident, []))
    fallback = next((k for k, share in enumerate(shares) if share.solid is None), 0)
    for one in added:
        common = [0.0 if s.solid is None or len(shares) == 1 else float((s.solid ^ one).volume()) for s in shares]
        shares[int(np.argmax(common)) if max(common) > 0 else fallback].added.append(one)
    return shares


def colour_of(share: Share, one: manifold3d.Manifold) -> int:
    """The colour of an added body: of most of the surface that it takes in, or else of most of the whole body."""
    within = share.solid ^ one if share.solid is not None else None
    if within is not None:
        mesh = within.to_mesh64()
        runs = np.diff(np.asarray(mesh.run_index)) // 3
        own = np.repeat(np.asarray(mesh.run_original_id), runs) == share.ident
        faces = np.asarray(mesh.tri_verts)[own]
        if len(faces):
            colours = np.asarray(mesh.face_id)[own].astype(np.int64) + NO_COLOUR
            return _most(colours, np.asarray(mesh.vert_properties)[:, :3][faces])
    bodies = share.mesh.bodies
    if bodies is None:
        return NO_COLOUR
    return _most(bodies.colours, share.mesh.vertices[share.mesh.faces])


def _most(colours: NDArray[np.integer], corners: NDArray[np.float64]) -> int:
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    each, number = np.unique(colours, return_inverse=True)
    return int(each[np.bincount(number, areas).argmax()])
