"""`fix` on a slicer's project: each object's parts are corrected where they stand, everything else stays as it is."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from layerfix.commands.fix import as_asked, check_paths, fix
from layerfix.commands.options import Options, flag, min_feature_of
from layerfix.commands.part import check_more_than_a_dot, open_part
from layerfix.commands.summary import Summary, add_up
from layerfix.errors import InputError
from layerfix.formats import find_format
from layerfix.formats.solid.project_3mf import Placed, Project, ProjectObject, is_project
from layerfix.mesh.triangles import Mesh
from layerfix.units import counted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.stack import Layer, LayerStack

NOT_FOR_PROJECTS = ("surface", "smooth", "only_changes", "tolerance_mm")
Progress = Callable[[int, int], None]


def fix_file(source: Path, target: Path, options: Options, progress: Progress = lambda done, total: None) -> Summary:
    """`fix`, and of a slicer's project that goes to a .3mf: the project, with its parts corrected."""
    if target.suffix.lower() == ".3mf" and source.suffix.lower() == ".3mf" and source.is_file():
        found, probe = find_format(source)
        if found.mesh is not None and is_project(probe) and options.output.get("surface") is None:
            return fix_project(source, target, options, progress)
    return fix(source, target, options, progress)


@dataclass(frozen=True, eq=False)
class _Body:
    """One part of an object, in mm, where it stands on the plate."""

    placed: Placed
    mesh: Mesh
    local: NDArray[np.float64]  # its vertices as they are in the file


def fix_project(source: Path, target: Path, options: Options, progress: Progress) -> Summary:
    """Correct every printed object of a project. Raises InputError and OutputError as `fix` does, and for options
    that are of a mesh that is written anew.
    """
    started = time.perf_counter()
    check_paths(source, target, options)
    _check_options(source, target, options)
    project = Project(source)
    if not any(one.parts for one in project.objects):
        raise InputError(f"{source}: nothing is printed in this project: it has no solid part on the plate")
    done: list[Layer] = []
    summaries, notes = [], []
    for one in project.objects:
        if one.parts:
            summary, told = _fix_object(project, one, source, target, options, progress, done)
            summaries.append(summary)
            notes += told
    project.write(target, force=options.run.force)
    if project.lost_paint:
        stayed = f", {project.kept_paint} stayed" if project.kept_paint else ""
        notes.append(
            f"painting (supports, seams, colours) of {counted(project.lost_paint, 'triangle')} that had to change is"
            f" lost{stayed}"
        )
    return _together(summaries, notes, time.perf_counter() - started)


def _check_options(source: Path, target: Path, options: Options) -> None:
    given = [name for name in NOT_FOR_PROJECTS if options.output.get(name)]
    given += [name for name in ("orient", "scale", "unit", "antialias") if getattr(options.slicing, name, None)]
    given += [name for name in ("layers", "picture", "report", "scheduler") if getattr(options.run, name) is not None]
    how = options.correction
    given += [name for name in ("keep_gaps_mm", "keep_out", "min_layers") if getattr(how, name) is not None]
    if given:
        raise InputError(
            f"{source} is a slicer's project, of which all but the parts is kept: {', '.join(map(flag, given))}"
            " does not go with that; write another kind of file, or choose --surface for the mesh alone"
        )
    if how.mode == "as_printed":
        raise InputError(f"{target}: parts of a project are only added to; leave --mode out")


def _fix_object(
    project: Project, one: ProjectObject, source: Path, target: Path, options: Options, progress: Progress,
    done: list[Layer],
) -> tuple[Summary, list[str]]:  # fmt: skip
    """Correct the parts of an object together: what is thin in one and not in all is not thin."""
    started = time.perf_counter()
    bodies = [_body(project, placed) for placed in one.parts]
    whole = _whole(bodies, one.name)
    stack = open_part(source, options, progress, mesh=whole).stack
    check_more_than_a_dot(whole, min_feature_of(options))
    fixed = as_asked(stack, None, "add_only", options)
    layers: list[Layer] = []
    for index, layer in enumerate(fixed.each(lambda layer: layer.without_pixels())):
        bottom, top = fixed.z_mm[index].tolist()
        layers.append(layer.at((bottom, top)))
        progress(index + 1, len(fixed))
    told: list[str] = []
    sheets = [k for k, layer in enumerate(layers) if layer.sheet_px]
    if sheets or any(layer.change is not None and layer.change.added_px for layer in layers):
        told = _thicken(project, one, bodies, fixed, whole, sheets, progress)
    summary = add_up(source, target, fixed, min_feature_of(options), "add_only", layers, started, [])
    done += layers
    notes = list(summary.notes)
    negative = sum(kind == "negative volume" for kind in one.others)
    if negative:
        notes.append(
            f"{counted(negative, 'negative volume')} cut by the slicer: what that leaves thin is not corrected"
        )
    if one.tilted:
        notes.append("other copies of it stand or are scaled otherwise: it is corrected as the first one stands")
    many = len(project.objects) > 1
    return summary, [f"{one.name}: {note}" if many else note for note in (*notes, *told)]


