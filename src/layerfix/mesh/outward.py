"""Closed shells that are inside out, turned so that their triangles face outwards.

Layers are filled where the winding number is not 0, so a shell that is inside out is solid all the same, alone. It is
not where it overlaps another (their windings cancel), and a surface that mixes both ways cannot be united with
anything. A shell that faces inwards within another is a hollow, and is meant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numba import types

from layerfix.kernels import njit
from layerfix.mesh.closing import POINTS, TRIANGLES, join, vertex_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh

    Floats = NDArray[np.float64]
    Faces = NDArray[np.int32]
    Flags = NDArray[np.bool_]

NUMBERS = types.Array(types.int32, 1, "C")
COUNTS = types.Array(types.int64, 1, "C")
SUMS = types.Array(types.float64, 2, "C")
FLAGS = types.Array(types.boolean, 1, "C")

SAMPLES = 9  # places of a shell that are asked whether they lie within others
ROUNDING = 1e-9  # of a shell's area, or of its box: less is nothing
INWARDS = 1e-6  # of a shell's box: so far below its triangles lie the places
DEEPEST = 8  # shells within shells


@njit(types.Tuple((NUMBERS, types.int64, types.boolean))(TRIANGLES, types.int64), cache=True, nogil=True)
def shell_labels(faces, vertices):  # type: ignore[no-untyped-def]  # numba types it
    """((m,) the number of each triangle's shell, how many there are, whether every edge has an even number).

    Triangles are of one shell if they share an edge, in opposite directions. Of more than two at an edge those that
    follow each other are partners: bodies that touch in an edge come one after the other in files.
    """
    count = faces.shape[0]
    start = np.zeros(vertices + 1, np.int64)  # of each vertex, the edges to higher ones
    for t in range(count):
        for k in range(3):
            a, b = faces[t, k], faces[t, 0 if k == 2 else k + 1]
            start[min(a, b) + 1] += a != b
    for v in range(vertices):
        start[v + 1] += start[v]
    edges = np.empty(start[vertices], np.int32)
    filled = start[:vertices].copy()
    for t in range(count):
        for k in range(3):
            a, b = faces[t, k], faces[t, 0 if k == 2 else k + 1]
            if a != b:
                edges[filled[min(a, b)]] = 3 * t + k
                filled[min(a, b)] += 1
    parent = np.empty(count, np.int32)
    for t in range(count):
        parent[t] = t
    whole = True
    # Of the edges from one vertex, by their other end: whose they are, and that of a triangle without partner so far.
    owner, waiting = np.zeros(vertices, np.int32), np.empty(vertices, np.int32)
    for v in range(vertices):
        for e in range(start[v], start[v + 1]):
            t, k = edges[e] // 3, edges[e] % 3
            from_v = faces[t, k] == v
            other = faces[t, 0 if k == 2 else k + 1] if from_v else faces[t, k]
            if owner[other] != v + 1 or waiting[other] < 0:
                owner[other], waiting[other] = v + 1, edges[e]
                continue
            a, b = waiting[other] // 3, t
            same_way = (faces[a, waiting[other] % 3] == v) == from_v
            waiting[other] = -1
            if same_way:
                continue
            join(parent, a, b)
        for e in range(start[v], start[v + 1]):
            t, k = edges[e] // 3, edges[e] % 3
            other = max(faces[t, k], faces[t, 0 if k == 2 else k + 1])
            whole &= waiting[other] < 0
    shells = 0
    for t in range(count):
        if parent[t] == t:
            parent[t] = shells
            shells += 1
        else:
            parent[t] = parent[parent[t]]  # a triangle before this one, which has its number already
    return parent, shells, whole


@njit(SUMS(POINTS, TRIANGLES, NUMBERS, types.int64), cache=True, nogil=True)
def shell_sums(points, faces, labels, count):  # type: ignore[no-untyped-def]  # numba types it
    """(count, 5) of each shell: six times its volume; twice its area as a vector, 0 if closed; twice its area."""
    sums = np.zeros((count, 5))
    x0, y0, z0 = points[0, 0], points[0, 1], points[0, 2]
    for t in range(faces.shape[0]):
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, az = points[i, 0] - x0, points[i, 1] - y0, points[i, 2] - z0
        bx, by, bz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
        cx, cy, cz = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1], points[k, 2] - points[i, 2]
        nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        s = labels[t]
        sums[s, 0] += ax * nx + ay * ny + az * nz
        sums[s, 1] += nx
        sums[s, 2] += ny
        sums[s, 3] += nz
        sums[s, 4] += (nx * nx + ny * ny + nz * nz) ** 0.5
    return sums


@njit
def _side(ax, ay, bx, by, x, y):  # type: ignore[no-untyped-def]  # numba types it
    """1 if (x, y) is left of the line from a to b, -1 if right; on it, as if it lay a little to +x, and less to +y.

    From b to a it is the very opposite.
    """
    if ax > bx or (ax == bx and ay > by):
        cross = (by - ay) * (x - bx) - (bx - ax) * (y - by)
        return -1 if (cross if cross != 0 else by - ay if ay != by else ax - bx) > 0 else 1
    cross = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
    return 1 if (cross if cross != 0 else ay - by if ay != by else bx - ax) > 0 else -1


@njit(types.void(POINTS, NUMBERS, POINTS, TRIANGLES, NUMBERS, FLAGS, COUNTS), cache=True, nogil=True)
def count_windings(places, of, points, faces, labels, asked, found):  # type: ignore[no-untyped-def]  # numba types it
    """Add to `found` how often the `asked` shells, but for each place's own, go round each place.

    places  (n, 3), by rising x;  of  (n,) the shell of each
    A ray upwards leaves what it is in through triangles that face up.
    """
    n = places.shape[0]
    for t in range(faces.shape[0]):
        shell = labels[t]
        if not asked[shell]:
            continue
        i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
        ax, ay, bx, by, cx, cy = points[i, 0], points[i, 1], points[j, 0], points[j, 1], points[k, 0], points[k, 1]
        low, high = min(ax, min(bx, cx)), max(ax, max(bx, cx))
        first, stop = 0, n
        while first < stop:
            middle = (first + stop) // 2
            if places[middle, 0] < low:
                first = middle + 1
            else:
                stop = middle
        for p in range(first, n):
            x, y = places[p, 0], places[p, 1]
            if x > high:
                break
            side = _side(ax, ay, bx, by, x, y)
            if of[p] == shell or side != _side(bx, by, cx, cy, x, y) or side != _side(cx, cy, ax, ay, x, y):
                continue
            area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            if area == 0:
                continue
            u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
            v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
            if u * points[i, 2] + v * points[j, 2] + (1 - u - v) * points[k, 2] > places[p, 2]:
                found[p] += side


def turned_outwards(mesh: Mesh) -> Mesh:
    """The mesh with every closed shell facing outwards that was inside out, hollows facing inwards; notes say so.

    One that crosses another stays as it is, and is told, too: it may be meant as a hole. Faces of parts, which are
    sliced on their own, are looked at on their own. The mesh itself if there is nothing to turn or to tell.
    """
    faces, turned, crossing = mesh.faces, 0, 0
    for span in _spans(mesh):
        own = np.ascontiguousarray(mesh.faces[span])
        over, shells, crosses = _to_turn(mesh.vertices, own)
        turned, crossing = turned + shells, crossing + crosses
        if shells:
            faces = faces.copy() if faces is mesh.faces else faces
            faces[span] = np.where(over[:, None], own[:, ::-1], own)
    notes = [f"{_bodies(turned)} inside out: turned"] if turned else []
    if crossing:
        others = "crosses another" if crossing == 1 else "cross others"
        notes.append(f"{_bodies(crossing)} inside out, and {others}: where both are, nothing is solid")
    return replace(mesh, faces=faces, notes=(*mesh.notes, *notes)) if notes else mesh


def faces_outwards(points: Floats, faces: Faces) -> bool:
    """Whether no closed shell of (m, 3) triangles is inside out: those that face inwards are hollows."""
    _, shells, crossing = _to_turn(points, faces)
    return not shells and not crossing


def _spans(mesh: Mesh) -> Iterator[slice | Flags]:
    """The faces that are sliced together, as `Mesh.pieces`."""
    if not mesh.parts:
        yield slice(None)
        return
    rest = np.ones(len(mesh.faces), np.bool_)
    for part in mesh.parts:
        span = slice(*part.faces)
        rest[span] = False
        yield span
    yield rest


def _bodies(number: int) -> str:
    return "1 body is" if number == 1 else f"{number} bodies are"


def _to_turn(points: Floats, faces: Faces) -> tuple[Flags, int, int]:
    """((m,) triangles to be turned, how many shells they are, how many are inside out and cross others)."""
    nothing = np.zeros(len(faces), np.bool_), 0, 0
    if not len(faces):
        return nothing
    labels, count, whole = shell_labels(faces, len(points))
    if not whole:  # corners that the file does not share, or a mesh that is open
        numbers = vertex_numbers(points).astype(np.int32)
        labels, count, _ = shell_labels(numbers[faces], len(points))
    sums = shell_sums(points, faces, labels, count)
    volume = sums[:, 0] / 6
    closed = np.linalg.norm(sums[:, 1:4], axis=1) <= ROUNDING * sums[:, 4]
    least = ROUNDING * sums[:, 4] ** 1.5
    if not (closed & (volume < -least)).any():
        return nothing
    solid = closed & (np.abs(volume) > least)
    places, of = _places(points, faces, labels, volume, solid)
    sign = np.ones(count, np.int64)  # -1 for shells to be turned
    crossing = np.zeros(count, np.bool_)

    def around(asked: Flags) -> NDArray[np.int64]:
        """How often the asked shells, turned as they are to be, go round each place."""
        found = np.zeros(len(places), np.int64)
        for way in (1, -1):
            some = np.zeros(len(places), np.int64)
            count_windings(places, of, points, faces, labels, asked & (sign == way), some)
            found += way * some
        return found

    for _ in range(DEEPEST):
        inwards = solid & (sign * volume < 0) & ~crossing
        if not inwards.any():
            break
        others = around(solid)
        outside = _all_of(of, others <= 0, count)
        within = _all_of(of, others > 0, count)
        crossing |= inwards & ~outside & ~within
        over = inwards & outside
        if not over.any():
            break
        held = _all_of(of, around(over) != 0, count) & solid & ~over
        sign[over | held] *= -1
    over = sign < 0
    return over[labels], int((over & (volume < 0)).sum()), int(crossing.sum())


def _all_of(of: NDArray[np.int32], holds: Flags, count: int) -> Flags:
    """(count,) shells all of whose places hold; those without any do not."""
    places = np.bincount(of, minlength=count)
    every: Flags = np.bincount(of, holds, count) == places
    return every & (places > 0)


def _places(
    points: Floats, faces: Faces, labels: NDArray[np.int32], volume: Floats, solid: Flags
) -> tuple[Floats, NDArray[np.int32]]:
    """((n, 3) places just below triangles of solid shells, by rising x; (n,) the shell of each)."""
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(len(volume) + 1))
    sizes = np.diff(starts)
    steps = np.arange(SAMPLES)[None, :] * sizes[:, None] // SAMPLES
    chosen = order[np.unique((starts[:-1, None] + steps)[solid])]
    a, b, c = (points[faces[chosen, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    some = lengths > 0
    chosen, normals, lengths, a, b, c = (one[some] for one in (chosen, normals, lengths, a, b, c))
    of = labels[chosen]
    low, high = np.full((len(volume), 3), np.inf), np.full((len(volume), 3), -np.inf)
    for k in range(3):
        np.minimum.at(low, labels, points[faces[:, k]])
        np.maximum.at(high, labels, points[faces[:, k]])
    size = np.linalg.norm(high - low, axis=1)
    below = -np.sign(volume[of]) * INWARDS * size[of] / lengths
    # Not the middle: a ray from there would run along the edges of a grid.
    places = 0.41 * a + 0.33 * b + 0.26 * c + normals * below[:, None]
    by_x = np.argsort(places[:, 0], kind="stable")
    return places[by_x], np.ascontiguousarray(of[by_x])
