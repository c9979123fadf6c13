"""Small dilations and erosions of images of which most is empty.

An image comes with flags: ``live[w, t]`` says whether tile t of column w (TILE rows by one word) may hold a bit.
Tiles that are not live are 0, and so is the border; only tiles near live ones are looked at.
"""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ALL, U0, U1, U63, WORK
from layerfix.kernels import njit

TILE = 256  # rows: less work in a smaller one is less than what each costs
CROSS, SQUARE, HORIZONTAL, VERTICAL, DISC3 = 0, 1, 2, 3, 4  # 3 × 3 px, 3 × 1, 1 × 3, and the disc of radius 3
FLAGS = types.Array(types.uint8, 2, "C")
IMAGES = types.Array(types.uint64, 3, "C")
IMAGES_FLAGS = types.Array(types.uint8, 3, "C")
Q0, Q1 = np.uint8(0), np.uint8(1)
U2, U3, U61, U62 = np.uint64(2), np.uint64(3), np.uint64(61), np.uint64(62)


@njit
def tiles_of(height):  # type: ignore[no-untyped-def]  # numba types it
    """Tiles in a column of so many rows, two of which are border."""
    return (height - 2 + TILE - 1) // TILE


@njit
def tile_rows(tile, height):  # type: ignore[no-untyped-def]  # numba types it
    """First row of a tile, also the last one's end."""
    return min(1 + tile * TILE, height - 1)


@njit
def next_live(flags, start):  # type: ignore[no-untyped-def]  # numba types it
    """(first, past the last) tile of the next run of live ones from `start`; first = len(flags) if there is none."""
    tiles = flags.shape[0]
    while start < tiles and not flags[start]:
        start += 1
    stop = start
    while stop < tiles and flags[stop]:
        stop += 1
    return start, stop


@njit
def flag(line, live):  # type: ignore[no-untyped-def]  # numba types it
    """live[t] = whether tile t of part of a column has a bit; True if one has."""
    any_live = Q0
    for t in range(live.shape[0]):
        part = line[t * TILE : min((t + 1) * TILE, line.shape[0])]
        seen = U0
        for i in range(part.shape[0]):
            seen |= part[i]
        live[t] = np.uint8(seen != U0)
        any_live |= live[t]
    return any_live != Q0


@njit(types.void(WORK, WORK, FLAGS), cache=True, nogil=True)
def copy_live(source, target, live):  # type: ignore[no-untyped-def]  # numba types it
    """target = source, and its flags; target must be empty."""
    height = source.shape[1]
    for w in range(1, source.shape[0] - 1):
        flag(source[w, 1 : height - 1], live[w])
        start, stop = next_live(live[w], 0)
        while start < stop:
            first, last = tile_rows(start, height), tile_rows(stop, height)
            here, line = source[w, first:last], target[w, first:last]
            for i in range(here.shape[0]):
                line[i] = here[i]
            start, stop = next_live(live[w], stop)


@njit(types.void(IMAGES, IMAGES_FLAGS), cache=True, nogil=True)
def clear_live(images, live):  # type: ignore[no-untyped-def]  # numba types it
    """Empty images and flags, touching live tiles only."""
    for k in range(images.shape[0]):
        for w in range(images.shape[1]):
            start, stop = next_live(live[k, w], 0)
            while start < stop:
                line = images[k, w, tile_rows(start, images.shape[2]) : tile_rows(stop, images.shape[2])]
                for i in range(line.shape[0]):
                    line[i] = U0
                start, stop = next_live(live[k, w], stop)
            for t in range(live.shape[2]):
                live[k, w, t] = Q0


@njit
def _clear_tile(line, tile, live):  # type: ignore[no-untyped-def]  # numba types it
    """Empty one tile of a column, if it is not."""
    if live[tile]:
        part = line[tile_rows(tile, line.shape[0]) : tile_rows(tile + 1, line.shape[0])]
        for i in range(part.shape[0]):
            part[i] = U0
        live[tile] = Q0


@njit
def clear_tiles(line, first, stop, live):  # type: ignore[no-untyped-def]  # numba types it
    """Empty some tiles of a column."""
    for t in range(first, stop):
        _clear_tile(line, t, live)


