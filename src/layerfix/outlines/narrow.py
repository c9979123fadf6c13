"""Where outlines come nearer to each other than the minimum feature, across the solid: exactly the places that a
correction has to look at.

What is narrower than F has two sides within F of each other that face each other across the solid: the angle between
their inward normals is 180° at a neck and in a wall, and above 131° at every corner that the metric rule thickens
(`layerfix.layers.metric`: corners blunter than 49° are left alone). A corner that points into the solid has the
normals of both its edges and all between: two such corners make a neck. So a layer without two such sides has nothing
to correct, and no pixel of it need be drawn: 0.1 ms for a layer whose correction as 4000 × 4000 px takes 35 ms.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.kernels import njit

SEGMENTS = types.Array(types.float64, 2, "C")
FACING = -0.34  # cosine of 110° between inward normals: 21° on the safe side
FAN = 0.7  # radians (40°): between normals that stand for those of a corner


@njit
def _point_to_piece(x, y, x0, y0, x1, y1):  # type: ignore[no-untyped-def]  # numba types it
    """Squared distance of a point from a piece of an edge."""
    dx, dy = x1 - x0, y1 - y0
    length2 = dx * dx + dy * dy
    t = min(max(((x - x0) * dx + (y - y0) * dy) / length2, 0.0), 1.0) if length2 > 0 else 0.0
    ex, ey = x - x0 - t * dx, y - y0 - t * dy
    return ex * ex + ey * ey


@njit
def _apart(pieces, i, j):  # type: ignore[no-untyped-def]  # numba types it
    """Squared distance of two pieces that do not cross."""
    a0, a1, a2, a3 = pieces[i, 0], pieces[i, 1], pieces[i, 2], pieces[i, 3]
    b0, b1, b2, b3 = pieces[j, 0], pieces[j, 1], pieces[j, 2], pieces[j, 3]
    return min(
        min(_point_to_piece(a0, a1, b0, b1, b2, b3), _point_to_piece(a2, a3, b0, b1, b2, b3)),
        min(_point_to_piece(b0, b1, a0, a1, a2, a3), _point_to_piece(b2, b3, a0, a1, a2, a3)),
    )


@njit
def _before(pieces, i, j):  # type: ignore[no-untyped-def]  # numba types it
    """How far piece j reaches to the solid side of piece i, at most."""
    x, y, nx, ny = pieces[i, 0], pieces[i, 1], pieces[i, 4], pieces[i, 5]
    return max(
        (pieces[j, 0] - x) * nx + (pieces[j, 1] - y) * ny,
        (pieces[j, 2] - x) * nx + (pieces[j, 3] - y) * ny,
    )


@njit
def _following(segments):  # type: ignore[no-untyped-def]  # numba types it
    """For each edge the one after it in its ring; rings stand one after the other."""
    after = np.empty(segments.shape[0], np.int64)
    first = 0
    for s in range(segments.shape[0]):
        after[s] = s + 1
        last = s + 1 == segments.shape[0]
        if last or segments[s, 2] != segments[s + 1, 0] or segments[s, 3] != segments[s + 1, 1]:
            after[s], first = first, s + 1
    return after


@njit
def _turn(segments, s, t):  # type: ignore[no-untyped-def]  # numba types it
    """By how much edge t turns from edge s, in radians; above 0 at a corner that points into the solid."""
    ax, ay = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
    bx, by = segments[t, 2] - segments[t, 0], segments[t, 3] - segments[t, 1]
    return math.atan2(ax * by - ay * bx, ax * bx + ay * by)


@njit
def _pieces(segments, reach):  # type: ignore[no-untyped-def]  # numba types it
    """Edges in pieces no longer than `reach`: x, y of both ends, and the normal into the solid. Corners that point
    into the solid are pieces without length, one for each of some normals between those of their edges."""
    after = _following(segments)
    count = 0
    for s in range(segments.shape[0]):
        length = math.hypot(segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1])
        turn = _turn(segments, s, after[s])
        count += math.ceil(length / reach) + (math.ceil(turn / FAN) - 1 if turn > FAN else 0)
    pieces = np.empty((count, 6))
    n = 0
    for s in range(segments.shape[0]):
        dx, dy = segments[s, 2] - segments[s, 0], segments[s, 3] - segments[s, 1]
        length = math.hypot(dx, dy)
        parts = math.ceil(length / reach)
        for k in range(parts):
            pieces[n, 0], pieces[n, 1] = segments[s, 0] + dx * k / parts, segments[s, 1] + dy * k / parts
            pieces[n, 2], pieces[n, 3] = segments[s, 0] + dx * (k + 1) / parts, segments[s, 1] + dy * (k + 1) / parts
            pieces[n, 4], pieces[n, 5] = dy / length, -dx / length
            n += 1
        turn = _turn(segments, s, after[s])
        fans = math.ceil(turn / FAN) if turn > FAN else 1
        for k in range(1, fans):
            c, d = math.cos(turn * k / fans), math.sin(turn * k / fans)
            pieces[n, 0] = pieces[n, 2] = segments[s, 2]
            pieces[n, 1] = pieces[n, 3] = segments[s, 3]
            pieces[n, 4], pieces[n, 5] = (c * dy + d * dx) / length, (d * dy - c * dx) / length
            n += 1
    return pieces


@njit(SEGMENTS(SEGMENTS, types.float64), cache=True, nogil=True)
def narrow_places(segments, reach):  # type: ignore[no-untyped-def]  # numba types it
    """Boxes around the pieces of edges that have another one within `reach` of them, facing them across the solid.

    segments  (n, 4) x, y of start and end in px, y down, solid on the left as seen (as `layerfix.mesh.fill` has it)
    reach     in px
    returns   (k, 4) left, top, right, bottom of each piece, no longer than `reach`
    """
    pieces = _pieces(segments, reach)
    count = pieces.shape[0]
    if count == 0:
        return np.empty((0, 4))
    left, top, right, bottom = math.inf, math.inf, -math.inf, -math.inf
    for i in range(count):
        x, y = (pieces[i, 0] + pieces[i, 2]) / 2, (pieces[i, 1] + pieces[i, 3]) / 2
        left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
    # Middles of pieces within `reach` of each other are within 2 · reach. No more cells than a few per piece.
    cell = 2 * reach
    while (math.floor((right - left) / cell) + 1) * (math.floor((bottom - top) / cell) + 1) > 64 * count + 4096:
        cell *= 2
    across, down = math.floor((right - left) / cell) + 1, math.floor((bottom - top) / cell) + 1
    starts = np.zeros(across * down + 1, np.int64)
    where = np.empty(count, np.int64)
    for i in range(count):
        column = math.floor(((pieces[i, 0] + pieces[i, 2]) / 2 - left) / cell)
        row = math.floor(((pieces[i, 1] + pieces[i, 3]) / 2 - top) / cell)
        where[i] = row * across + column
        starts[where[i] + 1] += 1
    for c in range(across * down):
        starts[c + 1] += starts[c]
    order, filled = np.empty(count, np.int64), starts[:-1].copy()
    for i in range(count):
        order[filled[where[i]]] = i
        filled[where[i]] += 1
    found = np.zeros(count, np.bool_)
    for i in range(count):
        row, column = where[i] // across, where[i] % across
        for r in range(max(row - 1, 0), min(row + 2, down)):
            first, last = r * across + max(column - 1, 0), r * across + min(column + 1, across - 1)
            for at in range(starts[first], starts[last + 1]):
                j = order[at]
                if (
                    j > i
                    and not (found[i] and found[j])
                    and pieces[i, 4] * pieces[j, 4] + pieces[i, 5] * pieces[j, 5] < FACING
                    and _before(pieces, i, j) > 1e-6
                    and _before(pieces, j, i) > 1e-6
                    and _apart(pieces, i, j) <= reach * reach
                ):
                    found[i] = found[j] = True
    n = 0
    for i in range(count):
        n += found[i]
    boxes = np.empty((n, 4))
    n = 0
    for i in range(count):
        if found[i]:
            boxes[n, 0], boxes[n, 1] = min(pieces[i, 0], pieces[i, 2]), min(pieces[i, 1], pieces[i, 3])
            boxes[n, 2], boxes[n, 3] = max(pieces[i, 0], pieces[i, 2]), max(pieces[i, 1], pieces[i, 3])
            n += 1
    return boxes
