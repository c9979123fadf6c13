"""Closed bodies from rings of points: the few shapes all built-in parts are made of.

Every function returns one Mesh of one or more bodies in mm. Each body is a closed 2-manifold whose triangles
are counter-clockwise seen from outside; bodies may overlap, which nonzero winding reads as their union.
Most of them are lofts, and most take a leading batch axis, so that a thousand rods are one numpy expression.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from layerfix.mesh.triangles import Mesh

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

TURN = 2 * np.pi
UP = np.array([0.0, 0.0, 1.0])

# Strokes of the raised letters: polylines of "xy" digit pairs on a grid 4 wide and 6 high.
GLYPHS = {
    "A": "000516364540 0343",
    "E": "46060040 0333",
    "F": "000646 0333",
    "I": "2026 1636 1030",
    "L": "060040",
    "R": "00063645443303 2340",
    "X": "0046 0640",
    "Y": "062346 2320",
    "1": "152620",
    "2": "05163645440040",
    "3": "0516364544334241301001 1333",
    "4": "30360242",
    "5": "4606033342413000",
    "6": "36160501103041423303",
    "7": "064610",
    "8": "133344453616050413 1302011030414233",
    "9": "10304145361605041343",
    ".": "4041",
}
GLYPH_ADVANCE, GLYPH_HEIGHT = 5.8, 6.0


def join(bodies: Iterable[Mesh], name: str = "shape") -> Mesh:
    """All bodies in one Mesh, their vertices kept apart."""
    parts = list(bodies)
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    return Mesh(np.concatenate([part.vertices for part in parts]), faces.astype(np.int32), name)


def cavity(shape: Mesh) -> Mesh:
    """The same bodies turned inside out: hollows in whatever they lie in."""
    return Mesh(shape.vertices, shape.faces[:, ::-1], shape.name)


def mirrored(shape: Mesh) -> Mesh:
    """Reflected at the plane x = 0."""
    return shape.transformed(np.diag([-1.0, 1.0, 1.0]))


def polar(radius_mm: ArrayLike, angle: ArrayLike, z_mm: ArrayLike = 0.0) -> Floats:
    """(..., 3) points around the z axis; the three arguments broadcast, the angle is in radians."""
    r, a, z = np.broadcast_arrays(np.asarray(radius_mm, np.float64), angle, z_mm)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)


def point(x: float, y: float, z: float = 0.0) -> Floats:
    """(3,) of a place or a shift."""
    return np.array([x, y, z], np.float64)


def raised(plan: ArrayLike, z_mm: float) -> Floats:
    """(..., 2 or 3) points of the plan → (..., 3) at the level `z_mm`."""
    return np.insert(np.asarray(plan, np.float64)[..., :2], 2, z_mm, axis=-1)


def around(count: int, start: float = 0.0) -> Floats:
    """(count,) angles evenly round the circle, in radians, from `start`."""
    return start + TURN * np.arange(count) / count


def spline(points: ArrayLike, steps: int) -> Floats:
    """(k, d) control points → (steps, d): the Catmull-Rom curve through them, evenly in its parameter."""
    p = np.asarray(points, np.float64)
    p = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = np.linspace(0, len(p) - 3, steps)
    i = np.minimum(t.astype(np.int64), len(p) - 4)
    f = (t - i)[:, None]
    a, b, c, d = (p[i + k] for k in range(4))
    curve: Floats = b + 0.5 * f * (c - a + f * (2 * a - 5 * b + 4 * c - d + f * (3 * (b - c) + d - a)))
    return curve


def loft(
    rings: ArrayLike, low: ArrayLike | None = None, high: ArrayLike | None = None, *, closed: bool = False
) -> Mesh:
    """(..., k, n, 3) rings, each counter-clockwise seen from the next, joined in order to one body a batch.

    The ends are fans round the points `low` and `high` (..., 3), by default the middle of the first and the
    last ring, so those must be star-shaped. `closed` joins the last ring to the first instead.
    """
    array = np.asarray(rings, np.float64)
    k, n = array.shape[-3:-1]
    array = array.reshape(-1, k, n, 3)
    vertices = array.reshape(len(array), k * n, 3)
    faces = _quads(k, n, closed=closed)
    if not closed:
        apexes = [
            array[:, 0].mean(axis=1) if low is None else np.reshape(low, (-1, 3)),
            array[:, -1].mean(axis=1) if high is None else np.reshape(high, (-1, 3)),
        ]
        vertices = np.concatenate([vertices, np.stack(apexes, axis=1)], axis=1)
        i, after = np.arange(n), (np.arange(n) + 1) % n
        last = (k - 1) * n
        below = np.stack([np.full(n, k * n), after, i], axis=1)
        above = np.stack([np.full(n, k * n + 1), last + i, last + after], axis=1)
        faces = np.concatenate([faces, below, above])
    count = vertices.shape[1]
    batched = faces + count * np.arange(len(array))[:, None, None]
    return Mesh(vertices.reshape(-1, 3), batched.reshape(-1, 3).astype(np.int32))


def _quads(k: int, n: int, *, closed: bool) -> Indices:
    """(m, 3) triangles of the walls between k rings of n points, numbered ring by ring."""
    j, i = np.meshgrid(np.arange(k if closed else k - 1), np.arange(n), indexing="ij")
    a, b = j * n + i, j * n + (i + 1) % n
    d, c = (a + n) % (k * n), (b + n) % (k * n)
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def tube(
    path: ArrayLike, radius_mm: ArrayLike, sides: int = 12, *, pointed: bool = False, squash: float = 1.0
) -> Mesh:
    """(..., k, 3) paths and radii that broadcast to (..., k) → round rods with flat ends.

    `pointed` makes the last point of the path a tip (its radius is not used). `squash` scales the section
    along the path's second normal. A path must not run along its flattest axis (see `_frames`).
    """
    points = np.asarray(path, np.float64)
    u, v = _frames(points)
    a = around(sides)[:, None]
    radius = np.broadcast_to(np.asarray(radius_mm, np.float64), points.shape[:-1])[..., None, None]
    section = u[..., None, :] * np.cos(a) + squash * v[..., None, :] * np.sin(a)
    rings = points[..., None, :] + radius * section
    if pointed:
        return loft(rings[..., :-1, :, :], points[..., 0, :], points[..., -1, :])
    return loft(rings, points[..., 0, :], points[..., -1, :])


def _frames(path: Floats) -> tuple[Floats, Floats]:
    """Two unit normals (..., k, 3) at each point; the first is level in the axis the path follows least.

    That axis is one for the whole path, so the frame turns smoothly: z for a helix, y for a curve in xz.
    """
    along = np.gradient(path, axis=-2)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    axis = np.abs(along).max(axis=-2, keepdims=True).argmin(axis=-1)
    u = np.cross(np.eye(3)[axis], along)
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    return u, np.cross(along, u)


def rods(start: ArrayLike, end: ArrayLike, radius_mm: ArrayLike, sides: int = 12) -> Mesh:
    """Straight round bars between (..., 3) points, a radius or one each (...); the points broadcast."""
    a, b = np.broadcast_arrays(np.asarray(start, np.float64), np.asarray(end, np.float64))
    return tube(np.stack([a, b], axis=-2), np.asarray(radius_mm, np.float64)[..., None], sides)


def posts(plan: ArrayLike, radius_mm: ArrayLike, low_mm: float, high_mm: float, sides: int = 12) -> Mesh:
    """Upright round bars over (..., 2 or 3) points of the plan."""
    return rods(raised(plan, low_mm), raised(plan, high_mm), radius_mm, sides)


def cones(start: ArrayLike, tip: ArrayLike, radius_mm: ArrayLike, sides: int = 12) -> Mesh:
    """Round spikes from (..., 3) to the tips (..., 3)."""
    a, b = np.broadcast_arrays(np.asarray(start, np.float64), np.asarray(tip, np.float64))
    return tube(np.stack([a, b], axis=-2), np.asarray(radius_mm, np.float64)[..., None], sides, pointed=True)


def balls(centres: ArrayLike, radii_mm: ArrayLike, sides: int = 32) -> Mesh:
    """Ellipsoids at (..., 3), radii (..., 3) or (..., 1), of `sides` meridians and half as many bands."""
    centre, radius = np.broadcast_arrays(np.asarray(centres, np.float64), np.asarray(radii_mm, np.float64))
    tilt = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)[1:-1, None]
    unit = polar(np.cos(tilt), around(sides), np.sin(tilt))
    rings = centre[..., None, None, :] + radius[..., None, None, :] * unit
    return loft(rings, centre - radius * UP, centre + radius * UP)


def prism(outline: ArrayLike, low_mm: float, high_mm: float) -> Mesh:
    """A counter-clockwise (..., n, 2 or 3) outline, star-shaped about its middle, from one z to another."""
    return loft(np.stack([raised(outline, low_mm), raised(outline, high_mm)], axis=-3))


def fence(outer: ArrayLike, inner: ArrayLike, low_mm: float, high_mm: float) -> Mesh:
    """An upright wall between two counter-clockwise outlines of n points each, open in the middle."""
    corners = [(inner, low_mm), (inner, high_mm), (outer, high_mm), (outer, low_mm)]
    return loft(np.stack([raised(line, z) for line, z in corners], axis=1), closed=True)


def rounded(low: ArrayLike, high: ArrayLike, radius_mm: float, inset_mm: float = 0.0) -> Floats:
    """(36, 2) outline of a rectangle with round corners; `inset_mm` moves all of it inwards."""
    a, b = np.asarray(low, np.float64) + radius_mm, np.asarray(high, np.float64) - radius_mm
    centres = np.repeat([[b[0], b[1]], [a[0], b[1]], [a[0], a[1]], [b[0], a[1]]], 9, axis=0)
    angles = np.concatenate([np.linspace(0, TURN / 4, 9) + corner * TURN / 4 for corner in range(4)])
    outline: Floats = centres + polar(radius_mm - inset_mm, angles)[:, :2]
    return outline


def boxes(low: ArrayLike, high: ArrayLike) -> Mesh:
    """Blocks between opposite corners (..., 3)."""
    a, b = np.broadcast_arrays(np.asarray(low, np.float64), np.asarray(high, np.float64))
    high_x, high_y = np.array([0, 1, 1, 0], bool), np.array([0, 0, 1, 1], bool)
    x = np.where(high_x, b[..., None, 0:1], a[..., None, 0:1])
    y = np.where(high_y, b[..., None, 1:2], a[..., None, 1:2])
    z = np.stack([a[..., 2], b[..., 2]], axis=-1)
    return loft(np.stack(np.broadcast_arrays(x, y, z[..., None]), axis=-1))


def bars(start: ArrayLike, end: ArrayLike, width_mm: ArrayLike, low_mm: float, high_mm: float) -> Mesh:
    """Upright walls between points (..., 2) of the plan, with square ends half a width past them."""
    a, b = np.broadcast_arrays(np.asarray(start, np.float64), np.asarray(end, np.float64))
    along = (b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True)
    along = along * np.asarray(width_mm, np.float64)[..., None] / 2
    left = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    corners = [a - along - left, b + along - left, b + along + left, a - along + left]
    return prism(np.stack(corners, axis=-2), low_mm, high_mm)


def wall(path: ArrayLike, width_mm: ArrayLike, low_mm: float, high_mm: float) -> Mesh:
    """One upright wall of constant or varying width along a smooth (k, 2) path of the plan."""
    line = np.asarray(path, np.float64)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1) * np.asarray(width_mm, np.float64)[..., None] / 2
    corners = [(line + left, high_mm), (line - left, high_mm), (line - left, low_mm), (line + left, low_mm)]
    return loft(np.stack([raised(edge, z) for edge, z in corners], axis=1))


def sheet(surface: ArrayLike, thickness_mm: ArrayLike) -> Mesh:
    """A (k, m, 3) grid of points thickened to both sides of it, by one thickness or (k, m) of them."""
    grid = np.asarray(surface, np.float64)
    normal = np.cross(np.gradient(grid, axis=1), np.gradient(grid, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    half = normal * np.asarray(thickness_mm, np.float64)[..., None] / 2
    rings = np.concatenate([grid + half, (grid - half)[:, ::-1]], axis=1)
    k, n = rings.shape[:2]
    # Bent ends are no stars, so each is a strip between its two long edges instead of a fan.
    i = np.arange(n // 2 - 1)
    strip = np.stack([i, i + 1, n - 2 - i, i, n - 2 - i, n - 1 - i], axis=1).reshape(-1, 3)
    faces = np.concatenate([_quads(k, n, closed=False), strip[:, ::-1], strip + (k - 1) * n])
    return Mesh(rings.reshape(-1, 3), faces.astype(np.int32))


def letters(text: str, corner: ArrayLike, height_mm: float, stroke_mm: float, low_mm: float, high_mm: float) -> Mesh:
    """Raised text, one bar a stroke; `corner` (2,) is where the first letter's lower left stroke starts."""
    lines = []
    for place, glyph in enumerate(text):
        for digits in GLYPHS[glyph].split():
            stroke = np.array([int(digit) for digit in digits], np.float64).reshape(-1, 2)
            stroke[:, 0] += place * GLYPH_ADVANCE
            lines.append(np.stack([stroke[:-1], stroke[1:]], axis=1))
    segments = np.concatenate(lines) * (height_mm / GLYPH_HEIGHT) + np.asarray(corner, np.float64)
    return bars(segments[:, 0], segments[:, 1], stroke_mm, low_mm, high_mm)
