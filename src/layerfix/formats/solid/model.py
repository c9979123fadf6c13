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
from layerfix.formats.solid.package_3mf import Body, write_3mf, write_bodies_3mf
from layerfix.mesh.bodies import NO_COLOUR, Bodies, apart_by_colour
from layerfix.mesh.slicing import sliced_mesh
from layerfix.mesh.triangles import Mesh, save_stl, stl_header, stl_triangles
from layerfix.units import format_mm

if TYPE_CHECKING:
    from layerfix.formats.options import SurfaceOptions, WriteOptions
    from layerfix.outlines.slabs import Slab
    from layerfix.stack import LayerStack
    from layerfix.surface.kinds import Kind

MAX_STL_TRIANGLES = 2**32 - 1
COARSE_MM = 0.005  # 32-bit floats that lie farther apart move walls by what a printer shows
ADDED, REMOVED = 0xD62728, 0x1F77B4  # red and blue, told apart by colour-blind people, too


def write_stl(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """Binary STL; of layers, triangle by triangle as they come."""
    _check_colours(path, options)
    kind = _chosen(stack, options)
    if kind != "layers":
        write_mesh_stl(path, _made(path, stack, kind, options), options)
        return
    ends_mm = (*stack.origin_mm, stack.width * stack.pixel_mm[0])
    _tell_of_place(path, max(map(abs, ends_mm)), options)
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
    """3MF: one object, or those of the mesh, with their colours; a printer's slicer places them where they were."""
    kind = _chosen(stack, options)
    if kind == "layers" and not options.only_changes:
        parts = ((slab.vertices, slab.faces) for slab in _watched(path, stack, options))
        write_3mf(path, parts, force=options.force)
    else:
        write_mesh_3mf(path, _surface(path, stack, kind, options), options)


def write_obj(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """Wavefront OBJ, in mm."""
    _check_colours(path, options)
    write_mesh_obj(path, _made(path, stack, _chosen(stack, options), options), options)


def write_ply(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """Binary PLY, in mm, with a colour at each vertex if there are any."""
    write_mesh_ply(path, _surface(path, stack, _chosen(stack, options), options), options)


def write_glb(path: Path, stack: LayerStack, options: SurfaceOptions) -> None:
    """glTF 2.0 in one file, in metres and with y up, as the standard has it."""
    write_mesh_glb(path, _surface(path, stack, _chosen(stack, options), options), options)


def write_mesh_stl(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, binary STL, which holds neither bodies nor colours: that is told."""
    if mesh.bodies is not None:
        _tell_of_loss(options, mesh, "STL", bodies=True, colours=True)
    _tell_of_place(path, float(np.abs(mesh.bounds_mm).max()), options)
    save_stl(path, mesh, force=options.force)


def write_mesh_3mf(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, at its place, with its bodies. Raises OutputError for one with parts that are cut out."""
    check_whole(path, mesh)
    if mesh.bodies is None:
        write_3mf(path, [(mesh.vertices, mesh.faces.astype(np.int64))], force=options.force)
    else:
        write_bodies_3mf(path, _bodies(mesh), force=options.force)


def write_mesh_obj(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, Wavefront OBJ: every number as exact as it is known. Raises OutputError as for .3mf.

    Bodies are objects; colours stand beside the vertices, as MeshLab writes and Blender reads them.
    """
    check_whole(path, mesh)
    with whole_file(path, force=options.force) as file:
        file.write(b"# written by layerfix, in mm\n")
        first = 1
        for body in _bodies(mesh):
            vertices, faces, beside = body.vertices, body.faces.astype(np.int32), [""] * len(body.vertices)
            if (body.colours != NO_COLOUR).any():
                vertices, faces, rgb = apart_by_colour(vertices, faces, body.colours)
                beside = [f" {r:.4f} {g:.4f} {b:.4f}" for r, g, b in (rgb / 255).tolist()]
            if mesh.bodies is not None:
                file.write(f"o {' '.join(body.name.split()) or 'body'}\n".encode())
            for (x, y, z), colour in zip(vertices.tolist(), beside, strict=True):
                file.write(f"v {x!r} {y!r} {z!r}{colour}\n".encode())
            for a, b, c in (faces + first).tolist():
                file.write(f"f {a} {b} {c}\n".encode())
            first += len(vertices)


def write_mesh_ply(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, with its colours. Raises OutputError for one with parts that are cut out."""
    import trimesh

    check_whole(path, mesh)
    _tell_of_place(path, float(np.abs(mesh.bounds_mm).max()), options)
    looks: dict[str, Any] = {}
    vertices, faces = mesh.vertices, mesh.faces
    if mesh.bodies is not None:
        _tell_of_loss(options, mesh, "PLY", bodies=True, colours=False)
        if mesh.bodies.has_colours:
            vertices, faces, rgb = apart_by_colour(vertices, faces, mesh.bodies.colours)
            looks["vertex_colors"] = np.column_stack([rgb, np.full(len(rgb), 255, np.uint8)])
    data: Any = trimesh.Trimesh(vertices, faces, process=False, **looks).export(file_type="ply")
    with whole_file(path, force=options.force) as file:
        file.write(data)


def write_mesh_glb(path: Path, mesh: Mesh, options: WriteOptions) -> None:
    """A mesh as it is, in metres, y up. Raises OutputError for one with parts that are cut out."""
    from layerfix.formats.solid.glb import glb_of

    check_whole(path, mesh)
    _tell_of_place(path, float(np.abs(mesh.bounds_mm).max()), options)
    data = glb_of(_bodies(mesh))
    with whole_file(path, force=options.force) as file:
        file.write(data)


def _bodies(mesh: Mesh) -> list[Body]:
    """Each with vertices of its own."""
    found = []
    for one in mesh.body_meshes():
        own, bodies = one.faces.astype(np.int64), one.bodies
        colours = np.full(len(own), NO_COLOUR, np.int32) if bodies is None else bodies.colours
        name = mesh.name if bodies is None else bodies.names[0]
        found.append(Body(name, one.vertices, own, colours, 0 if bodies is None else bodies.items[0]))
    return found


def _tell_of_loss(options: WriteOptions, mesh: Mesh, kind: str, *, bodies: bool, colours: bool) -> None:
    """A sentence on what a file of this kind does not hold."""
    assert mesh.bodies is not None
    lost = [f"its {len(mesh.bodies.names)} bodies"] if bodies and len(mesh.bodies.names) > 1 else []
    lost += ["colours"] if colours and mesh.bodies.has_colours else []
    if lost and options.tell is not None:
        options.tell(f"{mesh.name}: {' and '.join(lost)} are not kept apart in {kind}; .3mf, .glb and .obj do")


def _tell_of_place(path: Path, farthest_mm: float, options: WriteOptions) -> None:
    """A sentence on a part so far from the origin that 32-bit floats do not keep its shape."""
    step_mm = float(np.spacing(np.float32(farthest_mm)))
    if step_mm > COARSE_MM and options.tell is not None:
        options.tell(
            f"{path.name}: {path.suffix} keeps coordinates of {farthest_mm:.6g} mm to {format_mm(step_mm)} only;"
            " write .3mf or .obj, or move the part to the origin"
        )


def check_whole(path: Path, mesh: Mesh) -> None:
    """Raises OutputError for a mesh with parts that are cut out of it: as triangles they would be solid."""
    if mesh.is_clipped:
        raise OutputError(
            f"{path}: {mesh.name} has parts that others are cut out of, which are cut layer by layer: write the"
            " layers (slice_mesh) instead"
        )


def _chosen(stack: LayerStack, options: SurfaceOptions) -> Kind:
    """The kind of surface; what it does not keep of the input is told."""
    from layerfix.surface.kinds import usual_kind

    if options.only_changes and options.surface not in (None, "voxels"):
        raise OutputError(f"only changes: they are voxels; surface '{options.surface}' does not go with them")
    if options.smooth and options.surface not in (None, "voxels"):
        raise OutputError(f"smoothing is of the surface of voxels; that of {options.surface} is as it is")
    kind = options.surface or ("voxels" if options.smooth else usual_kind(stack))
    mesh = sliced_mesh(stack)
    if (
        kind != "smooth"
        and mesh is not None
        and mesh.bodies is not None
        and options.tell
        and not options.only_changes
    ):
        count = len(mesh.bodies.names)
        what = f"its {count} bodies become one surface" if count > 1 else "it loses its colours"
        options.tell(f"{mesh.name}: {what}; only a smooth surface keeps them")
    return kind


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


def _surface(path: Path, stack: LayerStack, kind: Kind, options: SurfaceOptions) -> Mesh:
    """All of it, or what was changed."""
    return _changes(path, stack, options) if options.only_changes else _made(path, stack, kind, options)


def _changes(path: Path, stack: LayerStack, options: SurfaceOptions) -> Mesh:
    """What was added and what was removed, as bodies in colours. Raises OutputError if nothing was."""
    from layerfix.surface.kinds import Telling, changes

    silent = Telling()
    found = changes(stack, Telling(options.watch or silent.watch), smooth=bool(options.smooth),
                    tolerance_mm=options.tolerance_mm)  # fmt: skip
    named = [
        (*look, mesh) for look, mesh in zip((("added", ADDED), ("removed", REMOVED)), found, strict=True) if mesh
    ]
    if not named:
        raise OutputError(f"{path}: nothing was added or removed, so there are no changes to write")
    sizes = [len(mesh.faces) for _, _, mesh in named]
    starts = np.cumsum([0, *(len(mesh.vertices) for _, _, mesh in named)])
    looks = Bodies(
        np.repeat(np.arange(len(named), dtype=np.int32), sizes),
        tuple(name for name, _, _ in named),
        tuple(range(len(named))),
        np.repeat(np.array([colour for _, colour, _ in named], np.int32), sizes),
    )
    faces = [mesh.faces + np.int32(start) for (_, _, mesh), start in zip(named, starts[:-1], strict=True)]
    return Mesh(np.concatenate([mesh.vertices for _, _, mesh in named]), np.concatenate(faces), "changes",
                bodies=looks)  # fmt: skip


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
