"""Significance: the pixels of S \\ A that deeper ones do not explain."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import U0, U1, U63, WORK
from layerfix.kernels import njit
from layerfix.layers.metric.levels import NUMBERS, TABLE
from layerfix.layers.metric.tiles import (
    IMAGES,
    IMAGES_FLAGS,
    Q1,
    TILE,
    clear_tiles,
    copy_live,
    flag,
    grow,
    next_live,
    shrink,
    tile_rows,
)
from layerfix.layers.morphology import HALF_WIDTHS


@njit(types.int64(WORK, TABLE, IMAGES, IMAGES_FLAGS), cache=True, nogil=True)
def erosions(solid, levels, depths, live):  # type: ignore[no-untyped-def]  # numba types it
    """depths[k] = S eroded by the k-th sum of elements; returns how many levels come before the first empty one."""
    wide = np.empty(solid.shape[1], np.uint64)
    copy_live(solid, depths[0], live[0])
    for k in range(1, levels.shape[0]):
        parent, element = levels[k]
        if not shrink(depths[parent], live[parent], element, depths[k], live[k], wide):
            return k
    return levels.shape[0]


@njit
def _narrowed(columns, w, first, stop, k, line):  # type: ignore[no-untyped-def]  # numba types it
    """line &= column w moved by k pixels to either side, rows first … stop - 1; void outside the array."""
    words, height = columns.shape
    far, near = k >> 6, np.uint64(k & 63)
    rest = np.uint64(64) - near
    top, bottom = max(first, 0), min(stop, height)
    nothing = np.zeros(1, np.uint64)
    for side in (-1, 1):
        a, b = w + side * far, w + side * (far + 1)  # the words the k-th pixel to that side lies in
        here = columns[a, top:bottom] if 0 <= a < words else nothing[:0]
        next_to = columns[b, top:bottom] if near != U0 and 0 <= b < words else nothing[:0]
        out = line[top - first : bottom - first]
        if here.shape[0] == 0:
            for i in range(out.shape[0]):
                out[i] = U0
        elif next_to.shape[0] == 0:
            for i in range(out.shape[0]):
                out[i] &= (here[i] << near) if side < 0 else (here[i] >> near)
        elif side < 0:
            for i in range(out.shape[0]):
                out[i] &= (here[i] << near) | (next_to[i] >> rest)
        else:
            for i in range(out.shape[0]):
                out[i] &= (here[i] >> near) | (next_to[i] << rest)


@njit(types.int64(WORK, HALF_WIDTHS, NUMBERS, IMAGES, IMAGES_FLAGS), cache=True, nogil=True)
def disc_erosions(solid, half_widths, starts, depths, live):  # type: ignore[no-untyped-def]  # numba types it
    """The same by a disc for each level, where pixels are not square.

    A tile of a column at a time, for all levels: a disc is rows that are narrowed to either side.
    """
    height, top, reach, breadth = solid.shape[1], starts.shape[0] - 1, 0, 0
    for k in range(top):
        reach = max(reach, starts[k + 1] - starts[k] - 1)
    for half in half_widths:  # numba's `max` would load linear algebra
        breadth = max(breadth, half)
    copy_live(solid, depths[0], live[0])
    wide = np.empty((breadth + 1, TILE + 2 * reach), np.uint64)
    deepest = 0
    for w in range(1, solid.shape[0] - 1):
        start, stop = next_live(live[0, w], 0)
        while start < stop:
            end = start + 1
            first, last = tile_rows(start, height), tile_rows(end, height)
            rows = last - first + 2 * reach
            above, below = max(first - reach, 0), min(last + reach, height)
            line = wide[0, :rows]
            for i in range(rows):
                line[i] = U0
            here, inside = solid[w, above:below], line[above - first + reach :]
            for i in range(here.shape[0]):
                inside[i] = here[i]
            for k in range(1, breadth + 1):
                before, line = wide[k - 1, :rows], wide[k, :rows]
                for i in range(rows):
                    line[i] = before[i]
                _narrowed(solid, w, first - reach, last + reach, k, line)
            for k in range(1, top):
                disc, out = half_widths[starts[k] : starts[k + 1]], depths[k, w, first:last]
                middle = wide[disc[0], reach:]
                for i in range(out.shape[0]):
                    out[i] = middle[i]
                for dy in range(1, disc.shape[0]):
                    upper, lower = wide[disc[dy], reach - dy :], wide[disc[dy], reach + dy :]
                    for i in range(out.shape[0]):
                        out[i] &= upper[i] & lower[i]
                if not flag(out, live[k, w, start:end]):
                    for i in range(k + 1, top):
                        clear_tiles(depths[i, w], start, end, live[i, w])
                    break
                deepest = max(deepest, k)
            start = end
            if start >= stop:
                start, stop = next_live(live[0, w], stop)
    return deepest + 1


@njit
def _join(source, live, target, target_live):  # type: ignore[no-untyped-def]  # numba types it
    """target |= source."""
    for w in range(1, source.shape[0] - 1):
        start, stop = next_live(live[w], 0)
        while start < stop:
            first, last = tile_rows(start, source.shape[1]), tile_rows(stop, source.shape[1])
            here, line = source[w, first:last], target[w, first:last]
            for i in range(line.shape[0]):
                line[i] |= here[i]
            for t in range(start, stop):
                target_live[w, t] = Q1
            start, stop = next_live(live[w], stop)


@njit
def _take_unexplained(depths, live, k, top, explained, anchor, out):  # type: ignore[no-untyped-def]  # numba types it
    """out |= the pixels between level k and the next that are neither explained nor anchored."""
    height = anchor.shape[1]
    for w in range(1, anchor.shape[0] - 1):
        start, stop = next_live(live[k, w], 0)
        while start < stop:
            first, last = tile_rows(start, height), tile_rows(stop, height)
            here, cone, fixed = depths[k, w, first:last], explained[w, first:last], anchor[w, first:last]
            line = out[w, first:last]
            if k + 1 < top:
                deeper = depths[k + 1, w, first:last]
                for i in range(line.shape[0]):
                    line[i] |= here[i] & ~deeper[i] & ~cone[i] & ~fixed[i]
            else:
                for i in range(line.shape[0]):
                    line[i] |= here[i] & ~cone[i] & ~fixed[i]
            start, stop = next_live(live[k, w], stop)


@njit(types.void(WORK, WORK, TABLE, NUMBERS, IMAGES, IMAGES_FLAGS, types.int64, IMAGES, IMAGES_FLAGS, WORK),
      cache=True, nogil=True)  # fmt: skip
def significant(solid, anchor, schedule, elements, depths, live, top, work, work_live, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = the pixels of S \\ A outside every cone. Levels from `top` on are empty; work: three empty images.

    From the deepest level down, what explains (A first) is grown inside S, a step at a time, and what of the level it
    has not reached is significant. A level joins what explains once the pixels looked at lie enough below it.
    """
    cones, grown, spare = work[0], work[1], work[2]
    cones_live, grown_live, spare_live = work_live[0], work_live[1], work_live[2]
    copy_live(anchor, cones, cones_live)
    for w in range(out.shape[0]):
        for y in range(out.shape[1]):
            out[w, y] = U0
    step = 0
    for k in range(schedule.shape[0] - 1, -1, -1):
        source, before, after = schedule[k]
        if 0 <= source < top:
            if before == 0:
                _join(depths[source], live[source], cones, cones_live)
            else:
                for j in range(before):
                    element = elements[(step + j) % elements.shape[0]]
                    if j == 0:
                        grow(depths[source], live[source], solid, element, grown, grown_live)
                    else:
                        grow(grown, grown_live, solid, element, spare, spare_live)
                        grown, spare = spare, grown
                        grown_live, spare_live = spare_live, grown_live
                _join(grown, grown_live, cones, cones_live)
        for _ in range(after):
            grow(cones, cones_live, solid, elements[step % elements.shape[0]], grown, grown_live)
            step += 1
            cones, grown = grown, cones
            cones_live, grown_live = grown_live, cones_live
        if k < top:
            _take_unexplained(depths, live, k, top, cones, anchor, out)


