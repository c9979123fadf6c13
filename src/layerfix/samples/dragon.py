"""The dragon of `layerfix.samples`: a slender part whose wings, horns and claws taper below any nozzle."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from layerfix.samples.shapes import UP, balls, cones, join, mirrored, point, sheet, spline, tube

if TYPE_CHECKING:
    from layerfix.mesh.triangles import Mesh
    from layerfix.samples.shapes import Floats

# Control points x, y, z and radius in mm. The dragon rears up and looks towards -y; x is left to right.
TORSO = np.array(
    [
        (0, 4.4, 12.0, 2.6),
        (0, 3.4, 16.0, 4.0),
        (0, 1.2, 21.5, 4.5),
        (0, 0.0, 28.0, 4.5),
        (0, 0.6, 34.0, 4.1),
        (0, 2.4, 39.5, 3.0),
        (0, 3.6, 45.0, 2.1),
        (0, 3.0, 50.5, 1.7),
        (0, 0.4, 55.4, 1.7),
        (0, -3.4, 58.2, 2.0),
    ]
)
TAIL = np.array(
    [
        (0, 3.0, 16.0, 3.4),
        (-0.4, 7.0, 9.5, 2.9),
        (-1.6, 10.0, 4.4, 2.2),
        (1.0, 11.5, 1.9, 1.7),
        (5.4, 10.6, 1.2, 1.2),
        (9.6, 7.0, 0.9, 0.85),
        (11.4, 1.6, 0.7, 0.6),
        (9.8, -3.4, 0.6, 0.4),
        (7.6, -6.6, 1.6, 0.2),
    ]
)
LEG = np.array(
    [
        (3.0, 3.0, 18.0, 3.2),
        (5.0, 0.2, 14.0, 3.3),
        (6.0, -0.4, 9.6, 2.2),
        (5.8, 2.6, 5.4, 1.3),
        (5.9, 1.2, 1.9, 1.1),
        (6.2, -2.4, 0.9, 0.9),
    ]
)
ARM = np.array(
    [
        (3.4, -0.6, 34.6, 1.9),
        (5.6, -1.4, 31.4, 1.6),
        (6.2, -3.2, 27.4, 1.2),
        (5.4, -6.0, 27.6, 0.9),
        (4.8, -7.6, 29.0, 0.7),
    ]
)
HORN = np.array(
    [
        (1.0, -3.2, 60.2, 0.75),
        (1.9, -0.8, 62.6, 0.6),
        (2.3, 1.6, 65.4, 0.4),
        (1.8, 2.2, 67.6, 0.2),
    ]
)
SHOULDER, ELBOW, WRIST = np.array([(2.4, 3.4, 37.6), (8.2, 6.2, 43.4), (8.6, 5.0, 56.0)])
FINGERS = np.array(
    [
        [(10.6, 6.0, 61.8), (10.4, 6.6, 68.4)],
        [(12.0, 7.6, 58.6), (13.0, 8.6, 61.0)],
        [(11.8, 8.8, 51.6), (12.9, 10.6, 48.6)],
        [(9.8, 9.6, 46.4), (9.9, 11.6, 37.6)],
    ]
)


def dragon() -> Mesh:
    """26.4 × 23.3 × 68.7 mm: a rearing dragon, wings raised, their membranes 0.25 mm thin."""
    side = join([_leg(), _arm(), *_wing(), *_head_side()])
    return join(
        [
            _limb(TORSO, 160, 40),
            _belly(),
            _limb(TAIL, 220, 28, pointed=True),
            *_back_spikes(),
            *_head(),
            side,
            mirrored(side),
        ]
    )


def _limb(points: Floats, steps: int, sides: int, *, pointed: bool = False) -> Mesh:
    """A round-ended tube through control points x, y, z, radius."""
    curve = spline(points, steps)
    radius = curve[:, 3]
    ends = curve[[0, -1], :3][: 1 if pointed else 2]
    caps = balls(ends, radius[[0, -1]][: len(ends), None], sides)
    return join([tube(curve[:, :3], radius, sides, pointed=pointed), caps])


def _spine(steps: int) -> tuple[Floats, Floats]:
    """(steps, 4) points and radii down the torso, and (steps, 3) unit vectors out of its back."""
    spine = spline(TORSO, steps)
    along = np.gradient(spine[:, :3], axis=0)
    back = np.stack([along[:, 0], along[:, 2], -along[:, 1]], axis=1)
    return spine, back / np.linalg.norm(back, axis=1, keepdims=True)


def _belly() -> Mesh:
    """Overlapping plates on the front: a second, ribbed tube that lies a little before the torso."""
    spine, back = _spine(320)
    ribs = 0.86 + 0.05 * (np.arange(320) % 16) / 16
    return tube(spine[:, :3] - 0.24 * back * spine[:, 3:], spine[:, 3] * ribs, 36)


def _leg() -> Mesh:
    """A hind leg, its foot flat on the ground with three claws and a spur."""
    root = np.array([(5.2, -2.6, 0.9), (6.2, -3.0, 0.9), (7.2, -2.6, 0.9), (5.9, 2.4, 1.0)])
    tips = np.array([(4.6, -6.0, 0.15), (6.3, -6.8, 0.15), (8.0, -6.0, 0.15), (5.9, 4.8, 0.3)])
    foot = balls((6.1, -0.8, 0.9), (1.5, 2.8, 0.9), 28)
    return join([_limb(LEG, 64, 24), foot, cones(root, tips, 0.55, 14)])


def _arm() -> Mesh:
    """A fore leg held up, four thin claws spread."""
    hand = ARM[-1, :3]
    tips = hand + np.array([(-1.6, -1.8, 0.9), (-0.5, -2.4, 0.3), (0.6, -2.3, -0.3), (1.3, -1.4, -1.2)])
    return join([_limb(ARM, 56, 20), balls(hand, [0.85], 20), cones(hand, tips, 0.32, 12)])


def _head() -> list[Mesh]:
    """Skull, snout and an open lower jaw with a forked tongue."""
    nose = [(0, -4.0, 58.6, 1.9), (0, -6.6, 58.4, 1.35), (0, -8.6, 57.7, 1.0), (0, -9.6, 57.3, 0.6)]
    chin = [(0, -4.0, 57.4, 1.4), (0, -6.2, 55.9, 0.9), (0, -8.8, 54.6, 0.45)]
    snout, jaw = spline(nose, 40), spline(chin, 32)
    tongue = spline([(0, -5.0, 57.0), (0, -7.6, 56.4), (0, -9.0, 56.3)], 24)
    tips = np.array([(-0.5, -10.0, 56.7), (0.5, -10.0, 56.7)])
    bones = [tube(bone[:, :3], bone[:, 3], 28, squash=0.8) for bone in (snout, jaw)]
    return [
        balls((0, -4.0, 58.8), (1.9, 2.3, 1.8), 36),
        *bones,
        balls(snout[-1, :3], [0.6], 20),
        tube(tongue, 0.2, 10),
        cones(tongue[-1], tips, 0.16, 8),
    ]


def _head_side() -> list[Mesh]:
    """One horn, eye and brow, three teeth, and three spikes behind the cheek."""
    gums = np.array([(0.75, -7.4, 57.5), (0.7, -8.3, 57.2), (0.5, -9.2, 56.9)])
    cheek = np.array([(1.4, -3.2, 58.6), (1.4, -2.8, 57.8), (1.2, -2.6, 57.0)])
    out = cheek + np.array([(1.5, 2.4, 1.0), (1.7, 2.2, 0.0), (1.3, 1.8, -0.9)])
    brow = cones((1.2, -6.2, 59.7), (1.9, -3.6, 60.6), 0.4, 12)
    return [
        _limb(HORN, 48, 16, pointed=True),
        balls((1.35, -5.5, 59.4), [0.5], 20),
        brow,
        cones(cheek, out, 0.35, 10),
        cones(gums, gums - 0.9 * UP, 0.18, 8),
    ]


def _back_spikes() -> list[Mesh]:
    """Thin plates down the neck and back, and smaller spikes along the tail."""
    spine, back = (values[80:-30:12] for values in _spine(400))
    root, reach = spine[:, :3] + back * spine[:, 3:] * 0.8, 1.1 + 0.35 * spine[:, 3:]
    plates = np.stack([root, root + back * reach + 0.5 * UP], axis=1)
    tail = spline(TAIL, 400)[60:-40:14]
    tips = tail[:, :3] + (tail[:, 3:] + 0.9) * UP
    return [tube(plates, 0.75, 14, pointed=True, squash=0.25), cones(tail[:, :3], tips, 0.3, 10)]


def _wing() -> list[Mesh]:
    """Arm, four finger bones, and the membrane between them down to the flank."""
    arm = spline(np.column_stack([[SHOULDER, ELBOW, WRIST], [1.2, 0.75, 0.5]]), 60)
    fingers = [spline(np.vstack([WRIST, finger]), 48) for finger in FINGERS]
    flank = spline([WRIST, ELBOW + point(0, 0.2), point(4.0, 5.4, 38.0), point(3.4, 3.8, 30.0)], 48)
    thin = np.linspace(0.36, 0.1, 48)
    bones = [tube(finger, thin, 14, pointed=True) for finger in fingers]
    edges = [*fingers, flank]
    skins = [_membrane(a, b) for a, b in pairwise(edges)]
    thumb = cones(WRIST, WRIST + point(0.4, -2.6, 1.4), 0.4, 12)
    # A bare tip would vanish between the pixels, and the topmost layer with it.
    knobs = balls(FINGERS[:, 1], [0.16], 12)
    return [tube(arm[:, :3], arm[:, 3], 20), thumb, knobs, *bones, *skins]


def _membrane(first: Floats, second: Floats) -> Mesh:
    """Skin of 0.25 mm between two (k, 3) bones from one wrist; it bellies out and its edge hangs in."""
    share = np.linspace(0, 1, len(first))
    across = np.linspace(0, 1, 20)
    # The skin starts a little off the wrist, where its two edges would meet in triangles without area.
    along = np.linspace(0.06, 1, 44)[:, None] * (1 - 0.2 * np.sin(np.pi * across))
    a, b = (np.stack([np.interp(along, share, axis) for axis in bone.T], axis=-1) for bone in (first, second))
    belly = 0.9 * np.sin(np.pi * across) * along
    skin = a + (b - a) * across[:, None] + belly[..., None] * [0.0, 1.0, 0.0]
    return sheet(skin, 0.25)