@njit
def _near_tile(seen, top, bottom, near):  # type: ignore[no-untyped-def]  # numba types it
    """Which of the nine tiles around one lie within `near` < 64 px of its pixels, as nine bits, from the north-west.

    seen: its rows, ORed; top, bottom: the same of its first and last `near` rows
    """
    if seen == U0:
        return 0
    low = (U1 << np.uint64(near)) - U1
    high = ~(ALL >> np.uint64(near))
    west, east = np.int64((seen & low) != U0), np.int64((seen & high) != U0)
    row = west | 2 | (east << 2)
    return (row if top != U0 else 0) | (row << 3) | (row << 6 if bottom != U0 else 0)


@njit(types.void(WORK, WORK, types.int64, WORK, FLAGS, WORK, FLAGS), cache=True, nogil=True)
def near_free(solid, anchor, margin, near_solid, solid_live, near_anchor, anchor_live):  # type: ignore[no-untyped-def]  # numba types it
    """S and A in the tiles within `margin` px of a pixel of S \\ A, into two empty images."""
    words, height = solid.shape
    tiles = solid_live.shape[1]
    wanted = np.zeros((words + 2, tiles + 2), np.uint8)
    near = min(margin, 63)
    for w in range(1, words - 1):
        for t in range(tiles):
            first, last = tile_rows(t, height), tile_rows(t + 1, height)
            seen, top, bottom = U0, U0, U0
            here, fixed = solid[w, first:last], anchor[w, first:last]
            for i in range(here.shape[0]):
                seen |= here[i] & ~fixed[i]
            if seen == U0:
                continue
            for i in range(min(near, here.shape[0])):
                top |= here[i] & ~fixed[i]
            for i in range(max(here.shape[0] - near, 0), here.shape[0]):
                bottom |= here[i] & ~fixed[i]
            found = _near_tile(seen, top, bottom, near)
            for k in range(9):
                if (found >> k) & 1:
                    wanted[w + k % 3, t + k // 3] = Q1
    for step in range((margin - near + 63) // 64):  # a tile is 64 px wide, and taller
        rows = 1 if step * TILE < margin - near else 0
        before = wanted.copy()
        for w in range(1, words + 1):
            for t in range(1, tiles + 1):
                for v in range(w - 1, w + 2):
                    wanted[w, t] |= before[v, t - rows] | before[v, t] | before[v, t + rows]
    for w in range(1, words - 1):
        for t in range(tiles):
            if wanted[w + 1, t + 1]:
                first, last = tile_rows(t, height), tile_rows(t + 1, height)
                for source, target in ((solid, near_solid), (anchor, near_anchor)):
                    here, line = source[w, first:last], target[w, first:last]
                    for i in range(here.shape[0]):
                        line[i] = here[i]
                solid_live[w, t] = anchor_live[w, t] = Q1


@njit
def _grown(west, here, east, within, line, element):  # type: ignore[no-untyped-def]  # numba types it
    n = line.shape[0]
    if element == CROSS:
        for i in range(n):
            c = here[i + 1]
            line[i] = within[i] & (
                c | here[i] | here[i + 2] | (c << U1) | (c >> U1) | (west[i + 1] >> U63) | (east[i + 1] << U63)
            )
    elif element == SQUARE:
        for i in range(n):
            c = here[i] | here[i + 1] | here[i + 2]
            left, right = west[i] | west[i + 1] | west[i + 2], east[i] | east[i + 1] | east[i + 2]
            line[i] = within[i] & (c | (c << U1) | (c >> U1) | (left >> U63) | (right << U63))
    elif element == HORIZONTAL:
        for i in range(n):
            c = here[i + 1]
            line[i] = within[i] & (c | (c << U1) | (c >> U1) | (west[i + 1] >> U63) | (east[i + 1] << U63))
    else:
        for i in range(n):
            line[i] = within[i] & (here[i] | here[i + 1] | here[i + 2])


@njit(types.void(WORK, FLAGS, WORK, types.int64, WORK, FLAGS), cache=True, nogil=True)
def grow(image, live, within, element, out, out_live):  # type: ignore[no-untyped-def]  # numba types it
    """out = within ∩ (image ⊕ element)."""
    words, height = image.shape
    tiles = live.shape[1]
    near = np.zeros(tiles + 2, np.uint8)
    for w in range(1, words - 1):
        for t in range(tiles):
            near[t + 1] = live[w - 1, t] | live[w, t] | live[w + 1, t]
        t = 0
        while t < tiles:
            stop = t
            while stop < tiles and (near[stop] | near[stop + 1] | near[stop + 2]):
                stop += 1
            if stop == t:
                _clear_tile(out[w], t, out_live[w])
                t += 1
                continue
            first, last = tile_rows(t, height), tile_rows(stop, height)
            line = out[w, first:last]
            _grown(image[w - 1, first - 1 : last + 1], image[w, first - 1 : last + 1],
                   image[w + 1, first - 1 : last + 1], within[w, first:last], line, element)  # fmt: skip
            flag(line, out_live[w, t:stop])
            t = stop


@njit
def _shrunk(west, here, east, line, element):  # type: ignore[no-untyped-def]  # numba types it
    n = line.shape[0]
    if element == CROSS:
        for i in range(n):
            c = here[i + 1]
            left, right = (c << U1) | (west[i + 1] >> U63), (c >> U1) | (east[i + 1] << U63)
            line[i] = c & here[i] & here[i + 2] & left & right
    else:
        for i in range(n):
            c = here[i] & here[i + 1] & here[i + 2]
            left, right = west[i] & west[i + 1] & west[i + 2], east[i] & east[i + 1] & east[i + 2]
            line[i] = c & ((c << U1) | (left >> U63)) & ((c >> U1) | (right << U63))


@njit
def _shrunk_by_disc(west, here, east, wide, line):  # type: ignore[no-untyped-def]  # numba types it
    """The disc of radius 3, rows of 1, 5, 5, 7, 5, 5, 1; the three columns have 3 rows more at each end."""
    n = line.shape[0]
    for i in range(n + 6):
        c, left, right = here[i], west[i], east[i]
        two = ((c << U2) | (left >> U62)) & ((c >> U2) | (right << U62))
        wide[i] = c & ((c << U1) | (left >> U63)) & ((c >> U1) | (right << U63)) & two
    for i in range(n):
        c, left, right = here[i + 3], west[i + 3], east[i + 3]
        three = ((c << U3) | (left >> U61)) & ((c >> U3) | (right << U61))
        rows = wide[i + 1] & wide[i + 2] & wide[i + 3] & wide[i + 4] & wide[i + 5]
        line[i] = rows & here[i] & here[i + 6] & three


@njit
def shrink(image, live, element, out, out_live, wide):  # type: ignore[no-untyped-def]  # numba types it
    """out = image ⊖ element (CROSS, SQUARE or DISC3); True if anything is left. wide: a column, scratch."""
    words, height = image.shape
    any_left = False
    for w in range(1, words - 1):
        t = 0
        while t < live.shape[1]:
            if not live[w, t]:
                _clear_tile(out[w], t, out_live[w])
                t += 1
                continue
            t, stop = next_live(live[w], t)
            first, last = tile_rows(t, height), tile_rows(stop, height)
            line = out[w, first:last]
            if element == DISC3:
                while first < min(3, last):  # so near the border nothing is left
                    out[w, first] = U0
                    first += 1
                while last > max(height - 3, first):
                    last -= 1
                    out[w, last] = U0
                if first < last:
                    _shrunk_by_disc(image[w - 1, first - 3 : last + 3], image[w, first - 3 : last + 3],
                                    image[w + 1, first - 3 : last + 3], wide, out[w, first:last])  # fmt: skip
            else:
                _shrunk(image[w - 1, first - 1 : last + 1], image[w, first - 1 : last + 1],
                        image[w + 1, first - 1 : last + 1], line, element)  # fmt: skip
            any_left |= flag(line, out_live[w, t:stop])
            t = stop
    return any_left
