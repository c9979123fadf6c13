"""Beams and balls of a lattice as closed meshes. Specification: 3MF beam lattice extension 1.2, section 2.

A beam is a truncated cone; its ends are flat ("butt"), half spheres ("hemisphere") or whole spheres ("sphere").
Circles become polygons of the same area, so that a beam weighs what it should however few sides it has.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.mesh.model_3mf import Lattice

if TYPE_CHECKING:
    from numpy.typing import NDArray

Shape = tuple["NDArray[np.float64]", "NDArray[np.int32]"]

FINE_MM = 0.002  # how far a polygon may be from its circle
FEWEST, MOST = 16, 64  # sides
CAPS = ("sphere", "hemisphere", "butt")


def solid_beams(points: NDArray[np.float64], lattice: Lattice, unit_mm: float) -> tuple[Shape, int]:
    """((vertices, faces) of all beams and balls, as shells that cross each other; beams that are too short to count).

    points   (n, 3) of the mesh that the lattice is on, in the file's unit
    unit_mm  of which one is so many mm: it decides how many sides are needed
    Raises InputError for vertices that are not there and radii that are not above 0.
    """
    ends = np.array(lattice.ends, np.int64).reshape(-1, 2)
    radii = np.array(lattice.radii, np.float64).reshape(-1, 2)
    caps = np.array([[_cap(a), _cap(b)] for a, b in lattice.caps], np.int64).reshape(-1, 2)
    balls, ball_radii = _balls(lattice, ends)
    named = np.concatenate([ends.reshape(-1), balls])
    if len(named) and not 0 <= named.min() <= named.max() < len(points):
        raise InputError(f"a beam names vertex {named.max() if named.min() >= 0 else named.min()} of {len(points)}")
    every = np.concatenate([radii.reshape(-1), ball_radii])
    if not ((every > 0) & np.isfinite(every)).all():
        raise InputError(f"a beam has the radius {every[~((every > 0) & np.isfinite(every))][0]:g}; it is above 0")
    length = np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)
    long_enough = (length >= lattice.min_length) & (length > 0)
    short = int(np.count_nonzero(~long_enough))
    ends, radii, caps = ends[long_enough], radii[long_enough], caps[long_enough]
    if not len(ends) and not len(balls):
        return (np.empty((0, 3)), np.empty((0, 3), np.int32)), short
    sides = sides_of(float(every.max()) * unit_mm)
    shapes = [_cones(points, ends[chosen], radii[chosen], first, second, sides)
              for first in (False, True) for second in (False, True)
              if (chosen := ((caps[:, 0] == 1) == first) & ((caps[:, 1] == 1) == second)).any()]  # fmt: skip
    spheres = caps == CAPS.index("sphere")
    centres, largest = _largest(np.concatenate([ends[spheres], balls]), np.concatenate([radii[spheres], ball_radii]))
    if len(centres):
        shapes.append(_spheres(points[centres], largest, sides))
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in shapes)])
    faces = [f + start for (_, f), start in zip(shapes, starts[:-1], strict=True)]
    return (np.concatenate([v for v, _ in shapes]), np.concatenate(faces).astype(np.int32)), short


def sides_of(radius_mm: float) -> int:
    """Sides of a polygon that stays within FINE_MM of a circle, a multiple of 4."""
    needed = math.pi / math.sqrt(2 * FINE_MM / max(radius_mm, FINE_MM))
    return min(max(4 * math.ceil(needed / 4), FEWEST), MOST)


def _cap(name: str) -> int:
    if name not in CAPS:
        raise InputError(f"a beam has the cap '{name[:40]}'; known are {', '.join(CAPS)}")
    return CAPS.index(name)


def _balls(lattice: Lattice, ends: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(vertices, radii) of the balls there are: none, those listed, or one at each end of a beam."""
    if lattice.ball_mode not in ("none", "mixed", "all"):
        raise InputError(f"ballmode '{lattice.ball_mode[:40]}'; known are none, mixed, all")
    listed = dict(lattice.balls) if lattice.ball_mode != "none" else {}
    if lattice.ball_mode == "all":
        listed = {int(v): lattice.ball_radius for v in np.unique(ends)} | listed
    return np.array(list(listed), np.int64), np.array(list(listed.values()), np.float64)


