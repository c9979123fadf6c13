"""How wide the solid is where a skeletal path runs through it."""

from __future__ import annotations

import numpy as np
from numba import types

from layerfix.bits import ALL, U0, U1, WORK, highest_bit, lowest_bit
from layerfix.kernels import njit

SIGHT_PX = 31  # how far a look at one word sees to either side
DOUBT_PX = 1.2  # what a first look may be off by
PLACES, FEW_PLACES = 24, 6  # measured at most; at least where there are so many: the first is the end of a path
LONGEST_PX = 8  # to either side, along which edges are looked at
EVERY_PX, APART_PX = 5, 3  # along a path, where nothing is narrower than before
DIRECTIONS = 24
RAY_PX = 0.6  # half the breadth of a look in one direction
ROUNDING = 1e-9
SMALL_PX = 4.0  # of what is narrower, all is looked at
HIDING_PX = 2  # in a row: one is where a slanting line of pixels goes aside
ROUGH = 1.25  # a first look says at least so much less, where its direction is another
LONE_PX = 1.3  # mean width of what is a pixel or two
SMALL_PIN, ROUND_PIN = 1.8, 1.35  # most over least width of what is a pin, under five pixels and above


@njit
def _solid(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Pixel (y, x) of `layerfix.layers.columns`, x counted from the first bit; anything outside is void."""
    if y < 0 or x < 0 or y >= columns.shape[1] or x >= columns.shape[0] * 64:
        return False
    return (columns[x >> 6, y] >> np.uint64(x & 63)) & U1 != U0


@njit
def _void_around(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """The void pixels x - 32 … x + 31 of row y as bits 0 … 63; all of them outside the array."""
    if y < 0 or y >= columns.shape[1]:
        return ALL
    first = x - 32
    w, shift = first >> 6, np.uint64(first & 63)
    low = columns[w, y] if 0 <= w < columns.shape[0] else U0
    if shift == U0:
        return ~low
    high = columns[w + 1, y] if 0 <= w + 1 < columns.shape[0] else U0
    return ~((low >> shift) | (high << (np.uint64(64) - shift)))


@njit
def _nearest_step(void, within):  # type: ignore[no-untyped-def]  # numba types it
    """Signed steps from bit 32 to the nearest set bit at most `within` away; `within` + 1 if there is none."""
    for step in range(within + 1):
        if (void >> np.uint64(32 - step)) & U1:
            return -step
        if (void >> np.uint64(32 + step)) & U1:
            return step
    return within + 1


@njit
def _nearest_far(columns, y, x, within):  # type: ignore[no-untyped-def]  # numba types it
    """The same over several words, for features wider than a look sees."""
    for step in range(within + 1):
        if not _solid(columns, y, x - step):
            return -step
        if not _solid(columns, y, x + step):
            return step
    return within + 1


@njit
def _width_mm(columns, y, x, best, px_mm, py_mm):  # type: ignore[no-untyped-def]  # numba types it
    """Width of the solid across pixel (y, x), or `best` if it is not below it."""
    near = (best + max(px_mm, py_mm)) / 2  # the width is at least 2 · near − 1 px
    dx_mm, dy_mm = 0.0, 0.0
    found = False
    dy = 0
    while dy * py_mm < near:
        within = int(np.sqrt(near**2 - (dy * py_mm) ** 2) / px_mm)
        for sign in (-1, 1):
            if within > SIGHT_PX:
                step = _nearest_far(columns, y + sign * dy, x, within)
            else:
                sight = (ALL >> np.uint64(63 - 2 * within)) << np.uint64(32 - within)
                void = _void_around(columns, y + sign * dy, x) & sight
                if void == U0:
                    continue
                step = _nearest_step(void, within)
            distance = np.hypot(step * px_mm, dy * py_mm)
            if distance < near:
                near, dx_mm, dy_mm, found = distance, step * px_mm, sign * dy * py_mm, True
        dy += 1
    if not found:
        return best
    ux, uy = -dx_mm / near, -dy_mm / near
    stride = 0.5 * min(px_mm, py_mm)
    across = stride
    while across < best and _solid(columns, y + round(uy * across / py_mm), x + round(ux * across / px_mm)):
        across += stride
    if across >= best:
        return best
    # Snap to the centre of that void pixel, as the near side was measured to a centre.
    far = np.hypot(round(uy * across / py_mm) * py_mm, round(ux * across / px_mm) * px_mm)
    return min(best, max(near + far - np.hypot(ux * px_mm, uy * py_mm), min(px_mm, py_mm)))


@njit
def _inverse(slope):  # type: ignore[no-untyped-def]  # numba types it
    return 1 / slope if abs(slope) > 1e-12 else np.inf


@njit
def _between_mm(per_mm, start, least, most):  # type: ignore[no-untyped-def]  # numba types it
    """The t for which least ≤ start + t / per_mm ≤ most, as (first, last); (1, -1) if there are none."""
    if abs(per_mm) > 1e9:
        return (-1e6, 1e6) if least - 1e-9 <= start <= most + 1e-9 else (1.0, -1.0)
    a, b = (least - start) * per_mm, (most - start) * per_mm
    return min(a, b) - 1e-9, max(a, b) + 1e-9


@njit
def _pixels_from(columns, y, x):  # type: ignore[no-untyped-def]  # numba types it
    """Pixels x … x + 63 of row y as one word; void outside the array."""
    if y < 0 or y >= columns.shape[1]:
        return U0
    w, shift = x >> 6, np.uint64(x & 63)
    low = columns[w, y] if 0 <= w < columns.shape[0] else U0
    if shift == U0:
        return low
    high = columns[w + 1, y] if 0 <= w + 1 < columns.shape[0] else U0
    return (low >> shift) | (high << (np.uint64(64) - shift))


@njit(types.UniTuple(types.float64, 2)(WORK, *[types.float64] * 9), cache=True, nogil=True)
def edges_mm(columns, y, x, ux, uy, beyond_mm, along_mm, parted_mm, px_mm, py_mm):  # type: ignore[no-untyped-def]  # numba types it
    """(farthest solid, nearest void) pixel centre from the point (y, x) along the direction u, in mm, among those up
    to `along_mm` to either side of it and `beyond_mm` away.

    It stops looking once the void begins no more than `parted_mm` past the solid.
    """
    solid, void = 0.0, np.inf
    top, bottom = y + min(beyond_mm * uy, 0.0) / py_mm, y + max(beyond_mm * uy, 0.0) / py_mm
    aside = along_mm * abs(ux) / py_mm
    per_ux, per_uy, per_px = _inverse(ux), _inverse(uy), 1 / px_mm
    for v in range(int(np.floor(top - aside)), int(bottom + aside) + 2):
        dy_mm = (v - y) * py_mm
        first, last = _between_mm(per_ux, uy * dy_mm, 0.0, beyond_mm)
        low, high = _between_mm(per_uy, -ux * dy_mm, -along_mm, along_mm)
        u, end = int(np.ceil(x + max(first, low) * per_px)), int(np.floor(x + min(last, high) * per_px))
        while u <= end and ux * ((u if ux > 0 else end) - x) * px_mm + uy * dy_mm <= 0:  # behind the point
            u, end = (u + 1, end) if ux > 0 else (u, end - 1)
        while u <= end:
            inside = ALL >> np.uint64(max(63 - (end - u), 0))
            pixels = _pixels_from(columns, v, u)
            here, free = pixels & inside, ~pixels & inside
            if here != U0:
                far = u + (highest_bit(here) if ux > 0 else lowest_bit(here))
                solid = max(solid, ux * (far - x) * px_mm + uy * dy_mm)
            if free != U0:
                near = u + (lowest_bit(free) if ux > 0 else highest_bit(free))
                void = min(void, ux * (near - x) * px_mm + uy * dy_mm)
            u += 64
        if void - solid <= parted_mm:
            break
    return solid, void


@njit
def _chords_mm(columns, y, x, beyond_mm, px_mm, py_mm):  # type: ignore[no-untyped-def]  # numba types it
    """(least, most, mean) width through the point (y, x) in all directions, and the middle of the edges (y, x); inf
    for `most` where a direction has no edge."""
    ray_mm = RAY_PX * max(px_mm, py_mm)
    least, most, total, middle_y, middle_x = np.inf, 0.0, 0.0, 0.0, 0.0
    for k in range(DIRECTIONS):
        ux, uy = np.cos(np.pi * k / DIRECTIONS), np.sin(np.pi * k / DIRECTIONS)
        solid, void = edges_mm(columns, y, x, ux, uy, beyond_mm, ray_mm, -np.inf, px_mm, py_mm)
        if void == np.inf:
            return least, void, void, y, x
        far_solid, far_void = edges_mm(columns, y, x, -ux, -uy, beyond_mm, ray_mm, -np.inf, px_mm, py_mm)
        if far_void == np.inf:
            return least, far_void, far_void, y, x
        across, off = (solid + void + far_solid + far_void) / 2, (solid + void - far_solid - far_void) / 2
        least, most, total = min(least, across), max(most, across), total + across
        middle_y, middle_x = middle_y + off * uy, middle_x + off * ux
    return least, most, total / DIRECTIONS, y + middle_y / DIRECTIONS / py_mm, x + middle_x / DIRECTIONS / px_mm


@njit
def _between_edges_mm(columns, y, x, rough_mm, px_mm, py_mm):  # type: ignore[no-untyped-def]  # numba types it
    """Width across (y, x) from both edges, each half-way between the last solid and the first void pixel centre.

    Over as long a stretch, and in the direction, in which the solid and the void are most nearly parted by two lines:
    walls are measured along several pixels, necks along few. (Half-way also holds a few degrees off.) A pin, about as
    wide in all directions from its middle, is as wide as they are on average.
    """
    pixel_mm = max(px_mm, py_mm)
    beyond_mm = max(rough_mm + 1.5 * pixel_mm, SMALL_PX * pixel_mm)  # a path may run along one side
    least, most, mean, middle_y, middle_x = _chords_mm(columns, y, x, beyond_mm, px_mm, py_mm)
    if most < np.inf:
        least, most, mean, _, _ = _chords_mm(columns, middle_y, middle_x, beyond_mm, px_mm, py_mm)
        if most < np.inf and most <= least * (SMALL_PIN if mean < 5 * pixel_mm else ROUND_PIN):
            return mean if mean > LONE_PX * pixel_mm else least
    width_mm, widest_mm = rough_mm, ROUGH * rough_mm + DOUBT_PX * pixel_mm
    # Of what goes on, edges that just are parted end within the stretch.
    least_parted = ROUNDING if most == np.inf else 0.0
    for halvings in range(4):
        along_mm = max(min(rough_mm, LONGEST_PX * pixel_mm) / 2**halvings, RAY_PX * pixel_mm)
        parted = -np.inf
        for k in range(DIRECTIONS):
            ux, uy = np.cos(np.pi * k / DIRECTIONS), np.sin(np.pi * k / DIRECTIONS)
            solid, void = edges_mm(columns, y, x, ux, uy, beyond_mm, along_mm, parted, px_mm, py_mm)
            if void - solid <= parted:
                continue
            far_solid, far_void = edges_mm(columns, y, x, -ux, -uy, beyond_mm, along_mm, parted, px_mm, py_mm)
            gap, across = min(void - solid, far_void - far_solid), (solid + void + far_solid + far_void) / 2
            if parted < gap < np.inf and across <= widest_mm:  # not along a stub
                parted, width_mm = gap, across
        if parted >= least_parted:
            break
    return width_mm


@njit
def _seen_from(columns, y, x, reach_px, of_void):  # type: ignore[no-untyped-def]  # numba types it
    """(columns of what of the solid is seen from (y, x), up to so many pixels away; y and x of their first pixel).

    Seen is what a path of pixels reaches that leads outwards with every step, from one square around (y, x) to the
    next, unless two pixels in a row on the straight way there are not: what lies behind a gap, a hole or a thin wall.
    Of void, corners alone are no way.
    """
    size, middle = 2 * reach_px + 1, reach_px
    seen, hidden = np.zeros((size, size), np.bool_), np.zeros((size, size), np.int64)
    seen[middle, middle] = _solid(columns, y, x)
    out = np.zeros(((size >> 6) + 1, size), np.uint64)
    for ring in range(1, reach_px + 1):
        for k in range(-ring, ring + 1):
            for side in range(4):
                out_px = ring if side & 1 else -ring
                dy, dx = (out_px, k) if side < 2 else (k, out_px)
                found = False
                for step in range(-1, 2):
                    # The neighbours one square further in: beside this pixel along the square's side, one inwards.
                    v = dy + step if side > 1 else dy - (1 if dy > 0 else -1)
                    u = dx - (1 if dx > 0 else -1) if side > 1 else dx + step
                    if max(abs(v), abs(u)) != ring - 1 or not seen[middle + v, middle + u]:
                        continue
                    if of_void and v != dy and u != dx:
                        found |= _solid(columns, y + v, x + dx) or _solid(columns, y + dy, x + u)
                    else:
                        found = True
                v, u = (2 * dy * (ring - 1) + ring) // (2 * ring), (2 * dx * (ring - 1) + ring) // (2 * ring)
                before = hidden[middle + v, middle + u]
                found = found and before < HIDING_PX and _solid(columns, y + dy, x + dx)
                seen[middle + dy, middle + dx] = found
                hidden[middle + dy, middle + dx] = 0 if found else before + 1
    for v in range(size):
        for u in range(size):
            if seen[v, u]:
                out[u >> 6, v] |= U1 << np.uint64(u & 63)
    return out, y - middle, x - middle


@njit
def _make_room(rough_mm, spots, limit_mm):  # type: ignore[no-untyped-def]  # numba types it
    """Keep the places below the limit; if that are too many, every other one. Returns how many are left."""
    count = 0
    for k in range(rough_mm.shape[0]):
        if rough_mm[k] < limit_mm:
            rough_mm[count], spots[count, 0], spots[count, 1] = rough_mm[k], spots[k, 0], spots[k, 1]
            count += 1
    if count > rough_mm.shape[0] // 2:
        count //= 2
        for k in range(count):
            rough_mm[k], spots[k, 0], spots[k, 1] = rough_mm[2 * k], spots[2 * k, 0], spots[2 * k, 1]
    return count


@njit(types.float64(WORK, WORK, types.float64, types.float64, types.float64, types.boolean), cache=True, nogil=True)
def narrowest(columns, paths, limit_mm, px_mm, py_mm, of_void):  # type: ignore[no-untyped-def]  # numba types it
    """Width in mm of S at the narrowest pixel of the skeletal paths, at most `limit_mm`; inf without a path.

    A first look takes the distance to the nearest void pixel and to the void straight across; a pixel whose nearest
    void is too far to beat the best so far costs a few words. What may be the narrowest place is then measured, every
    few pixels (`_between_edges_mm`). Nothing is narrower than a pixel.
    of_void  S is the void of a layer: a line of pixels that touch at corners parts it
    """
    doubt_mm = DOUBT_PX * max(px_mm, py_mm)
    beyond_mm = limit_mm + 2 * doubt_mm
    best, least_mm = beyond_mm, min(px_mm, py_mm)
    rough_mm, spots = np.empty(PLACES), np.empty((PLACES, 2), np.int64)
    count = 0
    any_path = False
    for w in range(1, columns.shape[0] - 1):
        for y in range(1, columns.shape[1] - 1):
            path = paths[w, y]
            any_path |= path != U0
            while path != U0 and (best > least_mm or count < FEW_PLACES):
                x = w * 64 + lowest_bit(path)
                path &= path - U1
                limit = min(beyond_mm, best + doubt_mm) if (x + 2 * y) % EVERY_PX == 0 else best
                wide = _width_mm(columns, y, x, limit, px_mm, py_mm)
                if wide >= limit:
                    continue
                best = min(best, wide)
                last = count - 1
                if (
                    count
                    and max(abs(spots[last, 0] - y), abs(spots[last, 1] - x)) < APART_PX
                    and wide >= rough_mm[last]
                ):
                    continue
                if count == PLACES:
                    count = _make_room(rough_mm, spots, best + doubt_mm)
                rough_mm[count], spots[count, 0], spots[count, 1] = wide, y, x
                count += 1
    if not any_path:
        return np.inf
    width_mm = limit_mm
    for k in range(count):
        if rough_mm[k] < best + doubt_mm:
            reach_px = int(1.5 * rough_mm[k] / least_mm) + 4
            part, top, left = _seen_from(columns, spots[k, 0], spots[k, 1], reach_px, of_void)
            at_y, at_x = float(spots[k, 0] - top), float(spots[k, 1] - left)
            wide = _between_edges_mm(part, at_y, at_x, rough_mm[k], px_mm, py_mm)
            width_mm = min(width_mm, max(wide, least_mm))
    return width_mm
