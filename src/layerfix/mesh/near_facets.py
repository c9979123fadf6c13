"""Which facets are worth a look where: those that may cover a pixel's centre in a tile, between two heights, together
with one that faces the other way. `layerfix.mesh.crossings` looks at these, centre by centre.

Coordinates are the cutter's: column, row, z quanta. Facets may be taken for near that are not, never the other way.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.kernels import njit
from layerfix.mesh.fill import below

TILE = 8  # px
SLAB = 16  # intervals whose facets are looked through at once; at most 62, the bits of a mask
POINTS = types.Array(types.float64, 2, "C", readonly=True)
TRIANGLES = types.Array(types.int32, 2, "C", readonly=True)
INDICES = types.Array(types.int32, 1, "C")
HEIGHTS = types.Array(types.float64, 1, "C", readonly=True)
MASKS = types.Array(types.int64, 1, "C")
MARGIN_PX = 1e-6


@njit
def area_of(points, a, b, c):  # type: ignore[no-untyped-def]
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
        if u1 < u0 or v1 < v0 or area_of(points, a, b, c) == 0:
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


@njit
def longer_table(runs):  # type: ignore[no-untyped-def]
    """The same table with room for as many more rows."""
    more = np.empty((2 * runs.shape[0], 4), np.int32)
    for r in range(runs.shape[0]):
        for k in range(4):
            more[r, k] = runs[r, k]
    return more


@njit
def _cut_off(points, a, b, c, low, high, xs, ys):  # type: ignore[no-untyped-def]
    """Corners of a facet's part in low ≤ z ≤ high, one after the other. Returns how many there are, at most 9."""
    za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
    if max(za, zb, zc) <= high and min(za, zb, zc) >= low:
        xs[0], xs[1], xs[2] = points[a, 0], points[b, 0], points[c, 0]
        ys[0], ys[1], ys[2] = points[a, 1], points[b, 1], points[c, 1]
        return 3
    n = 0
    for p, q in ((a, b), (b, c), (c, a)):
        zp, zq = points[p, 2], points[q, 2]
        if low <= zp <= high:
            xs[n], ys[n] = points[p, 0], points[p, 1]
            n += 1
        for z in (low, high) if zp < zq else (high, low):
            if min(zp, zq) < z < max(zp, zq):
                part = (z - zp) / (zq - zp)
                xs[n] = points[p, 0] + part * (points[q, 0] - points[p, 0])
                ys[n] = points[p, 1] + part * (points[q, 1] - points[p, 1])
                n += 1
    return n


@njit
def _reach(xs, ys, n, v0, v1, least, most):  # type: ignore[no-untyped-def]
    """least[v], most[v] = the x from which and to which a convex shape with n corners reaches among the rows of
    tiles v0 … v1."""
    for v in range(v0, v1 + 1):
        least[v], most[v] = math.inf, -math.inf
    for k in range(n):
        x0, y0, x1, y1 = xs[k], ys[k], xs[k - 1 if k else n - 1], ys[k - 1 if k else n - 1]
        if y1 < y0:
            x0, y0, x1, y1 = x1, y1, x0, y0
        first = max(math.floor((y0 - MARGIN_PX) / TILE), v0)
        last = min(math.floor((y1 + MARGIN_PX) / TILE), v1)
        slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
        for v in range(first, last + 1):
            above, under = v * TILE - MARGIN_PX, v * TILE + TILE - 1 + MARGIN_PX
            if y1 < above or y0 > under:
                continue
            one = x0 if y0 >= above else x0 + (above - y0) * slope
            other = x1 if y1 <= under else x0 + (under - y0) * slope
            least[v], most[v] = min(least[v], one, other), max(most[v], one, other)


@njit
def _strips(points, a, b, c, low, high, along, xs, ys, least, most):  # type: ignore[no-untyped-def]
    """(first, last) row of the tiles in which a facet's part in low ≤ z ≤ high may cover centres; first > last: none.
    least[v], most[v] = the x between which it may, among the centres of a row of tiles."""
    corners = _cut_off(points, a, b, c, low, high, xs, ys)
    if corners == 0:
        return 1, 0
    x0, x1, y0, y1 = xs[0], xs[0], ys[0], ys[0]
    for k in range(1, corners):
        x0, x1, y0, y1 = min(x0, xs[k]), max(x1, xs[k]), min(y0, ys[k]), max(y1, ys[k])
    x0, x1, y0, y1 = x0 - MARGIN_PX, x1 + MARGIN_PX, y0 - MARGIN_PX, y1 + MARGIN_PX
    first, last = math.ceil(y0), math.floor(y1)
    if last < first or last < 0 or math.ceil(x0) > math.floor(x1):
        return 1, 0
    v0, v1 = max(first, 0) // TILE, min(last // TILE, along - 1)
    if v1 - v0 < 2 and x1 - x0 < TILE:
        for v in range(v0, v1 + 1):
            least[v], most[v] = x0, x1
    elif v0 <= v1:
        _reach(xs, ys, corners, v0, v1, least, most)
    return v0, v1


