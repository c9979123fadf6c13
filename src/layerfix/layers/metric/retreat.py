"""Retreat: every end of a path walks back until F just holds the balls of the significant pixels it walked over.

A few thousand pixels a layer, one at a time. An end at p with the balls (q, ρ) demands max |p - q| + ρ of F's radius
r; it goes to its neighbour p' if that is nearer to demanding just r: demand(p) + demand(p') ≤ 2 r. All ends advance
together, in turns of demand, so that the two ends of a short bar meet in its middle. Where an end stops at a junction
its balls stay there, for whichever branch becomes the end.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from layerfix.bits import U0, U1, U63, WORK, lowest_bit
from layerfix.kernels import njit
from layerfix.layers.metric.levels import LENGTHS, NUMBERS, TABLE
from layerfix.layers.metric.tiles import IMAGES

INSIDE_PX, OFF_AXIS_PX = (
    1.3,
    0.1,
)  # balls of pixels deeper than this are larger: paths run up to half a pixel off the axis
TIE_PX = 0.1  # favours walking on where two stops are about equally good
EVERY_PX = 4.0  # an end takes on the ball of a significant pixel this often
TURN_PX = 2.0  # how much demand a turn lets all ends grow to
SPOTS = types.Array(types.int64, 2, "C")

# Offsets of the neighbours x1 … x8: east, then counter-clockwise; y grows downwards.
DX = np.array([1, 1, 0, -1, -1, -1, 0, 1])
DY = np.array([0, -1, -1, -1, 0, 1, 1, 1])


def _of_neighbourhoods() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the 256 neighbourhoods (bit k: neighbour k + 1): Guo and Hall's crossing number, count, first neighbour."""
    codes = np.arange(256)
    x = [(codes >> k) & 1 for k in range(8)]
    crossing = sum((1 - x[k]) & (x[k + 1] | x[(k + 2) % 8]) for k in (0, 2, 4, 6))
    first = np.argmax(np.stack(x), axis=0)
    return np.asarray(crossing, np.int64), np.asarray(sum(x), np.int64), first.astype(np.int64)


CROSSING, COUNT, FIRST = _of_neighbourhoods()


