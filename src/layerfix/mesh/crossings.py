"""Where facets cross columns through pixels' centres, between two heights: what `layerfix.mesh.sheets` walks along.

Coordinates are the cutter's: column, row, z quanta. A facet covers the centres that `fill` would give it: half-open
along the row and across it, so neighbours never both claim a centre and never leave one out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.kernels import njit
from layerfix.mesh.fill import EVEN_ODD, NONZERO, below

TILE = 16  # px
SLAB = 16  # intervals whose facets are looked through at once; at most 62, the bits of a mask
Z_BITS = 30
POINTS = types.Array(types.float64, 2, "C", readonly=True)
TRIANGLES = types.Array(types.int32, 2, "C", readonly=True)
INDICES = types.Array(types.int32, 1, "C")
HEIGHTS = types.Array(types.float64, 1, "C", readonly=True)
KEYS = types.Array(types.int64, 1, "C")


@njit
def _area(points, a, b, c):  # type: ignore[no-untyped-def]
    """Twice the area seen from above, above 0 for a facet that faces down (rows run downwards)."""
    return (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1]) - (points[c, 0] - points[a, 0]) * (
        points[b, 1] - points[a, 1]
    )


@njit
def _box(points, a, b, c):  # type: ignore[no-untyped-def]
    """Least and greatest x and y of a facet."""
    return (
        min(points[a, 0], points[b, 0], points[c, 0]),
        max(points[a, 0], points[b, 0], points[c, 0]),
        min(points[a, 1], points[b, 1], points[c, 1]),
        max(points[a, 1], points[b, 1], points[c, 1]),
    )


@njit
def _rows_between(points, a, b, c, low, high):  # type: ignore[no-untyped-def]
    """Least and greatest y of a facet's part in low ≤ z ≤ high, a little more."""
    y0, y1 = math.inf, -math.inf
    for p, q in ((a, b), (b, c), (c, a)):
        dz = points[q, 2] - points[p, 2]
        first, last = 0.0, 1.0
        if dz != 0:
            one, other = (low - points[p, 2]) / dz, (high - points[p, 2]) / dz
            first, last = max(first, min(one, other)), min(last, max(one, other))
        elif not low <= points[p, 2] <= high:
            continue
        if first <= last:
            one = points[p, 1] + first * (points[q, 1] - points[p, 1])
            other = points[p, 1] + last * (points[q, 1] - points[p, 1])
            y0, y1 = min(y0, one, other), max(y1, one, other)
    return y0 - 1e-6, y1 + 1e-6


@njit
def _tiles(box, across, along):  # type: ignore[no-untyped-def]
    """(first, last) column and row of the tiles in which what has that box may cover a centre; first > last: none."""
    x0, x1, y0, y1 = box
    i0, i1, j0, j1 = math.ceil(x0), math.ceil(x1) - 1, math.ceil(y0), math.ceil(y1) - 1
    if i1 < i0 or j1 < j0 or i1 < 0 or j1 < 0:
        return 1, 0, 1, 0
    return max(i0, 0) // TILE, min(i1 // TILE, across - 1), max(j0, 0) // TILE, min(j1 // TILE, along - 1)


@njit(
    types.Tuple((types.Array(types.int64, 1, "C"), INDICES))(POINTS, TRIANGLES, HEIGHTS, types.int64, types.int64),
    cache=True,
    nogil=True,
)
def slabs_of(points, faces, edges, across, along):  # type: ignore[no-untyped-def]
    """Facets that may cover a centre, by the slabs of SLAB intervals edges[q] < z ≤ edges[q + 1] they reach into."""
    slabs = (edges.shape[0] - 1 + SLAB - 1) // SLAB
    starts = np.zeros(slabs + 1, np.int64)
    span = np.zeros((faces.shape[0], 2), np.int32)
    for t in range(faces.shape[0]):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        u0, u1, v0, v1 = _tiles(_box(points, a, b, c), across, along)
        if u1 < u0 or v1 < v0 or _area(points, a, b, c) == 0:
            continue
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        first = max(below(edges, min(za, zb, zc)) - 1, 0)
        last = max(below(edges, max(za, zb, zc)) - 1, 0)
        span[t, 0], span[t, 1] = first // SLAB, last // SLAB + 1
        for s in range(span[t, 0], span[t, 1]):
            starts[s + 1] += 1
    for s in range(slabs):
        starts[s + 1] += starts[s]
    out = np.empty(starts[slabs], np.int32)
    where = starts.copy()
    for t in range(faces.shape[0]):
        for s in range(span[t, 0], span[t, 1]):
            out[where[s]] = t
            where[s] += 1
    return starts, out