@njit
def _tiles_between(least, most, width):  # type: ignore[no-untyped-def]
    """(first, last) tile of a row of tiles that holds centres between two x; first > last: none."""
    i0, i1 = math.ceil(least - MARGIN_PX), math.floor(most + MARGIN_PX)
    if i1 < i0 or i1 < 0 or i0 >= width:
        return 1, 0
    return max(i0, 0) // TILE, min(i1, width - 1) // TILE


@njit
def _with_strip(strips, n, p, v, u0, u1):  # type: ignore[no-untyped-def]
    """A table of strips (facet, row of tiles, first and last tile) with one more as its n-th; longer if need be."""
    if n == strips.shape[0]:
        strips = longer_table(strips)
    strips[n, 0], strips[n, 1], strips[n, 2], strips[n, 3] = p, v, u0, u1
    return strips


@njit(
    types.Tuple((INDICES, MASKS))(
        POINTS, TRIANGLES, INDICES, HEIGHTS, types.int64, types.int64, types.int64, types.boolean
    ),
    cache=True,
    nogil=True,
)
def paired(points, faces, chosen, edges, q0, width, height, alike):  # type: ignore[no-untyped-def]
    """Of the facets of the slab from interval q0 on, those that share a tile and an interval with one that faces the
    other way (`alike`: with any other), and a mask of these intervals of each."""
    across, along = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    masks = np.zeros(chosen.shape[0], np.int64)
    seen = np.zeros((along, across, 2), np.int64)
    again = np.zeros((along if alike else 0, across), np.int64)
    least, most = np.empty(along), np.empty(along)
    xs, ys = np.empty(9), np.empty(9)
    strips, n = np.empty((256, 4), np.int32), 0
    count = min(edges.shape[0] - 1 - q0, SLAB)
    low, high = edges[q0], edges[q0 + count]
    for p in range(chosen.shape[0]):
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        first = min(max(below(edges, min(za, zb, zc)) - 1 - q0, 0), count - 1)
        last = min(max(below(edges, max(za, zb, zc)) - 1 - q0, 0), count - 1)
        masks[p] = (np.int64(2) << last) - (np.int64(1) << first)
        up = np.int64(area_of(points, a, b, c) < 0)
        v0, v1 = _strips(points, a, b, c, low, high, along, xs, ys, least, most)
        for v in range(v0, v1 + 1):
            u0, u1 = _tiles_between(least[v], most[v], width)
            if u1 < u0:
                continue
            strips = _with_strip(strips, n, p, v, u0, u1)
            n += 1
            for u in range(u0, u1 + 1):
                if alike:
                    again[v, u] |= (seen[v, u, 0] | seen[v, u, 1]) & masks[p]
                seen[v, u, up] |= masks[p]
    out, kept, k = np.empty(chosen.shape[0], np.int32), np.empty(chosen.shape[0], np.int64), 0
    s = 0
    while s < n:
        p, wanted = strips[s, 0], np.int64(0)
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        other = np.int64(area_of(points, a, b, c) >= 0)
        while s < n and strips[s, 0] == p:
            v = strips[s, 1]
            for u in range(strips[s, 2], strips[s, 3] + 1):
                wanted |= masks[p] & (again[v, u] if alike else seen[v, u, other])
            s += 1
        if wanted:
            out[k], kept[k] = chosen[p], wanted
            k += 1
    return out[:k].copy(), kept[:k].copy()


@njit
def rows_of(points, a, b, c, low, high, first, stop):  # type: ignore[no-untyped-def]
    """Of a facet's rows first … stop - 1 those in which it may lie in low < z ≤ high; of a few rows all of them."""
    if stop - first <= TILE:
        return first, stop
    y0, y1 = _rows_between(points, a, b, c, low, high)
    return max(first, math.ceil(y0)), min(stop, math.floor(y1) + 1)
