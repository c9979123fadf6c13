"""What layers cannot see: what is thin along x or y, found, and thickened, by slicing the mesh along these axes, too.

A layer shows how wide things are in its plane. A plate that lies flat is wide in every layer, and may be a tenth of a
millimetre thick.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from layerfix.commands.options import flag, min_feature_of
from layerfix.errors import InputError
from layerfix.layers.correction import correct
from layerfix.layers.verdict import judge, narrowest_place
from layerfix.mesh.slicing import plate_mm, slice_mesh
from layerfix.units import counted, format_mm

if TYPE_CHECKING:
    from layerfix.commands.options import Options
    from layerfix.layers.skeleton import Spurs
    from layerfix.mesh.triangles import Mesh

Progress = Callable[[int, int], None]

# Which coordinate comes where so that the axis points up; both keep the sense of triangles.
TURNS = {"x": (1, 2, 0), "y": (2, 0, 1)}


@dataclass(frozen=True)
class AxisVerdict:
    """One axis across: what its slices have that is narrower than F.

    axis           "x" or "y"
    features_lost  as in a layer's verdict, over all slices
    slices         with any of them, and `of` how many
    thinnest_mm    width at the narrowest place, None if nothing is narrower
    thinnest_at_mm ((x, x), (y, y), (z, z)) of that place on the plate
    """

    axis: str
    features_lost: int
    slices: int
    of: int
    thinnest_mm: float | None
    thinnest_at_mm: tuple[tuple[float, float], ...] | None


def check_axes(axes: str) -> tuple[str, ...]:
    """The axes across among "xyz", which always has z. Raises InputError for other letters."""
    if "z" not in axes or set(axes) - set("xyz") or len(set(axes)) != len(axes):
        raise InputError(f"axes '{axes}': z, and x or y or both, such as xyz")
    return tuple(axis for axis in "xy" if axis in axes)


def judge_across(
    mesh: Mesh,
    axis: str,
    pixel_mm: float,
    min_feature_mm: float,
    spurs: Spurs,
    workers: int,
    progress: Progress,
) -> AxisVerdict:
    """The mesh, sliced along x or y at `pixel_mm`, judged at the minimum feature."""
    order = TURNS[axis]
    turned = mesh.transformed(np.eye(3)[list(order)])
    stack = slice_mesh(turned, pixel_mm=pixel_mm, layer_mm=pixel_mm, margin_mm=min_feature_mm).with_workers(workers)
    lost, slices, narrow, where = 0, 0, np.inf, -1
    for k, verdict in enumerate(judge(stack, min_feature_mm=min_feature_mm, spurs=spurs)):
        lost += verdict.features_lost
        slices += verdict.features_lost > 0
        if verdict.thinnest_mm is not None and verdict.thinnest_mm < narrow:
            narrow, where = verdict.thinnest_mm, k
        progress(k + 1, len(stack))
    place = None
    if where >= 0:
        place = narrowest_place(stack, where, min_feature_mm=min_feature_mm, of_void=False, spurs=spurs)
    at = None
    if place is not None:
        left, bottom, right, top = place.box_mm
        low, high = (z + plate_mm(stack) for z in place.z_mm)
        found = dict(zip(order, ((left, right), (bottom, top), (low, high)), strict=True))
        plate = float(mesh.bounds_mm[0, 2])
        at = (found[0], found[1], (found[2][0] - plate, found[2][1] - plate))
    return AxisVerdict(axis, lost, slices, len(stack), float(narrow) if where >= 0 else None, at)


def line_of(found: AxisVerdict, min_feature_mm: float) -> tuple[str, str]:
    """What a user wants to see."""
    if found.thinnest_mm is None:
        return f"along {found.axis}", f"nothing is narrower than {format_mm(min_feature_mm)}"
    text = (
        f"{counted(found.features_lost, 'feature')} narrower than {format_mm(min_feature_mm)} in {found.slices} of"
        f" {found.of} slices, the thinnest {format_mm(round(found.thinnest_mm, 4))}"
    )
    if found.thinnest_at_mm is not None:
        text += " in " + ", ".join(
            f"{name} {low:.2f} to {high:.2f}" for name, (low, high) in zip("xyz", found.thinnest_at_mm, strict=True)
        )
    return f"along {found.axis}", text + " mm"


def thicker_across(mesh: Mesh, pixel_mm: float | tuple[float, float], options: Options, progress: Progress) -> Mesh:
    """The mesh with what is thin along x and y thickened, as layers along these axes show it; z comes afterwards.

    Its own facets stay elsewhere, as in a smooth surface; notes say how much was added.
    Raises InputError for other axes, for what is kept free and volumes that are cut out (these bodies know nothing of
    them), and as `smooth_surface`.
    """
    axes, how = options.slicing.axes or "z", options.correction
    given = [name for name in ("keep_gaps_mm", "keep_out", "min_layers") if getattr(how, name) is not None]
    given += ["grow"] if how.grow not in (None, "both") else []
    given += ["ignore_specks"] if how.ignore_specks else []
    if given:
        raise InputError(f"--axes {axes}: does not go with {', '.join(map(flag, given))}")
    if mesh.is_clipped:
        raise InputError(f"--axes {axes}: does not go with volumes that are cut out of others, as in {mesh.name}")
    for axis in check_axes(axes):
        mesh = _thicker_along(mesh, axis, pixel_mm, options, progress)
    return mesh


def _thicker_along(
    mesh: Mesh, axis: str, pixel_mm: float | tuple[float, float], options: Options, progress: Progress
) -> Mesh:
    from layerfix.surface.kinds import Telling, smoothly

    how, min_feature_mm = options.correction, min_feature_of(options)
    turn = np.eye(3)[list(TURNS[axis])]
    turned = mesh.transformed(turn)
    pitch_mm = max(pixel_mm) if isinstance(pixel_mm, tuple) else pixel_mm
    stack = slice_mesh(turned, pixel_mm=pitch_mm, layer_mm=pitch_mm, margin_mm=min_feature_mm,
                       fill=options.slicing.fill or "nonzero")  # fmt: skip
    fixed = correct(stack, min_feature_mm=min_feature_mm, mode="add_only", spurs=how.spurs or "metric",
                    ignore_below_mm2=how.ignore_below_mm2 or 0.0).with_workers(options.run.workers)  # fmt: skip
    found = smoothly(fixed, turned, None, Telling(lambda k, _: progress(k + 1, len(fixed)), progress))
    if not found.bodies:
        return mesh
    added_mm3 = found.mesh.volume_mm3 - turned.volume_mm3
    note = f"along {axis}: {found.bodies} {'body' if found.bodies == 1 else 'bodies'} added where it was thin"
    note += f", {added_mm3:.4g} mm³" if found.closed else ", beside its facets, as it is no closed surface"
    return replace(found.mesh.transformed(turn.T), notes=(*mesh.notes, note))