@njit(
    INDICES(POINTS, TRIANGLES, INDICES, HEIGHTS, types.int64, types.int64, types.int64, types.boolean),
    cache=True,
    nogil=True,
)
def paired(points, faces, chosen, edges, q0, across, along, alike):  # type: ignore[no-untyped-def]
    """Of the facets of the slab from interval q0 on, those that share a tile and an interval with one that faces the
    other way (`alike`: with any other)."""
    masks = np.zeros(chosen.shape[0], np.int64)
    seen = np.zeros((2, along, across), np.int64)
    again = np.zeros((along if alike else 0, across), np.int64)
    most = min(edges.shape[0] - 1 - q0, SLAB) - 1
    for p in range(chosen.shape[0]):
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        first = min(max(below(edges, min(za, zb, zc)) - 1 - q0, 0), most)
        last = min(max(below(edges, max(za, zb, zc)) - 1 - q0, 0), most)
        masks[p] = (np.int64(2) << last) - (np.int64(1) << first)
        up = np.int64(_area(points, a, b, c) < 0)
        u0, u1, v0, v1 = _tiles(_box(points, a, b, c), across, along)
        for v in range(v0, v1 + 1):
            for u in range(u0, u1 + 1):
                if alike:
                    again[v, u] |= (seen[0, v, u] | seen[1, v, u]) & masks[p]
                seen[up, v, u] |= masks[p]
    out = np.empty(chosen.shape[0], np.int32)
    n = 0
    for p in range(chosen.shape[0]):
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        up = np.int64(_area(points, a, b, c) < 0)
        u0, u1, v0, v1 = _tiles(_box(points, a, b, c), across, along)
        wanted = np.int64(0)
        for v in range(v0, v1 + 1):
            for u in range(u0, u1 + 1):
                wanted |= masks[p] & (again[v, u] if alike else seen[1 - up, v, u])
        if wanted:
            out[n] = chosen[p]
            n += 1
    return out[:n].copy()


@njit
def _may_hold(floor, ceiling, rule, least):  # type: ignore[no-untyped-def]
    """Whether among facets that face up (0) and down (1) two may bound a stretch of solid of that height."""
    if rule == EVEN_ODD and max(ceiling[0], ceiling[1]) - min(floor[0], floor[1]) >= least:
        return True
    return ceiling[0] - floor[1] >= least or (rule == NONZERO and ceiling[1] - floor[0] >= least)


@njit
def _slope(points, p, q):  # type: ignore[no-untyped-def]
    dy = points[q, 1] - points[p, 1]
    return (points[q, 0] - points[p, 0]) / dy if dy != 0 else 0.0


@njit
def _met(points, p, q, slope, j, first, stop):  # type: ignore[no-untyped-def]
    """Columns of row j from the least to the greatest at which the edges so far and that from p to q cross it."""
    y0, y1, x0 = points[p, 1], points[q, 1], points[p, 0]
    if y1 < y0:
        y0, y1, x0 = y1, y0, points[q, 0]
    if y0 <= j < y1:
        here = np.int64(math.ceil(x0 + (j - y0) * slope))
        return min(first, here), max(stop, here)
    return first, stop


@njit
def longer(keys):  # type: ignore[no-untyped-def]
    """The same list with room for as many more."""
    longer = np.empty(2 * keys.shape[0], np.int64)
    for i in range(keys.shape[0]):
        longer[i] = keys[i]
    return longer


@njit
def _pushed(keys, k, pixel, place, begins):  # type: ignore[no-untyped-def]
    """(keys with one more, their number)."""
    if k == keys.shape[0]:
        keys = longer(keys)
    keys[k] = (pixel << (Z_BITS + 1)) | (place << 1) | begins
    return keys, k + 1


