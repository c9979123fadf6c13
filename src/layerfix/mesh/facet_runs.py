"""Runs of pixels that facets cover, row by row: seen from above, between two heights, centre by centre.

Coordinates are the cutter's: column, row, z quanta. A facet covers the centres that `fill` would give it: half-open
along the row and across it, so neighbours never both claim a centre and never leave one out.

Runs are made once for a slab of intervals between mid-planes; fine meshes have fewer of them than facets.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.kernels import njit
from layerfix.mesh.fill import below

TILE = 8  # px
SLAB = 16  # intervals, or layers, whose facets are looked through at once, at most
ROOM = 8192  # runs, at first
SLAB_FACETS = 65536  # or fewer, so that these are not many more: their runs take 48 bytes each
SLAB_PX = 1 << 21  # or fewer, so that their facets cover no more on average: what is found takes 8 bytes a pixel
POINTS = types.Array(types.float64, 2, "C", readonly=True)
TRIANGLES = types.Array(types.int32, 2, "C", readonly=True)
INDICES = types.Array(types.int32, 1, "C")
HEIGHTS = types.Array(types.float64, 1, "C", readonly=True)
RUNS = types.Array(types.int32, 2, "C")  # row, first column, past the last, 1 if the facet faces down
SLOPES = types.Array(
    types.float64, 2, "C"
)  # of a run: z at column 0, z along a column, the facet's least and greatest


@njit
def area_of(points, a, b, c):  # type: ignore[no-untyped-def]  # numba types it
    """Twice the area seen from above, above 0 for a facet that faces down (rows run downwards)."""
    return (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1]) - (points[c, 0] - points[a, 0]) * (
        points[b, 1] - points[a, 1]
    )


@njit(types.float64(POINTS, TRIANGLES), cache=True, nogil=True)
def seen_area(points, faces):  # type: ignore[no-untyped-def]  # numba types it
    """px² that facets cover, all together, seen from above."""
    area = 0.0
    for t in range(faces.shape[0]):
        area += abs(area_of(points, faces[t, 0], faces[t, 1], faces[t, 2])) / 2
    return area


@njit
def _may_cover(points, a, b, c, width, height):  # type: ignore[no-untyped-def]  # numba types it
    """Whether a facet may cover a centre of the frame."""
    x0, x1 = min(points[a, 0], points[b, 0], points[c, 0]), max(points[a, 0], points[b, 0], points[c, 0])
    y0, y1 = min(points[a, 1], points[b, 1], points[c, 1]), max(points[a, 1], points[b, 1], points[c, 1])
    return (
        max(math.ceil(x0), 0) < min(math.ceil(x1), width)
        and max(math.ceil(y0), 0) < min(math.ceil(y1), height)
        and area_of(points, a, b, c) != 0
    )


@njit
def by_slabs(reach, slabs):  # type: ignore[no-untyped-def]  # numba types it
    """(starts, facets): out[starts[s] : starts[s + 1]] are those that reach into slab s, if reach (n, 2) holds each
    one's first slab and the one past its last."""
    starts = np.zeros(slabs + 1, np.int64)
    for t in range(reach.shape[0]):
        for s in range(reach[t, 0], reach[t, 1]):
            starts[s + 1] += 1
    for s in range(slabs):
        starts[s + 1] += starts[s]
    out = np.empty(starts[slabs], np.int32)
    where = starts.copy()
    for t in range(reach.shape[0]):
        for s in range(reach[t, 0], reach[t, 1]):
            out[where[s]] = t
            where[s] += 1
    return starts, out


@njit
def _intervals(edges, low, high):  # type: ignore[no-untyped-def]  # numba types it
    """A mask of the intervals of a slab, edges[q] < z ≤ edges[q + 1], that low … high reaches into; the ends take
    what lies beyond."""
    last = edges.shape[0] - 2
    first = min(max(below(edges, low) - 1, 0), last)
    return (np.int64(2) << min(max(below(edges, high) - 1, 0), last)) - (np.int64(1) << first)


