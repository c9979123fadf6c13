"""The corrected surface, in three kinds.

layers  prisms of the layers' outlines, one on top of the other: every cut gives exactly the layer (`outlines.slabs`)
voxels  the boundary of the voxels, one closed 2-manifold, on the input's own surface where nothing changed
smooth  the input, united with smooth bodies of what was too thin; its own facets stay everywhere else
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np

from layerfix.errors import InputError
from layerfix.mesh.outward import turned_outwards
from layerfix.mesh.slicing import filled_as, plate_mm, sliced_mesh
from layerfix.mesh.triangles import Mesh, without_collapsed
from layerfix.stack import layer_maker

if TYPE_CHECKING:
    from collections.abc import Callable

    import trimesh

    from layerfix.bits import Rows
    from layerfix.stack import Layer, LayerStack
    from layerfix.surface.smooth import Smooth

Kind = Literal["layers", "voxels", "smooth"]
KINDS: tuple[Kind, ...] = get_args(Kind)
MOST_TO_SIMPLIFY = 20_000_000  # triangles: half a gigabyte for each million


class Made(NamedTuple):
    """A surface, and what a user should know of it."""

    mesh: Mesh
    notes: tuple[str, ...]


class Telling(NamedTuple):
    """Who is told while a surface is made.

    watch    of each layer in order: its index, and the layer without its pixels
    advance  of what else there is to do: (done, in all)
    """

    watch: Callable[[int, Layer], None] = lambda index, layer: None
    advance: Callable[[int, int], None] = lambda done, total: None


def surface_mesh(
    stack: LayerStack,
    *,
    kind: Kind = "voxels",
    like: Mesh | None = None,
    smooth: bool = False,
    tolerance_mm: float | None = None,
) -> trimesh.Trimesh:
    """The surface of a stack (paper, section 3: the corrected boundary) as a `trimesh.Trimesh`, at the input's place.

    kind          "layers", "voxels" or "smooth"; "smooth" is of what `correct` made of a sliced mesh
    like          the mesh that was sliced, if the stack does not know it
    smooth        of voxels: smooth the stairs where the surface is not the input's; no pixel changes
    tolerance_mm  how far the surface may move for fewer triangles: outlines of layers (if not given half a
                  pixel), voxels (a thousandth of one, which no pixel notices; 0: not at all), bodies (a quarter of
                  their pixel)
    raises        InputError for an unknown kind, layers that are all empty, and what `smooth_surface` raises for
    """
    import trimesh

    mesh = made(stack, kind, like=like, smooth=smooth, tolerance_mm=tolerance_mm).mesh
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def made(
    stack: LayerStack,
    kind: Kind,
    *,
    like: Mesh | None = None,
    smooth: bool = False,
    tolerance_mm: float | None = None,
    telling: Telling | None = None,
) -> Made:
    """`surface_mesh` as a Mesh, with notes."""
    if kind not in KINDS:
        raise InputError(f"surface '{kind}' is not known; choose from {', '.join(KINDS)}")
    if tolerance_mm is not None and not 0 <= tolerance_mm < np.inf:
        raise InputError(f"tolerance {tolerance_mm} mm: it must be 0 or more")
    if smooth and kind != "voxels":
        raise InputError(f"smoothing is of the surface of voxels; that of {kind} is as it is")
    telling = telling or Telling()
    like = like if like is not None else sliced_mesh(stack)
    if kind == "layers":
        return Made(_layers(stack, tolerance_mm, telling), ())
    if kind == "voxels":
        return _voxels(stack, like, smooth, tolerance_mm, telling)
    return _smooth(stack, like, tolerance_mm, telling)


def changes(
    fixed: LayerStack, telling: Telling, *, smooth: bool = False, tolerance_mm: float | None = None
) -> tuple[Mesh | None, Mesh | None]:
    """The surfaces of what was added and of what was removed; None where there is nothing.

    Raises InputError for layers that `correct` did not make.
    """
    from layerfix.layers.correction import before

    stack = before(fixed)
    lists: tuple[list[Rows], list[Rows]] = ([], [])
    for layer, (was, now) in enumerate(zip(stack, fixed, strict=True)):
        telling.watch(layer, now.without_pixels())
        lists[0].append(now.rows & ~was.rows)
        lists[1].append(was.rows & ~now.rows)
    found = []
    for rows in lists:
        some = any(one.any() for one in rows)
        changed = replace(fixed, make=layer_maker(rows.__getitem__, fixed.width, fixed.z_mm), repeats=None)
        surface = _voxels(changed, None, smooth, tolerance_mm, Telling()).mesh if some else None
        found.append(surface and surface.moved((0.0, 0.0, plate_mm(fixed))))
    return found[0], found[1]


def usual_kind(stack: LayerStack) -> Kind:
    """What a mesh is written as if nobody says: smooth where there is a mesh to keep."""
    from layerfix.layers.correction import why_not_elsewhere

    return "smooth" if keeps_a_mesh(stack) and not why_not_elsewhere(stack) else "layers"


def keeps_a_mesh(stack: LayerStack) -> bool:
    """Whether layers were cut from a mesh that smooth bodies can be united with."""
    mesh = sliced_mesh(stack)
    return mesh is not None and filled_as(stack) == "nonzero" and is_closed(turned_outwards(mesh))


def is_closed(mesh: Mesh) -> bool:
    """Whether all of a mesh is closed 2-manifolds, nothing cut out of it: then bodies can be united with it."""
    from layerfix.surface.solids import can_be_solid

    return not mesh.is_clipped and all(can_be_solid(one) for one in mesh.body_meshes())


def _layers(stack: LayerStack, tolerance_mm: float | None, telling: Telling) -> Mesh:
    from layerfix.outlines.contours import trace_contours
    from layerfix.outlines.slabs import slabs

    vertices, faces, count, index = [], [], 0, 0
    for layers, slab in slabs(trace_contours(stack, tolerance_mm=tolerance_mm)):
        for layer in layers:
            telling.watch(index, layer)
            index += 1
        if slab is not None:
            vertices.append(slab.vertices)
            faces.append(slab.faces + count)
            count += len(slab.vertices)
    if not faces:
        raise InputError("every layer is empty, so there is no mesh")
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32))


def _voxels(stack: LayerStack, like: Mesh | None, smooth: bool, tolerance_mm: float | None, telling: Telling) -> Made:
    from layerfix.surface.solids import simplified, solid_of, triangles_of
    from layerfix.surface.voxels import (
        LOSSLESS_PX,
        ends_of,
        grid_of,
        reaching_bounds,
        smoothed,
        snapped,
        voxel_surface,
    )

    surface = voxel_surface(stack, telling.watch)
    lowest_mm = plate_mm(stack)
    on_mesh = np.zeros(len(surface.edges), np.bool_)
    if like is not None and not like.is_clipped:
        surface, on_mesh = snapped(surface, like.moved((0.0, 0.0, -lowest_mm)))
    if smooth:  # but for the foot and the top, or it would be another part's height
        below, above = ends_of(surface)
        surface = smoothed(surface, ~(on_mesh | below | above))
    surface = reaching_bounds(surface, grid_of(stack).bounds)
    vertices, faces = surface.vertices_mm(), surface.faces
    vertices[:, 2] += lowest_mm
    tolerance_mm = LOSSLESS_PX * min(stack.pixel_mm) if tolerance_mm is None else tolerance_mm
    notes: tuple[str, ...] = ()
    if tolerance_mm and len(faces) > MOST_TO_SIMPLIFY:
        notes = (f"{len(faces)} triangles are too many to be simplified; larger pixels make fewer",)
    elif tolerance_mm:
        solid = solid_of(vertices, faces)
        assert solid is not None, "marching cubes are a closed 2-manifold"
        vertices, faces, _ = triangles_of(simplified(solid, tolerance_mm))
    mesh = Mesh(vertices, faces, like.name if like is not None else "surface")
    return Made(without_collapsed(mesh), notes)


def _smooth(stack: LayerStack, like: Mesh | None, tolerance_mm: float | None, telling: Telling) -> Made:
    if like is None:
        raise InputError("a smooth surface keeps the facets of a mesh, and these layers are of none; use the voxels")
    outwards = turned_outwards(like)
    notes = outwards.notes[len(like.notes) :]
    like = outwards
    found = smoothly(stack, like, tolerance_mm, telling)
    if not found.closed:
        beside = "it stays open"
        if found.bodies:
            were = "1 body was" if found.bodies == 1 else f"{found.bodies} bodies were"
            beside = f"{were} put beside its facets as shells of their own, which slicers unite"
        notes += (f"{like.name} is no closed surface: {beside}; --surface voxels makes one closed surface of all",)
    return Made(without_collapsed(replace(found.mesh, notes=())), notes)


def smoothly(stack: LayerStack, like: Mesh, tolerance_mm: float | None, telling: Telling) -> Smooth:
    """What `smooth_surface` makes of corrected layers, which are seen once. Raises InputError as it does."""
    from layerfix.surface.smooth import smooth_surface

    sheets = []
    for index, layer in enumerate(stack.each(lambda layer: layer.without_pixels())):
        telling.watch(index, layer)
        if layer.sheet_px:
            sheets.append(index)
    return smooth_surface(stack, like, tolerance_mm=tolerance_mm, sheets=sheets, advance=telling.advance)