@njit
def _bit(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    return (columns[x >> 6, y] >> np.uint64(x & 63)) & U1 != U0


@njit
def _clear(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    columns[x >> 6, y] &= ~(U1 << np.uint64(x & 63))


@njit
def _three(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Pixels x - 1, x, x + 1 of row y as bits 0, 1, 2."""
    w, bit = x >> 6, x & 63
    if bit == 0:
        return ((columns[w - 1, y] >> U63) | (columns[w, y] << U1)) & np.uint64(7)
    if bit == 63:
        return (columns[w, y] >> np.uint64(62)) | ((columns[w + 1, y] & U1) << np.uint64(2))
    return (columns[w, y] >> np.uint64(bit - 1)) & np.uint64(7)


@njit(types.int64(WORK, types.int64, types.int64), cache=True, nogil=True)
def _neighbourhood(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """The eight neighbours of (y, x), bit k for neighbour k + 1."""
    up, middle, low = (
        np.int64(_three(columns, y - 1, x)),
        np.int64(_three(columns, y, x)),
        np.int64(_three(columns, y + 1, x)),
    )
    north = (up >> 2) << 1 | (up >> 1 & 1) << 2 | (up & 1) << 3
    south = (low & 1) << 5 | (low >> 1 & 1) << 6 | (low >> 2) << 7
    return middle >> 2 | north | (middle & 1) << 4 | south


@njit(types.int64(WORK, WORK, SPOTS), cache=True, nogil=True)
def simple_pixels(columns, anchor, spots):  # type: ignore[no-untyped-def]  # numba types it
    """Fill spots (n, 2: y, x) with the pixels of crossing number 1 that are not anchored, as many as fit.

    Returns how many there are.
    """
    words, height = columns.shape
    line = np.empty(height - 2, np.uint64)
    found = 0
    for w in range(1, words - 1):
        west, here, east, fixed = columns[w - 1], columns[w], columns[w + 1], anchor[w][1:]
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
            b1, b2, b3, b4 = ~x1 & (x2 | x3), ~x3 & (x4 | x5), ~x5 & (x6 | x7), ~x7 & (x8 | x1)
            line[i] = c & ~fixed[i] & (b1 ^ b2 ^ b3 ^ b4) & ~((b1 & b2) | (b3 & b4))
        for i in range(height - 2):
            word = line[i]
            while word != U0:
                if found < spots.shape[0]:
                    spots[found, 0], spots[found, 1] = i + 1, 64 * w + lowest_bit(word)
                found += 1
                word &= word - U1
    return found


@njit
def _by_rows(spots, count, height):  # type: ignore[no-untyped-def]  # numba types it
    """The spots row by row, from the left: so the order does not depend on where words of 64 pixels begin, and a
    layer that is moved comes out moved. They come column of words by column of words, each from the top."""
    starts = np.zeros(height + 1, np.int64)
    for j in range(count):
        starts[spots[j, 0] + 1] += 1
    for y in range(height):
        starts[y + 1] += starts[y]
    sorted_spots = np.empty((count, 2), np.int64)
    for j in range(count):
        k = starts[spots[j, 0]]
        starts[spots[j, 0]] += 1
        sorted_spots[k, 0], sorted_spots[k, 1] = spots[j, 0], spots[j, 1]
    return sorted_spots


@njit
def _depth(depths, top, offsets, lengths, outside, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Distance from (y, x) to the nearest void pixel; the deepest level that holds it says what not to look at."""
    k = 0
    while k + 1 < top and _bit(depths[k + 1], y, x):
        k += 1
    solid = depths[0]
    for i in range(outside[k], lengths.shape[0]):
        v, u = y + offsets[i, 0], x + offsets[i, 1]
        if not (0 <= v < solid.shape[1] and 0 <= u < 64 * solid.shape[0] and _bit(solid, v, u)):
            return lengths[i]
    return lengths[lengths.shape[0] - 1]


@njit
def _demand(balls, radii, following, head, y, x, scale):  # type: ignore[no-untyped-def]  # numba types it
    """What radius a disc at (y, x) needs to hold the balls of the list that starts at `head`."""
    most = 0.0
    while head >= 0:
        dy, dx = scale[0] * (balls[head, 0] - y), scale[1] * (balls[head, 1] - x)
        most = max(most, radii[head] + math.sqrt(dy * dy + dx * dx))
        head = following[head]
    return most


@njit
def _slot(keys, key):  # type: ignore[no-untyped-def]  # numba types it
    """Slot of a key in an open hash table, or of the empty slot where it belongs."""
    mask = keys.shape[0] - 1
    i = (key * 0x9E3779B1) & mask
    while keys[i] != -1 and keys[i] != key:
        i = (i + 1) & mask
    return i


@njit
def _filled(count):  # type: ignore[no-untyped-def]  # numba types it
    """(count,) int64, all -1."""
    out = np.empty(count, np.int64)
    for i in range(count):
        out[i] = -1
    return out


@njit
def _leave(keys, heads, used, key, head):  # type: ignore[no-untyped-def]  # numba types it
    """Keep a list at a pixel. Returns the table, which may have grown, and how many slots are used."""
    if 2 * used > keys.shape[0]:
        old_keys, old_heads = keys, heads
        keys, heads = _filled(2 * old_keys.shape[0]), _filled(2 * old_keys.shape[0])
        for i in range(old_keys.shape[0]):
            if old_keys[i] >= 0:
                k = _slot(keys, old_keys[i])
                keys[k], heads[k] = old_keys[i], old_heads[i]
    i = _slot(keys, key)
    used += keys[i] < 0
    keys[i], heads[i] = key, head
    return keys, heads, used


@njit
def _twice(balls, radii, following):  # type: ignore[no-untyped-def]  # numba types it
    """The same lists with room for as many again."""
    n = radii.shape[0]
    more, more_radii, more_following = np.empty((2 * n, 2), np.int64), np.empty(2 * n), _filled(2 * n)
    for i in range(n):
        more[i, 0], more[i, 1], more_radii[i], more_following[i] = balls[i, 0], balls[i, 1], radii[i], following[i]
    return more, more_radii, more_following


@njit
def _is_end(columns, anchor, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Whether a pixel may be deleted, now that a neighbour has gone."""
    return not _bit(anchor, y, x) and CROSSING[_neighbourhood(columns, y, x)] == 1


@njit
def _first_ends(columns, anchor, spots, count, ends):  # type: ignore[no-untyped-def]  # numba types it
    """Delete corners of 4-connected steps and branches of one pixel; write what else is simple, or becomes so, to
    ends (y, x). Returns how many."""
    found = 0
    for j in range(count):
        y, x = spots[j]
        code = _neighbourhood(columns, y, x)
        if CROSSING[code] != 1 or not _bit(columns, y, x):
            continue
        if COUNT[code] == 1:
            v, u = y + DY[FIRST[code]], x + DX[FIRST[code]]
            if not (_bit(anchor, v, u) or COUNT[_neighbourhood(columns, v, u)] > 2):
                ends[found, 0], ends[found, 1] = y, x
                found += 1
                continue
        _clear(columns, y, x)
        for i in range(8):
            v, u = y + DY[i], x + DX[i]
            if (code >> i) & 1 and _is_end(columns, anchor, v, u):
                ends[found, 0], ends[found, 1] = v, u
                found += 1
    return found


@njit(types.int64(WORK, WORK, WORK, IMAGES, types.int64, TABLE, LENGTHS, NUMBERS,
                  types.float64, types.UniTuple(types.float64, 2), types.float64),
      cache=True, nogil=True)  # fmt: skip
def retreat(columns, anchor, significant_pixels, depths, top, offsets, lengths, outside, radius, scale, pixel):  # type: ignore[no-untyped-def]  # numba types it
    """Draw the ends back in place, the least demanding first. Returns how many pixels were looked at.

    depths, top  the erosions and how many are not empty; offsets, lengths, outside, scale, pixel: of the `Plan`
    """
    spots = np.empty((4096, 2), np.int64)
    count = simple_pixels(columns, anchor, spots)
    if count > spots.shape[0]:
        spots = np.empty((count, 2), np.int64)
        simple_pixels(columns, anchor, spots)
    spots = _by_rows(spots, count, columns.shape[1])
    ends = np.empty((8 * count + 64, 2), np.int64)
    going = _first_ends(columns, anchor, spots, count, ends)
    demands, heads_of = np.zeros(ends.shape[0]), _filled(ends.shape[0])
    size = 1024
    while size < 4 * going:
        size *= 2
    keys, heads, used = _filled(size), _filled(size), 0
    room = 4 * going + 64
    balls, radii, following, ball = np.empty((room, 2), np.int64), np.empty(room), _filled(room), 0
    height = columns.shape[1]
    visits, limit = 0, 0.0
    while going > 0:
        limit += TURN_PX * pixel
        left, j = 0, 0
        while j < going:
            y, x, head = ends[j, 0], ends[j, 1], heads_of[j]
            waits = demands[j] > limit
            j += 1
            if waits:
                ends[left, 0], ends[left, 1], demands[left], heads_of[left] = y, x, demands[j - 1], head
                left += 1
                continue
            while True:
                if used > 0:
                    i = _slot(keys, x * height + y)
                    if keys[i] >= 0 and heads[i] >= 0:  # what other ends left here
                        if head < 0:
                            head = heads[i]
                        else:
                            last = head
                            while following[last] >= 0:
                                last = following[last]
                            following[last] = heads[i]
                        heads[i] = -1
                if not _bit(columns, y, x) or _bit(anchor, y, x):
                    break
                visits += 1
                code = _neighbourhood(columns, y, x)
                stays = CROSSING[code] != 1
                best_y, best_x = y, x
                if not stays:
                    far = True
                    if head >= 0:
                        dy, dx = scale[0] * (balls[head, 0] - y), scale[1] * (balls[head, 1] - x)
                        far = dy * dy + dx * dx >= (EVERY_PX * pixel) ** 2
                    if far and _bit(significant_pixels, y, x):
                        if ball == radii.shape[0]:
                            balls, radii, following = _twice(balls, radii, following)
                        balls[ball, 0], balls[ball, 1], following[ball] = y, x, head
                        depth = _depth(depths, top, offsets, lengths, outside, y, x)
                        off_axis = OFF_AXIS_PX if depth > INSIDE_PX * pixel else 0.0
                        radii[ball] = min(depth + (off_axis - 0.5) * pixel, radius)
                        head = ball
                        ball += 1
                    now = _demand(balls, radii, following, head, y, x, scale)
                    if now > limit:
                        ends[left, 0], ends[left, 1], demands[left], heads_of[left] = y, x, now, head
                        left += 1
                        break
                    then = np.inf
                    for i in range(8):
                        if (code >> i) & 1:
                            demand = _demand(balls, radii, following, head, y + DY[i], x + DX[i], scale)
                            if demand < then:
                                then, best_y, best_x = demand, y + DY[i], x + DX[i]
                    stays = now + then > 2 * radius + TIE_PX * pixel
                if stays:
                    if head >= 0:
                        keys, heads, used = _leave(keys, heads, used, x * height + y, head)
                    break
                _clear(columns, y, x)
                if COUNT[code] > 1:
                    for i in range(8):
                        v, u = y + DY[i], x + DX[i]
                        other = (code >> i) & 1 and not (v == best_y and u == best_x)
                        if other and going < ends.shape[0] and _is_end(columns, anchor, v, u):
                            ends[going, 0], ends[going, 1], demands[going], heads_of[going] = v, u, 0.0, -1
                            going += 1
                y, x = best_y, best_x
        going = left
    return visits
