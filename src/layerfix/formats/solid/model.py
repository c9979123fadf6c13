"""Corrected layers as a mesh that any slicer reads: binary STL and 3MF.

The mesh is the stack of the layers' prisms (`layerfix.outlines.slabs`), at the place the part had, from z = 0. Slice
it with the stack's own first layer and layer height: every layer's middle then lies in its slab.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import OutputError
from layerfix.files import whole_file
from layerfix.formats.solid.package_3mf import write_3mf
from layerfix.mesh.triangles import save_stl, stl_header, stl_triangles

if TYPE_CHECKING:
    from layerfix.formats.options import OutlineOptions, WriteOptions
    from layerfix.mesh.triangles import Mesh
    from layerfix.outlines.slabs import Slab
    from layerfix.stack import LayerStack

MAX_STL_TRIANGLES = 2**32 - 1


def write_stl(path: Path, stack: LayerStack, options: OutlineOptions) -> None:
    """Binary STL, triangle by triangle as the layers come."""
    count = 0
    with whole_file(path, force=options.force) as file:
        file.write(stl_header("corrected by layerfix", 0))
        for slab in _watched(path, stack, options):
            count += len(slab.faces)
            if count > MAX_STL_TRIANGLES:
                raise OutputError(f"{path}: more triangles than an STL file can count; use a larger --tolerance")
            file.write(stl_triangles(slab.vertices[slab.faces]).tobytes())
        file.seek(0)
        file.write(stl_header("corrected by layerfix", count))


def write_model_3mf(path: Path, stack: LayerStack, options: OutlineOptions) -> None:
    """3MF, one object; a printer's slicer places it where the part was."""
    parts = ((slab.vertices, slab.faces) for slab in _watched(path, stack, options))
    write_3mf(path, parts, force=options.force)


def write_mesh_stl(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, binary STL."""
    save_stl(path, mesh, force=options.force)


def write_mesh_3mf(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, at its place. Raises OutputError for one with parts that are cut out."""
    check_whole(path, mesh)
    write_3mf(path, [(mesh.vertices, mesh.faces.astype(np.int64))], force=options.force)


def write_mesh_obj(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, Wavefront OBJ: every number as exact as it is known. Raises OutputError as for .3mf."""
    check_whole(path, mesh)
    with whole_file(path, force=options.force) as file:
        file.write(b"# written by layerfix, in mm\n")
        for x, y, z in mesh.vertices.tolist():
            file.write(f"v {x!r} {y!r} {z!r}\n".encode())
        for a, b, c in (mesh.faces + 1).tolist():
            file.write(f"f {a} {b} {c}\n".encode())


def check_whole(path: Path, mesh: Mesh) -> None:
    """Raises OutputError for a mesh with parts that are cut out of it: as triangles they would be solid."""
    if mesh.is_clipped:
        raise OutputError(
            f"{path}: {mesh.name} has parts that others are cut out of, which are cut layer by layer: write the"
            " layers (slice_mesh) instead"
        )


def _watched(path: Path, stack: LayerStack, options: OutlineOptions) -> Iterator[Slab]:
    """The slabs of the stack. Raises OutputError if every layer is empty."""
    from layerfix.outlines.contours import trace_contours
    from layerfix.outlines.slabs import slabs

    index = 0
    solid = False
    for layers, slab in slabs(trace_contours(stack, tolerance_mm=options.tolerance_mm)):
        for layer in layers:
            if options.watch is not None:
                options.watch(index, layer)
            index += 1
        if slab is not None:
            solid = True
            yield slab
    if not solid:
        raise OutputError(f"{path}: every layer is empty, so there is no mesh to write")
