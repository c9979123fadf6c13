"""The smooth corrected mesh: the input, united with bodies of what is too thin. Its own facets stay everywhere else.

The bodies are made on pixels of a seventeenth of F (an odd number: F's middle is a pixel's centre then) and on an odd
number of sub-layers for each of the printer's layers, so that no body ends on a plane that the printer cuts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.layers.correction import before, corrected_like, why_not_elsewhere
from layerfix.layers.morphology import dilate
from layerfix.mesh.bodies import NO_COLOUR
from layerfix.mesh.slicing import filled_as, plate_mm, slice_like
from layerfix.mesh.triangles import Mesh
from layerfix.stack import layer_maker
from layerfix.surface.asked_for import asked_for
from layerfix.surface.bodies import body_of, drawn_places, tiles
from layerfix.surface.shares import Share, colour_of, shared_out
from layerfix.surface.solids import (
    colours_of,
    new_ident,
    simplified,
    solid_of,
    triangles_of,
    united,
    whole_solid,
    without_pockets,
)
from layerfix.surface.voxels import LOSSLESS_PX, voxel_surface

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import manifold3d
    from numpy.typing import NDArray

    from layerfix.stack import Layer, LayerStack

F_PX = 17  # pixels in F: half as many leave small slopes rough
LEAST_F_PX = 9
MOST_PX = 24_000_000  # of a layer: the fields of a tile as large take 3 GB
SIMPLER_PX = 0.25  # how far the bodies' surface may move for fewer triangles
SUB_LAYERS = 25  # at most for a layer


@dataclass(frozen=True, eq=False)
class Smooth:
    """A smooth corrected mesh.

    mesh      at the place of the input
    is_input  (faces,) bool: triangles that are the input's, or cut from one
    closed    whether all of it is one closed 2-manifold; if not, bodies are shells of their own
    bodies    how many bodies there were
    """

    mesh: Mesh
    is_input: NDArray[np.bool_]
    closed: bool
    bodies: int


def smooth_surface(
    fixed: LayerStack,
    mesh: Mesh,
    *,
    tolerance_mm: float | None = None,
    sheets: Sequence[int] = (),
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Smooth:
    """`mesh` with everything thickened that `fixed`, its corrected layers, thickened. As `smooth_bodies`."""
    return joined(mesh, *smooth_bodies(fixed, mesh, tolerance_mm=tolerance_mm, sheets=sheets, advance=advance))


def smooth_bodies(
    fixed: LayerStack,
    mesh: Mesh,
    *,
    tolerance_mm: float | None = None,
    sheets: Sequence[int] = (),
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[list[manifold3d.Manifold], float]:
    """(bodies of what `fixed`, the corrected layers of `mesh`, thickened; the largest minimum feature in mm).

    tolerance_mm  how far the surface of bodies may move for fewer triangles; None: a quarter of their pixels
    sheets   layers with something thinner than a layer (`Layer.sheet_px`): it becomes a layer high, as in `fixed`
    advance  told of (layers, in all) of the fine slicing
    raises  InputError for layers that `correct` did not make or that depend on the pixels (`corrected_like`), that
            were not filled by "nonzero", for a part that is too large for its minimum feature, and a mesh with parts
            that are cut out of it
    """
    if mesh.is_clipped:
        raise InputError(f"{mesh.name}: has parts that are cut out, layer by layer; use the surface of its voxels")
    fill = filled_as(fixed)
    if fill != "nonzero":
        raise InputError(f"{mesh.name}: a smooth surface unites shells, as --fill nonzero does, and these layers were"
                         f" filled by {fill}; use the surface of the voxels")  # fmt: skip
    fine = fine_layers(fixed, mesh)
    drawn = corrected_like(slice_like(mesh, fine, hairlines=True, z_sampling="rescue"), fixed)
    radii: dict[int, float] = {}

    def seen(index: int, layer: Layer) -> None:
        radii[index] = layer.change.radius_px[0] if layer.change is not None else 0.0
        advance(index + 1, len(drawn))

    places = drawn_places(drawn, seen)
    radius_px = np.array([radii[k] for k in range(len(drawn))])
    feature_mm = 2 * float(radius_px.max()) * fine.pixel_mm[0]
    if any(map(len, places)):
        places = asked_for(places, fine, fixed, feature_mm)
    lowest_mm, pixel_mm = plate_mm(fixed), fine.pixel_mm[0]
    bodies: list[manifold3d.Manifold] = []
    reach_px = math.ceil(radius_px.max() + 8) if any(map(len, places)) else 1
    for tile in tiles(places, (fine.height, fine.width), reach_px):
        surface = body_of(tile, radius_px, drawn)
        if surface is None:
            continue
        vertices = surface.vertices_mm()
        vertices[:, 2] = _levelled(vertices[:, 2] + lowest_mm, mesh, fine)
        body = solid_of(vertices, surface.faces)
        if body is None:
            raise AssertionError("the body of a tile is no 2-manifold")
        simpler_mm = SIMPLER_PX * pixel_mm if tolerance_mm is None else tolerance_mm
        bodies.append(simplified(body, simpler_mm) if simpler_mm else body)
    return bodies + _sheet_bodies(fixed, mesh, sheets, feature_mm), feature_mm


def _sheet_bodies(
    fixed: LayerStack, mesh: Mesh, sheets: Sequence[int], feature_mm: float
) -> list[manifold3d.Manifold]:
    """What no mid-plane meets, and F around it, as high as its layer: the voxels of the corrected layer there."""
    if not sheets:
        return []
    drawn, cut = before(fixed), slice_like(mesh, fixed, hairlines=True, z_sampling="middle")
    radius_px = feature_mm / 2 / fixed.pixel_mm[0], feature_mm / 2 / fixed.pixel_mm[1]
    bodies = []
    for k in sheets:
        sheet = drawn[k].rows & ~cut[k].rows
        rows = dilate(sheet, fixed.width, radius_px) & fixed[k].rows
        if not rows.any():
            continue
        z_mm = fixed.z_mm[k : k + 1]
        one = replace(fixed, z_mm=z_mm, make=layer_maker([rows].__getitem__, fixed.width, z_mm), repeats=None)
        surface = voxel_surface(one)
        vertices = surface.vertices_mm()
        vertices[:, 2] += plate_mm(fixed)
        body = solid_of(vertices, surface.faces)
        if body is not None:
            bodies.append(simplified(body, LOSSLESS_PX * min(fixed.pixel_mm)))
    return bodies


def fine_layers(fixed: LayerStack, mesh: Mesh) -> LayerStack:
    """The frame that bodies are made on: its layers are those of `fixed`, only so that the plate is found."""
    why_not = why_not_elsewhere(fixed)
    if why_not:
        raise InputError(why_not)
    ends = [change for change in (fixed[0].change, fixed[-1].change) if change is not None]  # the first may be wider
    feature_mm = min(2 * max(r * p for r, p in zip(c.radius_px, fixed.pixel_mm, strict=True)) for c in ends)
    low, high = mesh.bounds_mm[:, :2]
    size = high - low + 2 * feature_mm
    pixel_mm = max(feature_mm / F_PX, math.sqrt(float(size[0] * size[1]) / MOST_PX))
    if pixel_mm > feature_mm / LEAST_F_PX:
        raise InputError(
            f"{mesh.name}: {size[0]:.4g} × {size[1]:.4g} mm is too large for a smooth surface with a minimum feature"
            f" of {feature_mm:.4g} mm; use the surface of the voxels"
        )
    left, top = math.floor((low[0] - feature_mm) / pixel_mm), math.ceil((high[1] + feature_mm) / pixel_mm)
    width = math.ceil((high[0] + feature_mm) / pixel_mm) - left
    height = top - math.floor((low[1] - feature_mm) / pixel_mm)
    heights = fixed.z_mm[:, 1] - fixed.z_mm[:, 0]
    parts = [min(2 * int(max(h / pixel_mm - 1, 0) / 2) + 1, SUB_LAYERS) for h in heights.tolist()]
    edges = [np.linspace(b, t, n + 1) for (b, t), n in zip(fixed.z_mm.tolist(), parts, strict=True)]
    z_mm = np.concatenate([np.column_stack([e[:-1], e[1:]]) for e in edges])
    return replace(
        fixed, width=width, height=height, pixel_mm=(pixel_mm, pixel_mm), origin_mm=(left * pixel_mm, top * pixel_mm),
        z_mm=z_mm, repeats=None, container=None,
    )  # fmt: skip


def _levelled(z_mm: NDArray[np.float64], mesh: Mesh, fine: LayerStack) -> NDArray[np.float64]:
    """Heights within the part, and on its level faces where they are only a rounding away: else slivers are left."""
    corners = mesh.vertices[mesh.faces][:, :, 2]
    levels = np.unique(corners[np.ptp(corners, axis=1) == 0, 0])
    z_mm = z_mm.clip(*mesh.bounds_mm[:, 2])
    if not len(levels):
        return z_mm
    at = np.searchsorted(levels, z_mm).clip(0, len(levels) - 1)
    lower, upper = levels[(at - 1).clip(0)], levels[at]
    near = np.where(np.abs(z_mm - lower) < np.abs(upper - z_mm), lower, upper)
    rounding = float(np.diff(fine.z_mm, axis=1).min()) / 100
    return np.where(np.abs(z_mm - near) < rounding, near, z_mm)


def joined(mesh: Mesh, bodies: list[manifold3d.Manifold], feature_mm: float) -> Smooth:
    """The mesh and the bodies as one surface; bodies of a mesh that is not closed are shells of their own.

    A mesh of several bodies stays that: each added body becomes part of the one that it has most in common with.
    """
    if mesh.bodies is not None and bodies:
        return _bodies_joined(mesh, bodies, feature_mm)
    ident = new_ident()
    whole = whole_solid(mesh, ident)
    if not bodies:
        return Smooth(mesh, np.ones(len(mesh.faces), np.bool_), whole is not None, 0)
    if whole is None:
        return _beside(mesh, united(bodies), len(bodies))
    joined = without_pockets(united([whole, *bodies]), feature_mm**3 / 2, ident)
    vertices, faces, owner = triangles_of(joined)
    return Smooth(replace(mesh, vertices=vertices, faces=faces, parts=()), owner == ident, True, len(bodies))


def _bodies_joined(mesh: Mesh, added: list[manifold3d.Manifold], feature_mm: float) -> Smooth:
    """Each body of the mesh with its share; what is added has the colour of what it covers."""
    assert mesh.bodies is not None
    made, is_input, closed, count = [], [], True, 0
    for share in shared_out(mesh.body_meshes(), united(added).decompose()):
        found = _with_share(share, feature_mm)
        made.append(found.mesh)
        is_input.append(found.is_input)
        closed &= found.closed
        count += found.bodies
    starts = np.cumsum([0, *(len(one.vertices) for one in made)])
    faces = np.concatenate([one.faces + np.int32(start) for one, start in zip(made, starts[:-1], strict=True)])
    colours = np.concatenate([one.bodies.colours for one in made if one.bodies is not None])
    of = np.repeat(np.arange(len(made), dtype=np.int32), [len(one.faces) for one in made])
    whole = replace(
        mesh, vertices=np.concatenate([one.vertices for one in made]), faces=faces, parts=(),
        bodies=replace(mesh.bodies, of=of, colours=colours),
    )  # fmt: skip
    return Smooth(whole, np.concatenate(is_input), closed, count)


def _with_share(share: Share, feature_mm: float) -> Smooth:
    """One body and what is added to it."""
    mesh, bodies = share.mesh, share.mesh.bodies
    assert bodies is not None
    if not share.added:
        return Smooth(mesh, np.ones(len(mesh.faces), np.bool_), share.solid is not None, 0)
    added = [one.as_original() for one in share.added]
    chosen = {one.original_id(): colour_of(share, one) for one in added}
    if share.solid is None:
        shells = united(added)
        found = _beside(replace(mesh, bodies=None), shells, len(added))
        owner = np.concatenate([np.zeros(len(mesh.faces), np.uint32), triangles_of(shells)[2]])
        colours = np.concatenate([bodies.colours, np.full(shells.num_tri(), NO_COLOUR, np.int32)])
    else:
        solid = without_pockets(united([share.solid, *added]), feature_mm**3 / 2, share.ident)
        vertices, triangles, owner = triangles_of(solid)
        colours = colours_of(solid)
        found = Smooth(Mesh(vertices, triangles, mesh.name), owner == share.ident, True, len(added))
    for ident, colour in chosen.items():
        colours[owner == ident] = colour
    own = replace(bodies, of=np.zeros(len(colours), np.int32), colours=colours)
    return replace(found, mesh=replace(found.mesh, bodies=own))


def _beside(mesh: Mesh, shells: manifold3d.Manifold, count: int) -> Smooth:
    """The input as it is, and `count` united bodies as shells of their own, which slicers unite."""
    vertices, faces, _ = triangles_of(shells)
    both = np.concatenate([mesh.vertices, vertices]), np.concatenate([mesh.faces, faces + len(mesh.vertices)])
    is_input = np.arange(len(both[1])) < len(mesh.faces)
    return Smooth(replace(mesh, vertices=both[0], faces=both[1].astype(np.int32)), is_input, False, count)