@njit(
    KEYS(
        POINTS, TRIANGLES, INDICES, types.float64, types.float64, types.float64,
        types.int64, types.int64, types.int64,
    ),
    cache=True,
    nogil=True,
)  # fmt: skip
def crossings(points, faces, chosen, low, high, least, width, height, rule):  # type: ignore[no-untyped-def]
    """Where facets cross low < z ≤ high over centres: pixel · 2^31 + place · 2 + (1 if the solid begins, upwards).

    least  only in tiles where one facet may begin a stretch of solid and another end it so much above; 0: all of them
    """
    across, along = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    floor = np.full((2, along, across), np.float32(math.inf))  # of what faces up, and down
    ceiling = np.full((2, along, across), np.float32(-math.inf))
    most = 0
    span = np.zeros((chosen.shape[0], 2), np.int32)
    for p in range(chosen.shape[0]):
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        if max(za, zb, zc) > low and min(za, zb, zc) <= high:
            y0, y1 = _rows_between(points, a, b, c, low, high)
            if y0 < height and y1 >= 0:
                span[p, 0], span[p, 1] = max(math.ceil(y0), 0), min(math.floor(y1) + 1, height)
                most += max(span[p, 1] - span[p, 0], 0)
    runs, planes, n = np.empty((most, 4), np.int32), np.empty((most, 2), np.float64), 0
    for p in range(chosen.shape[0]):
        if span[p, 1] <= span[p, 0]:
            continue
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        z0, z1 = min(za, zb, zc), max(za, zb, zc)
        xa, ya, area = points[a, 0], points[a, 1], _area(points, a, b, c)
        ux, uy, uz = points[b, 0] - xa, points[b, 1] - ya, zb - za
        vx, vy, vz = points[c, 0] - xa, points[c, 1] - ya, zc - za
        gx, gy = (uz * vy - vz * uy) / area, (ux * vz - vx * uz) / area
        ab, bc, ca = _slope(points, a, b), _slope(points, b, c), _slope(points, c, a)
        down = np.int64(area > 0)
        for j in range(span[p, 0], span[p, 1]):
            first, stop = _met(points, a, b, ab, j, np.int64(1) << 40, -(np.int64(1) << 40))
            first, stop = _met(points, b, c, bc, j, first, stop)
            first, stop = _met(points, c, a, ca, j, first, stop)
            first, stop = max(first, 0), min(stop, width)
            if stop <= first:
                continue
            at_row = za + gy * (j - ya) - gx * xa
            if gx != 0 and stop - first > 2:  # only where the facet is between the two heights
                one, other = (low - at_row) / gx, (high - at_row) / gx
                first = max(first, math.floor(min(max(min(one, other), -1.0), width)) - 1)
                stop = min(stop, math.ceil(max(min(max(one, other), width), -1.0)) + 2)
                if stop <= first:
                    continue
            for u in range(first // TILE, (stop - 1) // TILE + 1):
                one = at_row + gx * max(first, u * TILE)
                other = at_row + gx * min(stop - 1, u * TILE + TILE - 1)
                v = j // TILE
                floor[down, v, u] = min(floor[down, v, u], max(min(one, other), z0, low))
                ceiling[down, v, u] = max(ceiling[down, v, u], min(max(one, other), z1, high))
            runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3] = p, j, first, stop
            planes[n, 0], planes[n, 1] = at_row, gx
            n += 1
    keys, k = np.empty(256, np.int64), 0
    scale = ((1 << Z_BITS) - 2) / (high - low)
    for r in range(n):
        p, j, first, stop = runs[r]
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        z0, z1 = min(za, zb, zc), max(za, zb, zc)
        begins = np.int64(_area(points, a, b, c) > 0)
        for u in range(first // TILE, (stop - 1) // TILE + 1):
            if least > 0 and not _may_hold(floor[:, j // TILE, u], ceiling[:, j // TILE, u], rule, 0.99 * least):
                continue
            for i in range(max(first, u * TILE), min(stop, u * TILE + TILE)):
                z = min(max(planes[r, 0] + planes[r, 1] * i, z0), z1)
                if low < z <= high:
                    place = min(max(np.int64((z - low) * scale) + 1, 1), (1 << Z_BITS) - 1)
                    keys, k = _pushed(keys, k, np.int64(j) * width + i, place, begins)
    return keys[:k].copy()