def _body(project: Project, placed: Placed) -> _Body:
    vertices, faces = project.mesh_of(placed.piece)
    at = (vertices @ placed.matrix[:3] + placed.matrix[3]) * project.mm
    if np.linalg.det(placed.matrix[:3]) < 0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return _Body(placed, Mesh(at, faces, placed.piece.name or "part"), vertices)


def _whole(bodies: Sequence[_Body], name: str) -> Mesh:
    starts = np.cumsum([0, *(len(body.mesh.vertices) for body in bodies)])[:-1]
    faces = [body.mesh.faces + np.int32(start) for body, start in zip(bodies, starts, strict=True)]
    return Mesh(np.concatenate([body.mesh.vertices for body in bodies]), np.concatenate(faces), name)


def _thicken(
    project: Project, one: ProjectObject, bodies: list[_Body], fixed: LayerStack, whole: Mesh, sheets: Sequence[int],
    progress: Progress,
) -> list[str]:  # fmt: skip
    """Unite what is added with the parts that it touches most; tells of parts that are not closed."""
    from layerfix.surface.shares import shared_out
    from layerfix.surface.smooth import joined, smooth_bodies
    from layerfix.surface.solids import united

    added, feature_mm = smooth_bodies(fixed, whole, sheets=sheets, advance=progress)
    if not added:
        return []
    told = []
    shares = shared_out([body.mesh for body in bodies], added if len(bodies) == 1 else united(added).decompose())
    for body, share in zip(bodies, shares, strict=True):
        if not share.added:
            continue
        found = joined(body.mesh, share.added, feature_mm)
        if not found.closed:
            told.append(
                f"{body.mesh.name} is no closed surface: {len(share.added)} bodies were put beside its facets as"
                " shells of their own, which slicers unite"
            )
        project.replace(body.placed.piece, *_back(project, body, found.mesh))
    return told


def _back(project: Project, body: _Body, mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A corrected part in its own coordinates: vertices that it had before are the same to the bit."""
    matrix = body.placed.matrix
    vertices = (mesh.vertices / project.mm - matrix[3]) @ np.linalg.inv(matrix[:3])
    known = {row.tobytes(): k for k, row in enumerate(np.ascontiguousarray(body.mesh.vertices))}
    for k, row in enumerate(np.ascontiguousarray(mesh.vertices)):
        before = known.get(row.tobytes())
        if before is not None:
            vertices[k] = body.local[before]
    faces = mesh.faces[:, ::-1] if np.linalg.det(matrix[:3]) < 0 else mesh.faces
    return vertices, np.ascontiguousarray(faces, np.int32)


def _together(summaries: list[Summary], notes: list[str], seconds: float) -> Summary:
    """One summary of all objects; the frame is that of the largest."""
    first = max(summaries, key=lambda s: s.size_px[0] * s.size_px[1])
    volume, added, removed = (
        sum(getattr(s, key) for s in summaries) for key in ("volume_mm3", "added_mm3", "removed_mm3")
    )
    thin = [s for s in summaries if s.thinnest_mm is not None]
    thinnest = min(thin, key=lambda s: s.thinnest_mm or 0.0, default=first)
    return replace(
        first,
        layers=sum(s.layers for s in summaries),
        layers_changed=sum(s.layers_changed for s in summaries),
        thinnest_mm=thinnest.thinnest_mm,
        thinnest_z_mm=thinnest.thinnest_z_mm,
        volume_mm3=volume,
        added_mm3=added,
        removed_mm3=removed,
        added_percent=100 * added / volume if volume else 0.0,
        removed_percent=100 * removed / volume if volume else 0.0,
        layers_with_gaps=sum(s.layers_with_gaps for s in summaries),
        longest_gap_mm=max(s.longest_gap_mm for s in summaries),
        hairline_layers=sum(s.hairline_layers for s in summaries),
        joined=tuple(change for s in summaries for change in s.joined),
        topology=tuple(change for s in summaries for change in s.topology),
        conflicts=tuple(conflict for s in summaries for conflict in s.conflicts),
        notes=tuple(notes),
        seconds=seconds,
    )
