"""Corrected layers as a mesh: binary STL, 3MF, OBJ, PLY and GLB.

Which surface is the user's choice (`layerfix.surface.kinds`). That of the layers is the stack of their prisms
(`layerfix.outlines.slabs`), at the place the part had, from z = 0: slice it with the stack's own first layer and
layer height, and every layer's middle lies in its slab. The others are at the place of the input.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.errors import OutputError
from layerfix.files import whole_file
from layerfix.formats.solid.package_3mf import Body, write_3mf, write_coloured_3mf
from layerfix.mesh.triangles import save_stl, stl_header, stl_triangles

if TYPE_CHECKING:
    from layerfix.formats.options import SurfaceOptions, WriteOptions
    from layerfix.mesh.triangles import Mesh
    from layerfix.outlines.slabs import Slab
    from layerfix.stack import LayerStack
    from layerfix.surface.kinds import Kind

MAX_STL_TRIANGLES = 2**32 - 1
ADDED, REMOVED = 0xD62728, 0x1F77B4  # red and blue, told apart by colour-blind people, too
GLTF_FROM_MM = np.array([[1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, -1e-3, 0, 0], [0, 0, 0, 1]])  # metres, y up


def write_stl(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """Binary STL; of layers, triangle by triangle as they come."""
    _check_colours(path, options)
    kind = _kind(stack, options)
    if kind != "layers":
        write_mesh_stl(path, _made(path, stack, kind, options), options)
        return
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


def write_model_3mf(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """3MF, one object; a printer's slicer places it where the part was."""
    kind = _kind(stack, options)
    if options.only_changes:
        write_coloured_3mf(path, _changes(path, stack, options), force=options.force)
    elif kind == "layers":
        parts = ((slab.vertices, slab.faces) for slab in _watched(path, stack, options))
        write_3mf(path, parts, force=options.force)
    else:
        write_mesh_3mf(path, _made(path, stack, kind, options), options)


def write_obj(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """Wavefront OBJ, in mm."""
    _check_colours(path, options)
    write_mesh_obj(path, _made(path, stack, _kind(stack, options), options), options)


def write_ply(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """Binary PLY, in mm; what was added and removed with a colour at each vertex."""
    if not options.only_changes:
        write_mesh_ply(path, _made(path, stack, _kind(stack, options), options), options)
        return
    import trimesh

    bodies = _changes(path, stack, options)
    colours = [np.full((len(b.vertices), 4), (*_rgb(b.colour), 255), np.uint8) for b in bodies]
    meshes = [
        trimesh.Trimesh(b.vertices, b.faces, vertex_colors=colour, process=False)
        for b, colour in zip(bodies, colours, strict=True)
    ]
    _export(path, trimesh.util.concatenate(meshes), "ply", options)


def write_glb(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """glTF 2.0 in one file, in metres and with y up, as the standard has it."""
    if not options.only_changes:
        write_mesh_glb(path, _made(path, stack, _kind(stack, options), options), options)
        return
    import trimesh

    scene = trimesh.Scene()
    for body in _changes(path, stack, options):
        material = trimesh.visual.material.PBRMaterial(  # type: ignore[no-untyped-call]  # trimesh has no types there
            name=body.name, baseColorFactor=(*_rgb(body.colour), 255)
        )
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=material)  # type: ignore[no-untyped-call]
        scene.add_geometry(mesh, geom_name=body.name, node_name=body.name)
    _export_glb(path, scene, options)


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


def write_mesh_ply(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is. Raises OutputError for one with parts that are cut out."""
    _export(path, _for_export(path, mesh), "ply", options)


def write_mesh_glb(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, in metres, y up. Raises OutputError for one with parts that are cut out."""
    import trimesh

    _export_glb(path, trimesh.Scene(_for_export(path, mesh)), options)


def check_whole(path: Path, mesh: Mesh) -> None:
    """Raises OutputError for a mesh with parts that are cut out of it: as triangles they would be solid."""
    if mesh.is_clipped:
        raise OutputError(
            f"{path}: {mesh.name} has parts that others are cut out of, which are cut layer by layer: write the"
            " layers (slice_mesh) instead"
        )


def _kind(stack: LayerStack, options: SurfaceOptions) -> Kind:
    from layerfix.surface.kinds import usual_kind

    if options.only_changes and options.surface not in (None, "voxels"):
        raise OutputError(f"only changes: they are voxels; surface '{options.surface}' does not go with them")
    if options.smooth and options.surface not in (None, "voxels"):
        raise OutputError(f"smoothing is of the surface of voxels; that of {options.surface} is as it is")
    return options.surface or ("voxels" if options.smooth else usual_kind(stack))


def _check_colours(path: Path, options: SurfaceOptions) -> None:
    if options.only_changes:
        raise OutputError(f"{path}: {path.suffix} holds no colours; write what was added and removed to .3mf, .ply or"
                          " .glb")  # fmt: skip


def _made(path: Path, stack: LayerStack, kind: Kind, options: SurfaceOptions) -> Mesh:
    """The surface, and what is to be said of it."""
    from layerfix.surface.kinds import Telling, made

    silent = Telling()
    found = made(
        stack, kind, smooth=bool(options.smooth), tolerance_mm=options.tolerance_mm,
        telling=Telling(options.watch or silent.watch, options.advance or silent.advance),
    )  # fmt: skip
    for note in found.notes:
        if options.tell is not None:
            options.tell(note)
    return found.mesh


def _changes(path: Path, stack: LayerStack, options: SurfaceOptions) -> list[Body]:
    """What was added and what was removed. Raises OutputError if nothing was."""
    from layerfix.surface.kinds import Telling, changes

    silent = Telling()
    added, removed = changes(stack, Telling(options.watch or silent.watch), smooth=bool(options.smooth),
                             tolerance_mm=options.tolerance_mm)  # fmt: skip
    named = (("added", ADDED, added), ("removed", REMOVED, removed))
    bodies = [Body(name, colour, mesh.vertices, mesh.faces.astype(np.int64)) for name, colour, mesh in named if mesh]
    if not bodies:
        raise OutputError(f"{path}: nothing was added or removed, so there are no changes to write")
    return bodies


def _rgb(colour: int) -> tuple[int, int, int]:
    return colour >> 16, colour >> 8 & 255, colour & 255


def _for_export(path: Path, mesh: Mesh) -> Any:
    import trimesh

    check_whole(path, mesh)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def _export(path: Path, mesh: Any, kind: str, options: WriteOptions) -> None:
    data = mesh.export(file_type=kind)
    with whole_file(path, force=options.force) as file:
        file.write(data.encode() if isinstance(data, str) else data)


def _export_glb(path: Path, scene: Any, options: WriteOptions) -> None:
    scene.apply_transform(GLTF_FROM_MM)
    data = scene.export(file_type="glb")
    with whole_file(path, force=options.force) as file:
        file.write(data)


def _watched(path: Path, stack: LayerStack, options: SurfaceOptions) -> Iterator[Slab]:
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