def _largest(places: NDArray[np.int64], radii: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Each vertex once, with the largest sphere round it, which holds the others."""
    order = np.lexsort((-radii, places))
    places, radii = places[order], radii[order]
    first = np.concatenate([[True], places[1:] != places[:-1]]) if len(places) else np.empty(0, np.bool_)
    return places[first], radii[first]


def _cones(
    points: NDArray[np.float64],
    ends: NDArray[np.int64],
    radii: NDArray[np.float64],
    round_start: bool,
    round_end: bool,
    sides: int,
) -> Shape:
    """Truncated cones, with half spheres where they are asked for: rings along each beam, closed by two tips."""
    start, end = points[ends[:, 0]], points[ends[:, 1]]
    along = end - start
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    zeros, one = np.zeros_like(length), np.ones_like(length)
    tilt = np.linspace(0, np.pi / 2, sides // 4 + 1)[1:-1]
    r1, r2 = radii.T
    offsets = [-r1 * np.sin(a) for a in tilt[::-1]] if round_start else []
    widths = [r1 * np.cos(a) for a in tilt[::-1]] if round_start else []
    offsets += [zeros, length]
    widths += [r1, r2]
    if round_end:
        offsets += [length + r2 * np.sin(a) for a in tilt]
        widths += [r2 * np.cos(a) for a in tilt]
    tips = np.stack([-r1 * one if round_start else zeros, length + r2 if round_end else length], axis=1)
    return _revolved(start, along, np.stack(offsets, axis=1), np.stack(widths, axis=1), tips, sides)


def _spheres(centres: NDArray[np.float64], radii: NDArray[np.float64], sides: int) -> Shape:
    tilt = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)[1:-1]
    up = np.broadcast_to([0.0, 0.0, 1.0], centres.shape)
    tips = np.stack([-radii, radii], axis=1)
    return _revolved(centres, up, np.outer(radii, np.sin(tilt)), np.outer(radii, np.cos(tilt)), tips, sides)


def _revolved(
    origin: NDArray[np.float64],
    along: NDArray[np.float64],
    offsets: NDArray[np.float64],
    widths: NDArray[np.float64],
    tips: NDArray[np.float64],
    sides: int,
) -> Shape:
    """n closed solids of revolution of k rings each, all facing outwards.

    origin, along (n, 3); offsets and widths (n, k) of the rings, rising along the axis; tips (n, 2) where it ends.
    """
    n, k = offsets.shape
    axis = np.eye(3)[np.abs(along).argmin(axis=1)]
    u = np.cross(axis, along)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(along, u)
    turn = 2 * np.pi / sides
    angle = turn * (np.arange(sides) + 0.5)
    widths = widths * math.sqrt(turn / math.sin(turn))  # the polygon has the circle's area
    circle = u[:, None] * np.cos(angle)[:, None] + v[:, None] * np.sin(angle)[:, None]  # (n, sides, 3)
    rings = (origin[:, None] + offsets[..., None] * along[:, None])[:, :, None] + widths[..., None, None] * circle[
        :, None
    ]
    ends = origin[:, None] + tips[..., None] * along[:, None]
    vertices = np.concatenate([rings.reshape(n, k * sides, 3), ends], axis=1)
    i = np.arange(sides)
    after = (i + 1) % sides
    walls = [np.stack([j * sides + a, j * sides + b, (j + 1) * sides + c], axis=1)
             for j in range(k - 1) for a, b, c in ((i, after, after),)]  # fmt: skip
    walls += [np.stack([j * sides + i, (j + 1) * sides + after, (j + 1) * sides + i], axis=1) for j in range(k - 1)]
    low = np.stack([np.full(sides, k * sides), after, i], axis=1)
    high = np.stack([np.full(sides, k * sides + 1), (k - 1) * sides + i, (k - 1) * sides + after], axis=1)
    one = np.concatenate([*walls, low, high])
    faces = one + (k * sides + 2) * np.arange(n)[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32)
