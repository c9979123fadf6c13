"""The metric rule once more, slow and plain (see `layerfix.layers.metric`): whole images and Python's own lists."""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy import ndimage

from layerfix.layers.metric.ends import (
    LEAST_PX,
    LIMIT_PX,
    LONGEST_PX,
    NARROW_PX,
    SHARE,
    SHORTEST_PX,
    SLIGHTLY_PX,
    WIDER,
)
from layerfix.layers.metric.levels import plan_for
from layerfix.layers.metric.retreat import EVERY_PX, INSIDE_PX, OFF_AXIS_PX, TIE_PX, TURN_PX
from layerfix.layers.metric.tiles import CROSS, DISC3, HORIZONTAL, SQUARE, VERTICAL
from tests.slow_twin import NEIGHBOURS, seen_at, spur_step, sub_iteration

Y3, X3 = np.mgrid[-3:4, -3:4]
ELEMENTS = {
    CROSS: ndimage.generate_binary_structure(2, 1),
    SQUARE: np.ones((3, 3), bool),
    HORIZONTAL: np.ones((1, 3), bool),
    VERTICAL: np.ones((3, 1), bool),
    DISC3: X3**2 + Y3**2 <= 9,
}


def eroded(image: np.ndarray, element: np.ndarray) -> np.ndarray:
    """S ⊖ element, outside is void."""
    return ndimage.binary_erosion(image, element, border_value=0)


def depth_levels(image: np.ndarray, rx: float, ry: float) -> list[np.ndarray]:
    """The erosions of the plan, up to the first empty one."""
    plan = plan_for(rx, ry)
    depths = [image]
    for k, (parent, element) in enumerate(plan.levels[1:], 1):
        if plan.round:
            level = eroded(depths[parent], ELEMENTS[element])
        else:
            half = plan.half_widths[plan.starts[k] : plan.starts[k + 1]]
            y, x = np.mgrid[-len(half) + 1 : len(half), -half[0] : half[0] + 1]
            level = eroded(image, abs(x) <= half[abs(y)])
        if not level.any():
            break
        depths.append(level)
    return depths


def unexplained(image: np.ndarray, anchor: np.ndarray, depths: list[np.ndarray], rx: float, ry: float) -> np.ndarray:
    """K: what no cone of the anchored and of deeper pixels reaches."""
    plan = plan_for(rx, ry)
    steps = [ELEMENTS[e] for e in plan.elements]
    cones, out, step = anchor.copy(), np.zeros_like(image), 0
    for k in reversed(range(len(plan.levels))):
        source, before, after = plan.schedule[k]
        if 0 <= source < len(depths):
            grown = depths[source]
            for j in range(before):
                grown = ndimage.binary_dilation(grown, steps[(step + j) % len(steps)]) & image
            cones = cones | grown
        for _ in range(after):
            cones = ndimage.binary_dilation(cones, steps[step % len(steps)]) & image
            step += 1
        if k < len(depths):
            deeper = depths[k + 1] if k + 1 < len(depths) else np.zeros_like(image)
            out |= depths[k] & ~deeper & ~cones & ~anchor
    return out


def thinned(image: np.ndarray, anchor: np.ndarray, protected: np.ndarray) -> np.ndarray:
    """Guo–Hall around `anchor`, ends outside `protected` removed each round, until nothing changes."""
    now, before = image, None
    while before is None or not np.array_equal(now, before):
        before = now
        now = spur_step(sub_iteration(sub_iteration(now, anchor, 1), anchor, 2), protected)
    return now


def neighbours(image: np.ndarray, y: int, x: int) -> list[bool]:
    """x1 … x8 of a pixel that is not at the frame's edge."""
    return [bool(image[y + dy, x + dx]) for dx, dy in NEIGHBOURS]


def crossing_number(around: list[bool]) -> int:
    """Guo and Hall's X_H."""
    return sum(not around[k] and (around[k + 1] or around[(k + 2) % 8]) for k in (0, 2, 4, 6))


