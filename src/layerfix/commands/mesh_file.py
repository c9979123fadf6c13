"""The mesh of a file as all commands take it: in the unit and scale asked for, no body inside out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from layerfix.formats import read_mesh

if TYPE_CHECKING:
    from pathlib import Path

    from layerfix.commands.options import Slicing
    from layerfix.mesh.triangles import Mesh


def mesh_in(path: Path, slicing: Slicing, *, any_size: bool = False) -> Mesh:
    """The mesh in a file. Bodies that are inside out are turned, unless how they face is asked for (--fill).

    any_size  as in `load_mesh`, which also says what errors are raised
    """
    from layerfix.mesh.outward import turned_outwards

    more = {"any_size": True} if any_size else {}
    mesh = read_mesh(path, unit=slicing.unit, scale=slicing.scale or 1.0, **more)
    return turned_outwards(mesh) if (slicing.fill or "nonzero") == "nonzero" else mesh