@njit(
    types.Tuple((types.Array(types.int64, 1, "C"), INDICES))(
        POINTS, TRIANGLES, HEIGHTS, types.int64, types.int64, types.int64
    ),
    cache=True,
    nogil=True,
)
def slabs_of(points, faces, edges, span, width, height):  # type: ignore[no-untyped-def]  # numba types it
    """Facets that may cover a centre, by the slabs of `span` intervals edges[q] < z ≤ edges[q + 1] they are in."""
    reach = np.zeros((faces.shape[0], 2), np.int32)
    for t in range(faces.shape[0]):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        if _may_cover(points, a, b, c, width, height):
            za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
            reach[t, 0] = max(below(edges, min(za, zb, zc)) - 1, 0) // span
            reach[t, 1] = max(below(edges, max(za, zb, zc)) - 1, 0) // span + 1
    return by_slabs(reach, (edges.shape[0] - 1 + span - 1) // span)


@njit(
    INDICES(POINTS, TRIANGLES, INDICES, HEIGHTS, types.int64, types.int64, types.boolean),
    cache=True,
    nogil=True,
)
def may_pair(points, faces, chosen, edges, width, height, alike):  # type: ignore[no-untyped-def]  # numba types it
    """Of the facets of the slab with these edges, those whose box shares a tile and an interval with one that
    faces the other way (`alike`: with any other). Where a facet is many rows high, it is the cheaper look."""
    across, along = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    seen = np.zeros((along, across, 2), np.int64)
    boxes, masks = np.empty((chosen.shape[0], 5), np.int32), np.empty(chosen.shape[0], np.int64)
    for p in range(chosen.shape[0]):
        a, b, c = faces[chosen[p], 0], faces[chosen[p], 1], faces[chosen[p], 2]
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        masks[p] = _intervals(edges, min(za, zb, zc), max(za, zb, zc))
        x0, x1 = min(points[a, 0], points[b, 0], points[c, 0]), max(points[a, 0], points[b, 0], points[c, 0])
        y0, y1 = min(points[a, 1], points[b, 1], points[c, 1]), max(points[a, 1], points[b, 1], points[c, 1])
        u0, u1 = max(math.ceil(x0), 0) // TILE, (min(math.ceil(x1), width) - 1) // TILE
        v0, v1 = max(math.ceil(y0), 0) // TILE, (min(math.ceil(y1), height) - 1) // TILE
        up = 0 if alike else np.int64(area_of(points, a, b, c) < 0)
        boxes[p, 0], boxes[p, 1], boxes[p, 2], boxes[p, 3], boxes[p, 4] = u0, u1, v0, v1, up
        for v in range(v0, v1 + 1):
            for u in range(u0, u1 + 1):
                if alike:
                    seen[v, u, 1] |= seen[v, u, 0] & masks[p]
                seen[v, u, up] |= masks[p]
    out, k = np.empty(chosen.shape[0], np.int32), 0
    for p in range(chosen.shape[0]):
        wanted, other = np.int64(0), 1 - boxes[p, 4]
        for v in range(boxes[p, 2], boxes[p, 3] + 1):
            for u in range(boxes[p, 0], boxes[p, 1] + 1):
                wanted |= masks[p] & seen[v, u, other]
        if wanted:
            out[k] = chosen[p]
            k += 1
    return out[:k].copy()


@njit
def _rows_between(points, a, b, c, low, high):  # type: ignore[no-untyped-def]  # numba types it
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
def _slope(points, p, q):  # type: ignore[no-untyped-def]  # numba types it
    dy = points[q, 1] - points[p, 1]
    return (points[q, 0] - points[p, 0]) / dy if dy != 0 else 0.0


@njit
def _by_rows(points, a, b, c):  # type: ignore[no-untyped-def]  # numba types it
    """The corners of a facet, from the first row to the last."""
    if points[b, 1] < points[a, 1]:
        a, b = b, a
    if points[c, 1] < points[b, 1]:
        b, c = c, b
        if points[b, 1] < points[a, 1]:
            a, b = b, a
    return a, b, c


@njit
def _plane(points, a, b, c):  # type: ignore[no-untyped-def]  # numba types it
    """(gx, gy): how z changes along x and y."""
    xa, ya, za, area = points[a, 0], points[a, 1], points[a, 2], area_of(points, a, b, c)
    ux, uy, uz = points[b, 0] - xa, points[b, 1] - ya, points[b, 2] - za
    vx, vy, vz = points[c, 0] - xa, points[c, 1] - ya, points[c, 2] - za
    return (uz * vy - vz * uy) / area, (ux * vz - vx * uz) / area


@njit
def run_z(slopes, r, column):  # type: ignore[no-untyped-def]  # numba types it
    """Height of run r at a column."""
    return min(max(slopes[r, 0] + slopes[r, 1] * column, slopes[r, 2]), slopes[r, 3])


@njit
def run_within(slopes, r, low, high, first, stop):  # type: ignore[no-untyped-def]  # numba types it
    """Of the columns first … stop - 1 of run r those in low < z ≤ high."""
    at_row, gx = slopes[r, 0], slopes[r, 1]
    if stop - first > 2 and abs(gx) > 1e-9:
        one, other = (low - at_row) / gx, (high - at_row) / gx
        first = max(first, math.ceil(min(max(min(one, other), -1.0), stop) - 0.01))
        stop = min(stop, math.floor(max(min(max(one, other), stop), -1.0) + 0.01) + 1)
    while first < stop and not low < run_z(slopes, r, first) <= high:
        first += 1
    while first < stop and not low < run_z(slopes, r, stop - 1) <= high:
        stop -= 1
    return first, stop


@njit
def _longer(runs, slopes):  # type: ignore[no-untyped-def]  # numba types it
    """The same two tables with room for as many more rows."""
    count = runs.shape[0]
    more, more_slopes = np.empty((2 * count, 4), np.int32), np.empty((2 * count, 4), np.float64)
    for r in range(count):
        for k in range(4):
            more[r, k], more_slopes[r, k] = runs[r, k], slopes[r, k]
    return more, more_slopes


@njit(
    types.Tuple((RUNS, SLOPES))(POINTS, TRIANGLES, INDICES, types.float64, types.float64, types.int64, types.int64),
    cache=True,
    nogil=True,
)
def facet_runs(points, faces, chosen, low, high, width, height):  # type: ignore[no-untyped-def]  # numba types it
    """(runs, slopes) of some facets in low < z ≤ high; none of them may be upright (`slabs_of` leaves those out)."""
    runs, slopes, n = np.empty((ROOM, 4), np.int32), np.empty((ROOM, 4), np.float64), 0
    for t in chosen:
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        xa, ya, za = points[a, 0], points[a, 1], points[a, 2]
        z0, z1 = min(za, points[b, 2], points[c, 2]), max(za, points[b, 2], points[c, 2])
        if z0 > high or z1 <= low:
            continue
        top, middle, bottom = _by_rows(points, a, b, c)
        x_top, y_top, x_middle, y_middle = points[top, 0], points[top, 1], points[middle, 0], points[middle, 1]
        j_middle = math.ceil(y_middle)
        whole = z0 > low and z1 <= high
        j0, j1 = max(math.ceil(y_top), 0), min(math.ceil(points[bottom, 1]), height)
        if not whole and j1 - j0 > TILE:
            y0, y1 = _rows_between(points, a, b, c, low, high)
            j0, j1 = max(j0, math.ceil(y0)), min(j1, math.floor(y1) + 1)
        if j0 >= j1:
            continue
        gx, gy = _plane(points, a, b, c)
        down = np.int32(area_of(points, a, b, c) > 0)
        long, upper, lower = _slope(points, top, bottom), _slope(points, top, middle), _slope(points, middle, bottom)
        for j in range(j0, j1):
            one = math.ceil(x_top + (j - y_top) * long)
            other = math.ceil(x_top + (j - y_top) * upper if j < j_middle else x_middle + (j - y_middle) * lower)
            first, stop = max(min(one, other), 0), min(max(one, other), width)
            if stop <= first:
                continue
            if n == runs.shape[0]:
                runs, slopes = _longer(runs, slopes)
            slopes[n, 0], slopes[n, 1], slopes[n, 2], slopes[n, 3] = za + gy * (j - ya) - gx * xa, gx, z0, z1
            if not whole:
                first, stop = run_within(slopes, n, low, high, first, stop)
                if stop <= first:
                    continue
            runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3] = j, first, stop, down
            n += 1
    return runs[:n], slopes[:n]