def tips(image: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Kept pixels that have neighbours, all of which lie within 90°."""
    out = np.zeros_like(image)
    for y, x in zip(*np.nonzero(image & kept), strict=True):
        directions = np.flatnonzero(neighbours(image, y, x))
        apart = [min((a - b) % 8, (b - a) % 8) for a in directions for b in directions]
        out[y, x] = bool(len(directions)) and max(apart) <= 2
    return out


def distance_to_void(image: np.ndarray, sy: float, sx: float) -> np.ndarray:
    """Of each pixel the distance to the nearest void pixel's centre."""
    return np.asarray(ndimage.distance_transform_edt(image, sampling=(sy, sx)))


def retreated(
    image: np.ndarray, anchor: np.ndarray, kept: np.ndarray, solid: np.ndarray, rx: float, ry: float
) -> np.ndarray:
    """Every end walked back until F just holds the balls of what it walked over."""
    plan = plan_for(rx, ry)
    (sy, sx), pixel, radius = plan.scale, plan.pixel, plan.radius
    image, depth = image.copy(), distance_to_void(solid, sy, sx)

    def simple(y: int, x: int) -> bool:
        return bool(image[y, x] and not anchor[y, x]) and crossing_number(neighbours(image, y, x)) == 1

    def may_go(y: int, x: int) -> bool:
        return not anchor[y, x] and crossing_number(neighbours(image, y, x)) == 1

    def around(y: int, x: int) -> list[tuple[int, int]]:
        return [(y + dy, x + dx) for dx, dy in NEIGHBOURS if image[y + dy, x + dx]]

    def demand(balls: list[tuple[int, int, float]], y: int, x: int) -> float:
        return max((rho + math.sqrt((sy * (v - y)) ** 2 + (sx * (u - x)) ** 2) for v, u, rho in balls), default=0.0)

    height, width = image.shape
    at_first = [(y, x) for y, x in np.ndindex(height, width) if simple(y, x)]  # row by row
    ends: list[tuple[int, int, float, list[tuple[int, int, float]]]] = []
    for y, x in at_first:
        if not simple(y, x):
            continue
        beside = around(y, x)
        if len(beside) == 1:
            v, u = beside[0]
            if not (anchor[v, u] or len(around(v, u)) > 2):
                ends.append((y, x, 0.0, []))
                continue
        image[y, x] = False
        ends += [(v, u, 0.0, []) for v, u in beside if may_go(v, u)]
    left_at: dict[tuple[int, int], list[tuple[int, int, float]]] = {}
    limit = 0.0
    while ends:
        limit += TURN_PX * pixel
        later = []
        for y, x, waits, balls in ends:  # grows while it is walked
            if waits > limit:
                later.append((y, x, waits, balls))
                continue
            while True:
                balls = balls + left_at.pop((y, x), [])
                if not image[y, x] or anchor[y, x]:
                    break
                if crossing_number(neighbours(image, y, x)) != 1:
                    left_at[y, x] = balls
                    break
                far = (
                    not balls
                    or (sy * (balls[0][0] - y)) ** 2 + (sx * (balls[0][1] - x)) ** 2 >= (EVERY_PX * pixel) ** 2
                )
                if far and kept[y, x]:
                    off_axis = OFF_AXIS_PX if depth[y, x] > INSIDE_PX * pixel else 0.0
                    balls = [(y, x, min(depth[y, x] + (off_axis - 0.5) * pixel, radius)), *balls]
                now = demand(balls, y, x)
                if now > limit:
                    later.append((y, x, now, balls))
                    break
                beside = around(y, x)
                best = min(beside, key=lambda p: demand(balls, *p))  # the first of equals
                if now + demand(balls, *best) > 2 * radius + TIE_PX * pixel:
                    left_at[y, x] = balls
                    break
                image[y, x] = False
                if len(beside) > 1:
                    ends += [(v, u, 0.0, []) for v, u in beside if (v, u) != best and may_go(v, u)]
                y, x = best
        ends = later
    return image


def ends_set_right(
    image: np.ndarray, anchor: np.ndarray, solid: np.ndarray, offsets: list[tuple[int, int]]
) -> np.ndarray:
    """Each end of a path moved to where F, pixels at these offsets (x, y), ends where S does."""
    image = image.copy()
    most = max(max(map(abs, axis)) for axis in zip(*offsets, strict=True)) + 1

    def beside(y: int, x: int) -> list[tuple[int, int]]:
        return [(y + dy, x + dx) for dx, dy in NEIGHBOURS if image[y + dy, x + dx]]

    def is_solid(y: int, x: int) -> bool:
        return 0 <= y < solid.shape[0] and 0 <= x < solid.shape[1] and bool(solid[y, x])

    def half_width(y: int, x: int, ux: float, uy: float) -> int:
        n = 0
        while n < most + 1 and is_solid(math.floor(y + (n + 1) * uy + 0.5), math.floor(x + (n + 1) * ux + 0.5)):
            n += 1
        return n

    def end_of_solid(y: int, x: int, ux: float, uy: float) -> float:
        steep = abs(uy) > abs(ux)
        main, side = (uy, ux) if steep else (ux, uy)
        step, main = int(math.copysign(1, main)), abs(main)
        widths = [max(NARROW_PX, SHARE * half_width(y, x, s * -uy, s * ux)) for s in (1, -1)]
        above, below = widths if (uy < 0 if steep else ux >= 0) else widths[::-1]
        reached, far, k = {0}, 0.0, 0
        while k <= (most + LIMIT_PX + 1) * main:
            line, wider = k * side / main, WIDER * k / main

            def window(extra: float) -> range:
                low = math.ceil(line - (below + wider + extra) / main)  # noqa: B023
                return range(low, math.floor(line + (above + wider + extra) / main) + 1)  # noqa: B023

            full = {
                j
                for j in window(SLIGHTLY_PX)
                if is_solid(*((y + k * step, x + j) if steep else (y + j, x + k * step)))
            }
            near = (k > 0) and 1
            touched = [j for j in full if min(reached) - near <= j <= max(reached) + near]
            if not touched:
                break
            first, last = min(touched), max(touched)
            while first - 1 in full:
                first -= 1
            while last + 1 in full:
                last += 1
            reached = {first, last}
            allowed = [j for j in window(0.0) if first <= j <= last]
            if allowed:
                far = max(far, k * main + (max(allowed) if side > 0 else min(allowed)) * side)
            k += 1
        return far

    ends = [(y, x) for y, x in np.argwhere(image & ~anchor).tolist() if len(beside(y, x)) == 1]
    for y, x in ends:
        path = [(y, x)]
        while len(path) <= min(max(most, 3), LONGEST_PX) and not anchor[path[-1]]:
            ways = [p for p in beside(*path[-1]) if p not in path[-2:-1]]
            if len(ways) != 1:
                break
            path += ways
        length = math.sqrt((x - path[-1][1]) ** 2 + (y - path[-1][0]) ** 2)
        if length < SHORTEST_PX:
            continue
        ux, uy = (x - path[-1][1]) / length, (y - path[-1][0]) / length
        gap = end_of_solid(y, x, ux, uy) - reach_of(offsets, ux, uy)

        def along(v: int, u: int) -> float:
            return (u - x) * ux + (v - y) * uy  # noqa: B023

        done = 0.0
        if LEAST_PX < gap <= LIMIT_PX:
            for k in range(1, 100):
                if abs(ux) >= abs(uy):
                    v, u = math.floor(y + k * uy / abs(ux) + 0.5), x + (k if ux > 0 else -k)
                else:
                    v, u = y + (k if uy > 0 else -k), math.floor(x + k * ux / abs(uy) + 0.5)
                nearer = abs(gap - along(v, u)) < abs(gap - done)
                if not nearer or not is_solid(v, u) or image[v, u] or len(beside(v, u)) != 1:
                    break
                image[v, u], done = True, along(v, u)
        elif -LIMIT_PX <= gap < -LEAST_PX:
            for before, (v, u) in itertools.pairwise(path[:-1]):
                nearer = abs(gap - along(v, u)) < abs(gap - done)
                if not nearer:
                    break
                image[before], done = False, along(v, u)
    return image


def reach_of(offsets: list[tuple[int, int]], ux: float, uy: float) -> float:
    """How far F reaches along a direction: as the kernel adds it up, G first, then the half pixels."""
    bx, by = (max(o[axis] for o in offsets) + min(o[axis] for o in offsets) for axis in (0, 1))
    pixels = {*offsets}
    disc = [(x, y) for x, y in offsets if {(x + bx, y), (x, y + by), (x + bx, y + by)} <= pixels]
    most = max(abs(uy) * abs(y) + abs(ux) * abs(x) for x, y in disc)
    return most + max(bx * ux, 0.0) + max(by * uy, 0.0)


def thin_metric(
    image: np.ndarray, anchor: np.ndarray, rx: float, ry: float, offsets: list[tuple[int, int]]
) -> np.ndarray:
    """S thinned around an anchor by the metric rule; offsets: of F's pixels (x, y)."""
    pad = ((4, 4), (64, 64))
    solid, fixed = np.pad(image, pad), np.pad(anchor, pad)
    depths = depth_levels(solid, rx, ry)
    kept = unexplained(solid, fixed, depths, rx, ry)
    once = thinned(solid, fixed | kept, fixed | kept)
    twice = thinned(once, fixed | tips(once, kept & ~fixed), fixed | kept)
    drawn_back = retreated(twice, fixed, kept, solid, rx, ry)
    return ends_set_right(drawn_back, fixed, solid, offsets)[4:-4, 64:-64]


def disc_offsets(rx: float, ry: float) -> list[tuple[int, int]]:
    """F by radius: offsets (x, y) with (x/rx)² + (y/ry)² ≤ 1."""
    return [
        (x, y)
        for y in range(-math.floor(ry + 1e-6), math.floor(ry + 1e-6) + 1)
        for x in range(-math.floor(rx + 1e-6), math.floor(rx + 1e-6) + 1)
        if (x / rx) ** 2 + (y / ry) ** 2 <= 1 + 1e-9
    ]


def feature_offsets(dx: float, dy: float) -> list[tuple[int, int]]:
    """F by size: offsets (x, y) whose centres lie within d/2 of a pixel's centre or of its south-east corner, and the
    whole middle row and column."""
    wide, high = math.floor(dx + 0.5 + 1e-9), math.floor(dy + 0.5 + 1e-9)
    cx, cy = 0.5 * (wide % 2 == 0), 0.5 * (high % 2 == 0)
    west, north = -((wide - 1) // 2), -((high - 1) // 2)
    return [
        (x, y)
        for y in range(north, north + high)
        for x in range(west, west + wide)
        if ((x - cx) / (dx / 2)) ** 2 + ((y - cy) / (dy / 2)) ** 2 <= 1 + 1e-9
        or abs(x - cx) == cx or abs(y - cy) == cy
    ]  # fmt: skip


def moved_and(image: np.ndarray, offsets: list[tuple[int, int]]) -> np.ndarray:
    """Pixels p with every p + offset solid."""
    return np.all([seen_at(image, *offset) for offset in offsets], axis=0)


def moved_or(image: np.ndarray, offsets: list[tuple[int, int]]) -> np.ndarray:
    """Pixels p - offset … that is, the image drawn with every offset."""
    return np.any([seen_at(image, -dx, -dy) for dx, dy in offsets], axis=0)


def opening(image: np.ndarray, dx: float, dy: float) -> np.ndarray:
    """S ∘ F, F by size."""
    offsets = feature_offsets(dx, dy)
    return moved_or(moved_and(image, offsets), offsets)


def anchor_of(image: np.ndarray, dx: float, dy: float) -> np.ndarray:
    """A = (S ⊖ F) ⊕ block."""
    offsets = feature_offsets(dx, dy)
    bx, by = (max(o[axis] for o in offsets) + min(o[axis] for o in offsets) for axis in (0, 1))  # 1 if even, else 0
    block = [(x, y) for x in range(bx + 1) for y in range(by + 1)]
    return moved_or(moved_and(image, offsets), block)


def corrected(image: np.ndarray, dx: float, dy: float, skeleton: np.ndarray) -> np.ndarray:
    """As printed with F by size: S ∘ F and the paths of M̂ that have something to add, drawn with F."""
    offsets = feature_offsets(dx, dy)
    kept = opening(image, dx, dy)
    needed = moved_and(~(image & ~kept), offsets)
    paths = skeleton & ~anchor_of(image, dx, dy) & ~needed
    return kept | moved_or(paths, offsets)
