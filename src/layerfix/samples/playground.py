"""The playground of `layerfix.samples`: hundreds of thin rods and a few thin sheets on one large plate."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.samples.shapes import (
    TURN,
    UP,
    around,
    balls,
    bars,
    boxes,
    cones,
    fence,
    join,
    loft,
    point,
    polar,
    posts,
    prism,
    raised,
    rods,
    rounded,
    sheet,
    spline,
    tube,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from layerfix.mesh.triangles import Mesh
    from layerfix.samples.shapes import Floats

GROUND_MM, GROUND_TOP_MM, ROOTED_MM = (139.7, 145.9), 2.4, 1.2
FORT_MIDDLE, FORT_HALF_MM, DECK_MM = np.array([46.0, 96.0]), 13.0, 20.0
KIOSK_MIDDLE, KIOSK_RADIUS_MM = np.array([104.0, 98.0]), 15.0


def playground() -> Mesh:
    """139.7 × 145.9 × 55.5 mm: two forts and a bridge, slides, swings, a net, a dome, a tree, a fence."""
    return join(
        [
            *_ground(),
            *_fort(),
            *_kiosk(),
            *_bridge(),
            *_slides(),
            *_fort_ladder(),
            *_fort_net(),
            *_swings(),
            *_dome(),
            *_roundabout(),
            *_seesaw(),
            *_spring_riders(),
            *_sandpit(),
            *_tree(),
        ]
    )


def _ground() -> list[Mesh]:
    """The base plate and a picket fence with a gate round it."""
    (x0, y0), (x1, y1) = (2.5, 2.5), (GROUND_MM[0] - 2.5, GROUND_MM[1] - 2.5)
    gate = np.array([(60.0, y0), (78.0, y0)])
    corners = np.array([gate[1], (x1, y0), (x1, y1), (x0, y1), (x0, y0), gate[0]])
    rails = [bars(corners[:-1], corners[1:], 0.4, z, z + 0.9) for z in (5.0, 10.0)]
    arch = np.linspace(0, np.pi, 40)
    arc = np.stack([69 - 9 * np.cos(arch), np.full(40, y0), 19.5 + 5 * np.sin(arch)], axis=1)
    return [
        prism(rounded((0, 0), GROUND_MM, 5), 0, GROUND_TOP_MM),
        *rails,
        tube(arc, 0.5, 12),
        posts(_evenly(corners, 2.4), 0.35, ROOTED_MM, 12.6, 8),
        posts(gate, 0.9, ROOTED_MM, 20.0, 20),
    ]


def _evenly(corners: Floats, pitch_mm: float) -> Floats:
    """Points about `pitch_mm` apart along the sides between (k, 2) corners, each corner once."""
    sides = []
    for a, b in pairwise(corners):
        count = round(float(np.linalg.norm(b - a)) / pitch_mm)
        sides.append(a + np.arange(count)[:, None] / count * (b - a))
    return np.concatenate([*sides, corners[-1:]])


def _chain(points: ArrayLike, radius_mm: float, sides: int) -> Mesh:
    """Rods from each of the (k, 3) points to the next."""
    path = np.asarray(points, np.float64)
    return rods(path[:-1], path[1:], radius_mm, sides)


def _railing(corners: Floats) -> list[Mesh]:
    """Balusters of 0.5 mm every 2 mm between (k, 2) corners of a deck, under a top rail."""
    low_mm, high_mm = DECK_MM + 1, DECK_MM + 9
    return [posts(_evenly(corners, 2.0), 0.25, low_mm, high_mm, 8), _chain(raised(corners, high_mm), 0.4, 10)]


def _tent(outline: Floats, low_mm: float, apex_mm: float, thickness_mm: float) -> Mesh:
    """A thin pyramid roof over a (n, 2) outline, open below."""
    middle = outline.mean(axis=0)
    slope = (apex_mm - low_mm) / float(np.linalg.norm(outline - middle, axis=1).min())
    share = 1 - thickness_mm * np.hypot(1, slope) / (apex_mm - low_mm)
    rings = [raised(middle + (outline - middle) * scale, low_mm) for scale in (share, 1.0)]
    inner_mm = low_mm + (apex_mm - low_mm) * share
    return loft(np.stack(rings), raised(middle, inner_mm), raised(middle, apex_mm))


def _fort() -> list[Mesh]:
    """A square deck on four posts under a steep roof, railed where nothing leads off."""
    square = FORT_MIDDLE + FORT_HALF_MM * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    deck = boxes(raised(square[0] - 1, DECK_MM), raised(square[2] + 1, DECK_MM + 1.2))
    roof = _tent(FORT_MIDDLE + (square - FORT_MIDDLE) * 1.25, 40.0, 55.5, 0.5)
    eaves = _chain(raised(square[[0, 1, 2, 3, 0]], 40.6), 0.6, 12)
    (x0, y0), (x1, y1) = square[0], square[2]
    lines = [
        [(x0, y0), (x0 + 7.6, y0)],
        [(x1 - 7.6, y0), (x1, y0), (x1, y0 + 8)],
        [(x1, y1 - 8), (x1, y1)],
        [(x0, y1), (x0, y1 - 8)],
        [(x0, y0 + 8), (x0, y0)],
    ]
    rails = [part for line in lines for part in _railing(np.array(line))]
    return [posts(square, 1.4, ROOTED_MM, 41.0, 20), deck, roof, eaves, *rails]


def _kiosk() -> list[Mesh]:
    """A round deck on six posts under a pointed roof, its railing open to the bridge and the spiral slide."""
    feet = polar(KIOSK_RADIUS_MM - 1.5, around(6, TURN / 12))[:, :2] + KIOSK_MIDDLE
    deck = prism(polar(KIOSK_RADIUS_MM, around(72))[:, :2] + KIOSK_MIDDLE, DECK_MM, DECK_MM + 1.2)
    roof = _tent(polar(KIOSK_RADIUS_MM + 2, around(12))[:, :2] + KIOSK_MIDDLE, 39.4, 51.0, 0.4)
    x, y = np.linspace(0, 8, 24), np.linspace(52.0, 54.8, 6)[:, None]
    cloth = np.stack(np.broadcast_arrays(x, 0.8 * np.sin(x), y - 0.05 * x), axis=-1) + raised(KIOSK_MIDDLE, 0)
    rail = polar(KIOSK_RADIUS_MM - 0.6, np.linspace(-TURN * 0.44, TURN * 0.06, 17))[:, :2] + KIOSK_MIDDLE
    return [
        posts(feet, 1.1, ROOTED_MM, 40.0, 18),
        deck,
        roof,
        posts(KIOSK_MIDDLE, 0.3, 48.0, 55.2, 10),
        sheet(cloth, 0.25),
        *_railing(rail),
    ]


def _bridge() -> list[Mesh]:
    """Planks on two sagging ropes, two more ropes as rails, and thin hangers between them."""
    share = np.linspace(0, 1, 25)
    ends = FORT_MIDDLE[0] + FORT_HALF_MM, KIOSK_MIDDLE[0] - KIOSK_RADIUS_MM + 0.6
    x = ends[0] + (ends[1] - ends[0]) * share
    z = DECK_MM + 0.6 - 4 * 3.0 * share * (1 - share)
    parts = []
    for y in (93.0, 101.0):
        low = np.stack([x, np.full(25, y), z], axis=1)
        high = low + 7.0 * UP
        parts += [tube(low, 0.35, 10), tube(high, 0.3, 10), rods(low[::2], high[::2], 0.2, 8)]
    planks = np.stack([x[1:-1], np.full(23, 97.0), z[1:-1]], axis=1)
    return [*parts, boxes(planks - point(0.4, 4.4, 0.3), planks + point(0.4, 4.4, 0.3))]


def _slides() -> list[Mesh]:
    """A waved trough from the fort and a spiral one from the kiosk, both 0.5 mm thin."""
    bend = np.linspace(-np.pi / 2, np.pi / 2, 17)
    run = np.linspace(0, 1, 90)[:, None]
    start = FORT_MIDDLE - (0, FORT_HALF_MM - 0.5)
    fall = DECK_MM + 0.6 - 16.4 * (run - np.sin(run * TURN * 2) / (TURN * 2) * 0.9)
    trough = [start[0] + 4.4 * np.sin(bend), start[1] - 48 * run, fall + 3.6 * (1 - np.cos(bend))]
    middle, turn = point(119.5, 116.5), np.linspace(-0.62 * TURN, 0.95 * TURN, 150)[:, None]
    drop = DECK_MM + 0.6 - 17.0 * (turn - turn[0]) / (turn[-1] - turn[0])
    spiral = polar(7.4 + 3.6 * np.sin(bend), turn, drop + 3.0 * (1 - np.cos(bend))) + middle
    return [
        sheet(np.stack(np.broadcast_arrays(*trough), axis=-1), 0.5),
        sheet(spiral, 0.5),
        posts(start - (0, 24.0), 0.6, ROOTED_MM, 12.6, 20),
        posts(middle, 1.3, ROOTED_MM, 24.0, 20),
        cones(middle + 23.8 * UP, middle + 26.0 * UP, 1.3, 20),
    ]


def _fort_ladder() -> list[Mesh]:
    """A steep ladder up to the fort: thick rails, rungs of 0.6 mm."""
    foot, head, wide = point(22.0, 93.0, ROOTED_MM), point(33.4, 93.0, DECK_MM + 6), point(0, 6.0)
    rungs = foot + np.linspace(0.1, 0.9, 11)[:, None] * (head - foot)
    return [rods([foot, foot + wide], [head, head + wide], 0.55, 14), rods(rungs, rungs + wide, 0.3, 10)]


def _fort_net() -> list[Mesh]:
    """A climbing net of 0.4 mm ropes in a slanted frame on the far side of the fort."""
    corner, across, up = point(35.0, 128.0, ROOTED_MM), point(22.0, 0), point(0, -18.4, DECK_MM - 0.2)

    def at(a: Floats, u: Floats) -> Floats:
        place: Floats = corner + a[:, None] * across + u[:, None] * up
        return place

    # Ropes at a slope of ±1 across the unit square, cut at its edges.
    shift = np.arange(-0.9, 1, 0.1)
    a0, a1 = np.maximum(shift, 0), np.minimum(1 + shift, 1)
    one_way = rods(at(a0, a0 - shift), at(a1, a1 - shift), 0.2, 8)
    other_way = rods(at(1 - a0, a0 - shift), at(1 - a1, a1 - shift), 0.2, 8)
    frame = at(np.array([0, 1, 1, 0, 0]), np.array([0, 0, 1, 1, 0]))
    return [one_way, other_way, _chain(frame, 0.6, 14), balls(frame[:-1], [0.8], 16)]


def _swings() -> list[Mesh]:
    """Three swings caught in mid-air on 0.4 mm chains under one beam."""
    beam = np.array([(9.0, 24.0, 33.0), (57.0, 24.0, 33.0)])
    spread = np.array([(0, -8.0, ROOTED_MM - 33), (0, 8.0, ROOTED_MM - 33)])
    legs = rods(beam[:, None] + spread, beam[:, None], 0.9, 16)
    parts = [_chain(beam, 0.9, 16), balls(beam, [1.2], 20), legs]
    for x, angle in ((16.0, 0.5), (30.0, -0.15), (44.0, -0.6)):
        down = 24.0 * point(0, np.sin(angle), -np.cos(angle))
        top = np.array([(x, 24.0, 33.0), (x + 6.0, 24.0, 33.0)])
        seat = top + down
        along = point(0, np.cos(angle), np.sin(angle))
        board = np.stack([seat - 1.8 * along, seat + 1.8 * along])
        parts += [rods(top, seat, 0.2, 8), sheet(board, 0.6)]
    return parts


def _dome() -> list[Mesh]:
    """A climbing dome: meridians, parallels and diagonals of 0.7 mm, knots where they meet."""
    tilt = np.radians([2.0, 24.0, 46.0, 68.0])
    turn = around(12) + TURN / 24 * np.arange(4)[:, None]
    middle = point(108.0, 40.0, GROUND_TOP_MM)
    knots = 19 * polar(np.cos(tilt)[:, None], turn, np.sin(tilt)[:, None]) + middle
    above, peak = knots[1:], middle + 19 * UP
    return [
        rods(knots, np.roll(knots, -1, axis=1), 0.35, 10),
        rods(knots[:-1], above, 0.35, 10),
        rods(knots[:-1], np.roll(above, 1, axis=1), 0.35, 10),
        rods(knots[-1], peak, 0.35, 10),
        balls(knots, [0.6], 12),
        balls(peak, [0.8], 12),
    ]


def _roundabout() -> list[Mesh]:
    """A turning disc with thin hoops to hold on to."""
    middle = point(73.0, 57.0)
    arch = np.linspace(0, np.pi, 30)
    reach, height = 4.8 - 3.6 * np.cos(arch), 4.0 + 6.0 * np.sin(arch)
    hoops = tube(polar(reach, around(6)[:, None], height), 0.3, 10)
    return [
        prism(polar(9.4, around(72)), 3.4, 4.4).moved(middle),
        hoops.moved(middle),
        posts(middle, 0.8, ROOTED_MM, 12.0, 16),
    ]


def _seesaw() -> list[Mesh]:
    """A plank on a trestle with a handle at each end."""
    ends = np.array([(64.0, 20.0, 4.4), (92.0, 14.0, 9.6)])
    across = point(0.21, 0.98)
    plank = np.stack([ends - 1.3 * across, ends + 1.3 * across], axis=1)
    middle = ends.mean(axis=0)
    feet = np.array([(-2.0, -2.4), (2.0, -2.4), (2.0, 2.4), (-2.0, 2.4)])
    grips = ends + np.outer([1, -1], point(2.6, -0.56, 0.5))
    tops = grips + 3.0 * UP
    return [
        sheet(plank, 0.8),
        rods(raised(middle[:2] + feet, ROOTED_MM), middle - 0.2 * UP, 0.5, 12),
        rods(grips, tops, 0.25, 8),
        rods(tops - 1.1 * across, tops + 1.1 * across, 0.25, 8),
    ]


def _spring_riders() -> list[Mesh]:
    """Three little horses on springs wound of 0.5 mm wire."""
    turn = np.linspace(0, 5 * TURN, 160)
    spring = tube(polar(1.5, turn, ROOTED_MM + 6.4 * turn / turn[-1]), 0.25, 8)
    body = balls((0, 0, 9.0), (2.9, 1.3, 1.7), 28)
    neck = tube(spline([(1.8, 0, 9.4), (3.0, 0, 11.4), (3.2, 0, 12.8)], 12), np.linspace(1.1, 0.7, 12), 14)
    head = balls((3.9, 0, 12.9), (1.5, 0.7, 0.8), 20)
    ears = cones([(3.0, -0.4, 13.3), (3.0, 0.4, 13.3)], [(2.8, -0.6, 14.8), (2.8, 0.6, 14.8)], 0.3, 8)
    grip = rods((2.6, -1.9, 11.4), (2.6, 1.9, 11.4), 0.25, 8)
    hair = spline([(-2.6, 0, 9.6), (-3.8, 0, 9.4), (-4.2, 0, 7.4)], 16)
    tail = tube(hair, np.linspace(0.45, 0.1, 16), 10, pointed=True)
    horse = join([spring, body, neck, head, ears, grip, tail])
    return [horse.moved([x, y, 0]) for x, y in ((14, 112), (15, 122), (14, 132))]


def _sandpit() -> list[Mesh]:
    """A low rim with a sand castle in it: a keep, four turrets, thin battlements."""
    low, high = np.array([8.0, 46.0]), np.array([30.0, 72.0])
    rim = fence(rounded(low, high, 3), rounded(low, high, 3, 0.6), ROOTED_MM, 5.0)
    middle = (low + high) / 2
    turrets = middle + 4.6 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    tops = raised(turrets, 9.0)
    merlons, half = polar(2.5, around(12), 11.4) + raised(middle, 0), point(0.3, 0.3, 0.8)
    return [
        rim,
        posts(middle, 2.9, ROOTED_MM, 11.0, 40),
        posts(turrets, 1.5, ROOTED_MM, 9.0, 20),
        cones(tops, tops + 3.6 * UP, 1.9, 20),
        boxes(merlons - half, merlons + half),
        bars(turrets, np.roll(turrets, -1, axis=0), 0.6, ROOTED_MM, 6.4),
    ]


def _tree() -> list[Mesh]:
    """A bare tree: each branch carries three thinner ones, from 3 mm at the trunk to 0.3 mm at the twigs."""
    starts, steps = np.array([[80.0, 122.0, ROOTED_MM]]), np.array([[0.4, 0.2, 12.0]])
    radius, parts = 1.5, []
    for level in range(6):
        ends = starts + steps
        taper = radius * np.array([1, 0.72])
        parts += [
            tube(np.stack([starts, ends], axis=1), taper, max(6, 18 - 3 * level)),
            balls(ends, taper[1:], max(6, 16 - 2 * level)),
        ]
        length = np.linalg.norm(steps, axis=1, keepdims=True) * 0.74
        forward = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        side = np.cross(forward, [0.6, 0.8, 0.1])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        other = np.cross(forward, side)
        turns = around(3, 1.1 * level)
        spread = np.cos(turns)[:, None, None] * side + np.sin(turns)[:, None, None] * other
        steps = ((0.84 * forward + 0.55 * spread) * length).reshape(-1, 3)
        starts, radius = np.tile(ends, (3, 1)), radius * 0.66
    return parts