@njit(types.void(WORK, WORK, WORK, WORK), cache=True, nogil=True)
def tips(columns, significant_pixels, anchor, out):  # type: ignore[no-untyped-def]  # numba types it
    """out = anchor, and the significant pixels left in `columns` whose neighbours lie within 90°: the ends of bars up
    to three pixels wide. (Unless they are kept, Guo–Hall takes a pixel or two off those.)"""
    words, height = columns.shape
    for w in range(words):
        out[w, 0] = anchor[w, 0]
        out[w, height - 1] = anchor[w, height - 1]
        if w == 0 or w == words - 1:
            for y in range(height):
                out[w, y] = anchor[w, y]
            continue
        west, here, east = columns[w - 1], columns[w], columns[w + 1]
        kept, fixed, line = significant_pixels[w][1:], anchor[w][1:], out[w][1:]
        for i in range(height - 2):
            x3, c, x7 = here[i], here[i + 1], here[i + 2]
            x4, x5, x6 = (
                (x3 << U1) | (west[i] >> U63),
                (c << U1) | (west[i + 1] >> U63),
                (x7 << U1) | (west[i + 2] >> U63),
            )
            x2, x1, x8 = (
                (x3 >> U1) | (east[i] << U63),
                (c >> U1) | (east[i + 1] << U63),
                (x7 >> U1) | (east[i + 2] << U63),
            )
            wider = (
                (x1 & (x4 | x5 | x6)) | (x2 & (x5 | x6 | x7)) | (x3 & (x6 | x7 | x8)) | (x4 & (x7 | x8)) | (x5 & x8)
            )
            line[i] = fixed[i] | (c & kept[i] & ~wider & (x1 | x2 | x3 | x4 | x5 | x6 | x7 | x8))