@njit(types.Tuple((RUNS, SLOPES))(RUNS, SLOPES, HEIGHTS, types.int64, types.int64), cache=True, nogil=True)
def paired(runs, slopes, edges, width, height):  # type: ignore[no-untyped-def]  # numba types it
    """Those runs that share a tile and an interval of these edges with one that faces the other way."""
    across, along = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    seen, masks = np.zeros((along, across, 2), np.int64), np.empty(runs.shape[0], np.int64)
    for r in range(runs.shape[0]):
        one, other = run_z(slopes, r, runs[r, 1]), run_z(slopes, r, runs[r, 2] - 1)
        masks[r] = _intervals(edges, min(one, other), max(one, other))
        v, side = runs[r, 0] // TILE, runs[r, 3]
        for u in range(runs[r, 1] // TILE, (runs[r, 2] - 1) // TILE + 1):
            seen[v, u, side] |= masks[r]
    kept, kept_slopes, k = np.empty_like(runs), np.empty_like(slopes), 0
    for r in range(runs.shape[0]):
        v, other, both = runs[r, 0] // TILE, 1 - runs[r, 3], np.int64(0)
        for u in range(runs[r, 1] // TILE, (runs[r, 2] - 1) // TILE + 1):
            both |= masks[r] & seen[v, u, other]
        if both:
            for i in range(4):
                kept[k, i], kept_slopes[k, i] = runs[r, i], slopes[r, i]
            k += 1
    return kept[:k], kept_slopes[:k]
