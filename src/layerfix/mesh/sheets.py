"""What lies between two mid-planes and is met by none: thin sheets, as columns through the pixels' centres.

A mid-plane cut sees the solid at one height of a layer only; a sheet of a third of a layer may be in none. The rule:
a stretch of solid over a pixel's centre that no mid-plane meets goes into the layer that holds most of it, the lower
of two that hold as much, if it is at least `least` of that layer high; the ends take what lies beyond. What is lower
than that (the feather edges of wedges and cones) stays out; where it hangs together with nothing, it is counted.

Over a pixel that is empty in layer k the winding number is 0 at its mid-plane, so the facets between it and the next
mid-plane, up or down, tell by themselves where solid begins and ends: no layer needs another. Facets are looked at
only where one that faces down and one that faces up share a tile of TILE pixels and an interval between mid-planes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import types

from layerfix.bits import U1, WORK
from layerfix.kernels import njit
from layerfix.layers.components import root_of
from layerfix.layers.neighbours import bit_at
from layerfix.mesh.crossings import KEYS, Z_BITS, crossings, longer
from layerfix.mesh.facet_runs import SLAB, SLAB_FACETS, SLAB_PX, facet_runs, may_pair, paired, seen_area, slabs_of
from layerfix.mesh.fill import BITS, EVEN_ODD, ONE, SEGMENTS, below, row_crossings, sort, winding_is_inside
from layerfix.threads import Remembered

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.bits import Rows

LEAST = 0.25  # of a layer: what is kept
CRUMB = 4  # px
FOIL = 1e-3  # of a layer: what is lower is nothing
BOUNDS = types.Array(types.float64, 1, "C")


MINE, HIGH = 1, 2  # marks of a stretch: this layer holds most of it; it is high enough to be kept


@njit(
    KEYS(
        KEYS, types.int64, types.float64, types.float64, types.float64,
        types.boolean, types.boolean, types.float64, types.float64, types.int64, WORK,
    ),
    cache=True,
    nogil=True,
)  # fmt: skip
def _walk(keys, width, low, high, border, upwards, all_mine, least, foil, rule, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Stretches between a layer's mid-plane and the next one, over pixels empty in `rows`: 4 · pixel + marks.

    keys    sorted crossings of low < z ≤ high
    border  height of the border between the two layers
    """
    unit = (high - low) / ((1 << Z_BITS) - 2)
    mask = (np.int64(1) << Z_BITS) - 1
    tie = 4 * unit
    found, k = np.empty(64, np.int64), 0
    i, n = 0, keys.shape[0]
    while i < n:
        pixel, begin = keys[i] >> (Z_BITS + 1), i
        while i < n and keys[i] >> (Z_BITS + 1) == pixel:
            i += 1
        if i - begin < 2 or bit_at(rows, pixel // width, pixel % width):
            continue
        winding, crossed, start = 0, 0, 0.0
        for step in range(i - begin):
            key = keys[begin + step] if upwards else keys[i - 1 - step]
            z = low + ((key >> 1) & mask) * unit
            was = winding_is_inside(winding, crossed, rule)
            winding += 1 if (key & 1 == 1) == upwards else -1
            crossed += 1
            if winding_is_inside(winding, crossed, rule) == was:
                continue
            if not was:
                start = z
                continue
            bottom, top = min(start, z), max(start, z)
            if top - bottom < foil:
                continue
            under, over = min(top, border) - bottom, top - max(bottom, border)
            mine = all_mine or ((under >= over - tie) if upwards else (over > under + tie))
            mark = (MINE if mine else 0) | (HIGH if top - bottom >= least - tie else 0)
            if k == found.shape[0]:
                found = longer(found)
            found[k] = pixel << 2 | mark
            k += 1
    return found[:k].copy()


@njit(types.int64(KEYS, types.int64, WORK), cache=True, nogil=True)
def _add(found, width, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Set the pixels of stretches that are this layer's and high enough. Returns how many were not set."""
    added = 0
    for key in found:
        if key & 3 == MINE | HIGH:
            y, x = (key >> 2) // width, (key >> 2) % width
            added += 1 - bit_at(rows, y, x)
            rows[y, x >> 6] |= U1 << np.uint64(x & 63)
    return added


@njit(types.int64(KEYS, types.int64, WORK), cache=True, nogil=True)
def _lone_parts(found, width, rows):  # type: ignore[no-untyped-def]  # numba types it
    """How many parts of this layer's stretches that are too low touch neither pixels nor stretches that are not.

    Parts of up to CRUMB pixels do not count: the feather edge of a slope ends in such.
    """
    parent = np.arange(found.shape[0])
    held = np.zeros(found.shape[0], np.bool_)
    for k in range(found.shape[0]):
        pixel = found[k] >> 2
        y, x = pixel // width, pixel % width
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                held[k] |= bit_at(rows, y + dy, x + dx) == 1
            if found[k] & HIGH:
                held[k] = True
            other = below(found, (pixel + dy * width - 1) << 2)
            while other < found.shape[0] and found[other] >> 2 <= pixel + dy * width + 1:
                one, two = root_of(parent, k), root_of(parent, other)
                parent[max(one, two)] = min(one, two)
                other += 1
    for k in range(found.shape[0]):
        if held[k] or not found[k] & MINE:
            held[root_of(parent, k)] = True
    area = np.zeros(found.shape[0], np.int64)
    for k in range(found.shape[0]):
        area[root_of(parent, k)] += 1
    lone = 0
    for k in range(found.shape[0]):
        lone += parent[k] == k and not held[k] and area[k] > CRUMB
    return lone


@njit
def _of_rows(keys, segments, width, height):  # type: ignore[no-untyped-def]  # numba types it
    """Those segments that cross rows of which there are keys."""
    before = np.zeros(height + 1, np.int64)
    for key in keys:
        before[(key >> (Z_BITS + 1)) // width + 1] = 1
    for j in range(height):
        before[j + 1] += before[j]
    out, n = np.empty((segments.shape[0], 4), np.float64), 0
    for s in range(segments.shape[0]):
        low, high = min(segments[s, 1], segments[s, 3]), max(segments[s, 1], segments[s, 3])
        first, stop = min(max(math.ceil(low), 0), height), min(max(math.ceil(high), 0), height)
        if before[stop] > before[first]:
            for k in range(4):
                out[n, k] = segments[s, k]
            n += 1
    return out[:n]


@njit(
    types.int64(
        KEYS, SEGMENTS, types.int64, BOUNDS, BOUNDS, types.float64, types.float64, types.float64, types.int64, WORK,
    ),
    cache=True,
    nogil=True,
)  # fmt: skip
def _cover(keys, segments, width, bounds, heights, middle, share, least, rule, rows):  # type: ignore[no-untyped-def]  # numba types it
    """Make pixels solid where the solid over them fills so much of the layer. Returns how many change.

    keys    sorted crossings from the bottom of the layer below to the top of the one above
    bounds  that bottom, the layer's bottom and top, that top; heights: of the three layers
    middle  the mid-plane, where `segments` say what is inside
    share   of a layer's height; a stretch that fills that of no layer goes to the one that holds most of it, if it is
            `least` high
    """
    low, high = bounds[0], bounds[3]
    unit = (high - low) / ((1 << Z_BITS) - 2)
    mask = (np.int64(1) << Z_BITS) - 1
    tie = 4 * unit
    starts, crossings = row_crossings(_of_rows(keys, segments, width, rows.shape[0]), width, rows.shape[0])
    sorted_row = -1
    changed, i, n = 0, 0, keys.shape[0]
    while i < n:
        pixel, begin = keys[i] >> (Z_BITS + 1), i
        while i < n and keys[i] >> (Z_BITS + 1) == pixel:
            i += 1
        y, x = pixel // width, pixel % width
        if y != sorted_row:
            sort(crossings[starts[y] : starts[y + 1]])
            sorted_row = y
        winding, crossed = 0, 0  # at the mid-plane
        for q in range(starts[y], starts[y + 1]):
            if ((crossings[q] >> 1) + ONE - 1) >> BITS > x:
                break
            winding += 1 if crossings[q] & 1 else -1
            crossed += 1
        inside = winding_is_inside(winding, crossed, rule)
        # Down to the lowest crossing, then up: the stretches from the bottom on.
        first = begin
        while first < i and low + ((keys[first] >> 1) & mask) * unit <= middle:
            first += 1
        for q in range(first - 1, begin - 1, -1):
            winding -= 1 if keys[q] & 1 else -1
            crossed += 1
        filled, kept = 0.0, False
        start = low
        for q in range(begin, i + 1):
            z = low + ((keys[q] >> 1) & mask) * unit if q < i else high
            was = winding_is_inside(winding, crossed, rule)
            if q < i:
                winding += 1 if keys[q] & 1 else -1
                crossed += 1
                if winding_is_inside(winding, crossed, rule) == was:
                    continue
            if not was:
                start = z
                continue
            own = min(z, bounds[2]) - max(start, bounds[1])
            under, over = min(z, bounds[1]) - start, z - max(start, bounds[2])
            if own > 0:
                filled += own
                there = under >= share * heights[0] - tie or over >= share * heights[2] - tie
                most = own > under - tie and own >= over - tie
                kept |= not there and most and z - start >= least - tie
        solid = kept or filled >= share * heights[1] - tie
        if solid != inside:
            bit = U1 << np.uint64(x & 63)
            rows[y, x >> 6] = rows[y, x >> 6] | bit if solid else rows[y, x >> 6] & ~bit
            changed += 1
    return changed


def _by_window(starts: NDArray[np.int64], keys: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    parts = [keys[first:stop] for first, stop in itertools.pairwise(starts.tolist())]
    for part in parts:
        part.sort()
    return parts


def _mask(edges: NDArray[np.float64], ends: tuple[float, float]) -> int:
    """The intervals of these edges between two of them."""
    first, stop = np.searchsorted(edges, ends).tolist()
    return (1 << int(stop)) - (1 << int(first))


class _Window(NamedTuple):
    """What a layer's share is counted in, in z quanta."""

    bounds: tuple[float, float, float, float]  # bottom of the layer below, its own, its top, top of the layer above
    heights: NDArray[np.float64]  # of the three
    within: tuple[float, float]  # a stretch that reaches further fills as much of this layer, or is a neighbour's
    always: tuple[float, float]  # what ends here is looked at though nothing begins within


@dataclass(frozen=True, eq=False)
class Sheets:
    """What a cut at mid-planes misses of one closed surface.

    points, faces  the cutter's
    planes, bounds  (layers,) mid-planes and (layers, 2) bottom and top, in z quanta
    size_px        (width, height) of the frame
    rule           winding rule of `fill`
    least          height of what is kept, as a share of the layer's
    share          of a layer's height that `cover` asks for; None if only `rescue` is
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    planes: NDArray[np.float64]
    bounds: NDArray[np.float64]
    size_px: tuple[int, int]
    rule: int
    least: float = LEAST
    share: float | None = None
    _edges: NDArray[np.float64] = field(init=False)  # of the intervals between mid-planes, q below layer q
    _span: int = field(init=False)  # intervals, or layers, of a slab
    _facets: tuple[NDArray[np.int64], NDArray[np.int32]] = field(init=False)  # by slabs
    _keys: Callable[[int], list[NDArray[np.int64]]] = field(init=False)  # of each interval, or layer, of a slab

    def __post_init__(self) -> None:
        """Sort the facets into slabs."""
        z, planes = self.points[:, 2], self.planes
        ends = min(z.min(), planes[0]) - 1.0, max(z.max(), planes[-1]) + 1.0
        edges = np.concatenate([ends[:1], planes, ends[1:]])
        span = SLAB
        crowd = max(len(self.faces) / SLAB_FACETS, seen_area(self.points, self.faces) / SLAB_PX)
        while span > 1 and crowd * span > len(planes):
            span //= 2
        object.__setattr__(self, "_edges", edges)
        object.__setattr__(self, "_span", span)
        object.__setattr__(self, "_facets", slabs_of(self.points, self.faces, edges, span, *self.size_px))
        object.__setattr__(
            self, "_keys", Remembered(self._missed if self.share is None else self._covering, max(4, 12 // span))
        )

    def _of_slab(self, slab: int) -> NDArray[np.int32]:
        starts, chosen = self._facets
        mine: NDArray[np.int32] = chosen[starts[slab] : starts[slab + 1]]
        return mine

    def _missed(self, slab: int) -> list[NDArray[np.int64]]:
        """Of each interval between mid-planes, the crossings of columns that may begin and end there, sorted."""
        between = self._edges[slab * self._span : (slab + 1) * self._span + 1]
        alike = self.rule == EVEN_ODD  # facets that face the same way can bound a stretch, too
        mine = may_pair(self.points, self.faces, self._of_slab(slab), between, *self.size_px, alike)
        runs, slopes = facet_runs(self.points, self.faces, mine, float(between[0]), float(between[-1]), *self.size_px)
        if not alike:
            runs, slopes = paired(runs, slopes, between, *self.size_px)
        scales = np.stack([between[:-1], between[1:]], axis=1)
        within = np.uint64(1) << np.arange(len(scales), dtype=np.uint64)
        return _by_window(*crossings(runs, slopes, between, within, np.zeros_like(within), scales, alike,
                                     *self.size_px))  # fmt: skip

    def _covering(self, slab: int) -> list[NDArray[np.int64]]:
        """Of each layer of a slab, the crossings of columns that it may not fill as its mid-plane says, sorted."""
        first = slab * self._span
        windows = [self._window(k) for k in range(first, min(first + self._span, len(self.planes)))]
        edges = np.unique([z for window in windows for z in (*window.within, *window.always)])
        low, high = float(edges[0]), float(edges[-1])
        found = []
        for k in range(len(self._facets[0]) - 1):  # each facet once: of every slab its part
            z0, z1 = self._edges[k * self._span], self._edges[min((k + 1) * self._span, len(self._edges) - 1)]
            if z0 < high and z1 > low:
                mine = self._of_slab(k)
                found.append(facet_runs(self.points, self.faces, mine, max(low, z0), min(high, z1), *self.size_px))
        runs, slopes = (np.concatenate(part) for part in zip(*found, strict=True))
        within, always = (
            np.array([_mask(edges, pair) for pair in pairs], np.uint64)
            for pairs in ([one.within for one in windows], [one.always for one in windows])
        )
        scales = np.array([(one.bounds[0], one.bounds[3]) for one in windows])
        return _by_window(*crossings(runs, slopes, edges, within, always, scales, True, *self.size_px))

    def _window(self, index: int) -> _Window:
        assert self.share is not None
        (bottom, top), last = self.bounds[index], len(self.planes) - 1
        ends = min(self._edges[0], self.bounds[0, 0] - 1.0), max(self._edges[-1], self.bounds[-1, 1] + 1.0)
        # At the ends, what lies beyond counts as the end layers' own.
        low = self.bounds[index - 1, 0] if index > 1 else ends[0]
        high = self.bounds[index + 1, 1] if index < last - 1 else ends[1]
        bounds = float(low), float(bottom if index else low), float(top if index < last else high), float(high)
        heights = np.diff(self.bounds[[max(index - 1, 0), index, min(index + 1, last)]], axis=1)[:, 0]
        middle, deepest, clear = self.planes[index], self.share * heights[1], FOIL * heights[1]
        return _Window(
            bounds,
            heights,
            (max(bounds[0], bounds[1] - deepest - clear), min(bounds[3], bounds[2] + deepest + clear)),
            (
                min(middle, bottom + deepest, top - deepest) - clear,
                max(middle, bottom + deepest, top - deepest) + clear,
            ),
        )

    def cover(self, index: int, rows: Rows, segments: NDArray[np.float64]) -> int:
        """Make a layer's pixels solid where the solid over them fills the share of it (`z_sampling="overlap"`).

        Returns how many changed.
        """
        keys = self._keys(index // self._span)[index % self._span]
        if not len(keys):
            return 0
        window = self._window(index)
        bounds, heights = np.array(window.bounds), window.heights
        middle, least, rule = self.planes[index], self.least * heights[1], self.rule
        changed: int = _cover(keys, segments, self.size_px[0], bounds, heights, middle, self.share, least, rule, rows)
        return changed

    def _between(self, q: int) -> NDArray[np.int64]:
        """Crossings between two mid-planes."""
        return self._keys(q // self._span)[q % self._span]

    def near(self, index: int) -> bool:
        """Whether a layer's mid-plane may miss anything."""
        above = self._between(index + 1)  # first: the other one is what the thread of the layer below is at
        return bool(len(above) or len(self._between(index)))

    def rescue(self, index: int, rows: Rows) -> tuple[int, int]:
        """Add to a layer's pixels what its mid-plane misses. Returns (how many were added; how many parts, touching
        nothing, were too low for it)."""
        (bottom, top), last = self.bounds[index], len(self.planes) - 1
        least, width = self.least * (top - bottom), self.size_px[0]
        found = []
        for q, border, upwards in ((index, bottom, False), (index + 1, top, True)):
            end = index == (last if upwards else 0)
            low, high = self._edges[q], self._edges[q + 1]
            keys = self._between(q)
            if len(keys):
                foil = FOIL * float(np.diff(self.bounds[max(q - 1, 0) : q + 1], axis=1).min())
                found.append(_walk(keys, width, low, high, border, upwards, end, least, foil, self.rule, rows))
        stretches = np.sort(np.concatenate(found))
        if not len(stretches):
            return 0, 0
        added = int(_add(stretches, width, rows))
        lost = int(_lone_parts(stretches, width, rows)) if (stretches & HIGH == 0).any() else 0
        return added, lost
