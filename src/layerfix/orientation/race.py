"""The default method: many directions looked at a little, the better ones closely, the best in full.

Layers are left out, never pixels: on every second or fourth pixel the best direction of four parts came out up to 9 %
too bad, for the raster then changes what is too thin. Even directions, and those that the part's shape suggests, are
looked at; the better ones closely, in all layers or CLOSE of more; from the best a compass walks on to the bottom of
their valleys.

How the part lies on the plate (ψ) moves C by up to half, mostly by luck with the pixels. So directions are compared
by the mean over a few angles. For those within TIE of the best mean, which count as equal, the best angle is looked
for, the right way up; and of what then is within TIE of the lowest C, the lowest to build wins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from layerfix.orientation.candidates import structured
from layerfix.orientation.directions import (
    AS_GIVEN,
    QUARTER_TURN,
    Pose,
    beside,
    distinct,
    fibonacci,
    pose_of,
    spacing,
)
from layerfix.orientation.objective import CLOSE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from layerfix.orientation.search import Search

GLANCE = CLOSE // 2  # layers on which directions beside each other, and angles, are looked at first
TIE = 0.02  # of the best mean: differences below are the raster's


@dataclass(frozen=True)
class Plan:
    """How many directions are looked at, and how closely (docs/orient.md has the measurements).

    given       faces and axes that are looked at closely, of some twenty
    directions  of the half-sphere, looked at on `layers` layers
    rungs       (share of the directions kept, times as many layers) each
    finished    how many of them are looked at closely
    compass     from how many of the best a compass walks, from `widest` to `narrowest` degrees, in `steps` steps
    finalists   how many distinct directions are compared over `angles` in-plane angles
    swept       for how many of those that tie the best in-plane angle is looked for, among `sweep` angles
    """

    given: int = 8
    directions: int = 1000
    layers: int = 16
    rungs: tuple[tuple[float, int], ...] = ((0.5, 2), (0.25, 4), (0.08, 8))
    finished: int = 20
    compass: int = 3
    widest: float = 2.3
    narrowest: float = 0.25
    steps: int = 30
    finalists: int = 8
    angles: int = 4
    swept: int = 3
    sweep: int = 16

    @property
    def expected(self) -> float:
        """Full evaluations it may come to, of a part of 500 layers, fewer of a taller one."""
        screening = self.directions * self.layers * (1 + sum(s * (t - 1) for s, t in self.rungs)) / 500
        walks = self.compass * 4 * 5
        return (
            20 + screening + self.finished + walks + self.finalists * (self.angles - 1) + self.sweep * self.swept / 2
        )


RACE = Plan()
QUICK = Plan(directions=400, finished=10, compass=1, finalists=4, swept=1, sweep=8)


def race(search: Search, plan: Plan) -> Pose:
    """The best pose by `plan`: its direction by the mean over in-plane angles, its angle by C itself."""
    search.begin("faces and axes", plan.expected)
    given = [AS_GIVEN, *(pose_of(d) for d in structured(search.objective.mesh))]
    given = [given[k] for k in distinct([pose.direction for pose in given], math.radians(0.1))]
    poses = _fitting(search, given)
    values = search.values(poses, GLANCE)
    search.counts([poses[k] for k in np.argsort(values, kind="stable")[: plan.given]], CLOSE)
    _settle(search)
    _screen(search, plan)
    _settle(search)
    _walk(search, plan)
    _settle(search)
    return _final(search, plan, poses)


def _fitting(search: Search, poses: Sequence[Pose]) -> list[Pose]:
    """Those that fit the plate, each at the first in-plane angle at which it does."""
    found = []
    for pose in poses:
        angles = (pose.turned(pose.psi + k * QUARTER_TURN / 8) for k in range(8))
        fit = next((turned for turned in angles if search.fits(turned)), None)
        if fit is not None:
            found.append(fit)
    return found


def _settle(search: Search) -> None:
    """The best so far in full: a search may be broken off."""
    search.counts(search.close()[:1])


def _screen(search: Search, plan: Plan) -> None:
    """Look at even directions on ever more layers, ever fewer of them."""
    poses = _fitting(search, [pose_of(d) for d in fibonacci(plan.directions)])
    search.begin("screening")
    values = search.values(poses, plan.layers)
    for share, times in plan.rungs:
        keep = max(math.ceil(share * plan.directions), plan.finished)
        poses = [poses[k] for k in np.argsort(values, kind="stable")[:keep]]
        values = search.values(poses, plan.layers * times)
    poses = [poses[k] for k in np.argsort(values, kind="stable")[: plan.finished]]
    search.begin("the best closely")
    search.counts(poses, CLOSE)


def _walk(search: Search, plan: Plan) -> None:
    """From each of the best, all at once: to the best of four directions beside it, or half as far."""
    search.begin("compass")
    best = search.close()
    apart = 1.5 * spacing(plan.directions)
    starts = [best[k] for k in distinct([pose.direction for pose in best], apart)[: plan.compass]]
    walks = [(pose, math.radians(plan.widest)) for pose in starts]
    for _ in range(plan.steps):
        walks = [(pose, step) for pose, step in walks if step >= math.radians(plan.narrowest)]
        if not walks:
            return
        around = [_fitting(search, [pose_of(d) for d in beside(pose.direction, step)]) for pose, step in walks]
        search.counts([pose for poses in around for pose in poses], GLANCE)
        lowest_of = [min(around[k], key=search.value, default=pose) for k, (pose, _) in enumerate(walks)]
        search.counts(lowest_of, CLOSE)
        for k, (pose, step) in enumerate(walks):
            lowest = lowest_of[k]
            walks[k] = (lowest, step) if search.value(lowest) < search.value(pose) else (pose, step / 2)


def angles_of(search: Search, pose: Pose, count: int) -> list[Pose]:
    """The pose at even in-plane angles that fit, from its own on. A quarter turn later the raster is the same."""
    angles = [pose, *(pose.turned(pose.psi + k * QUARTER_TURN / count) for k in range(1, count))]
    return [turned for turned in angles if search.fits(turned)]


def mean_value(search: Search, pose: Pose, count: int) -> float:
    """Of a direction, over in-plane angles."""
    return float(np.mean(search.values(angles_of(search, pose, count), CLOSE)))


def _final(search: Search, plan: Plan, given: Sequence[Pose]) -> Pose:
    """The best direction and angle. Beside one that a walk came to stands the face or axis it is near, if there is
    one: the walk went by C at one angle, where a slanted thread may be luckier than an upright one."""
    search.begin("in-plane angles")
    best, apart = search.close(), spacing(plan.directions)
    finalists = [best[k] for k in distinct([p.direction for p in best], apart)[: plan.finalists]]
    finalists += [
        pose
        for pose in given
        if pose not in finalists and any(abs(pose.direction @ one.direction) > math.cos(apart) for one in finalists)
    ]
    search.counts([turned for pose in finalists for turned in angles_of(search, pose, plan.angles)], CLOSE)
    means = {pose: mean_value(search, pose, plan.angles) for pose in finalists}
    order = sorted(finalists, key=lambda pose: means[pose])
    tied = [pose for pose in order if _ties(means[pose], means[order[0]])][: plan.swept]
    search.begin("best in-plane angles")
    upright = search.aims.upright if search.aims is not None else (lambda pose, counts: pose)
    # The right way up, unless that is not as good: where there is little to correct, the two ways differ.
    ways = {pose: pose if pose == AS_GIVEN else upright(pose, search.seen[pose]) for pose in tied}
    search.counts([turned for pose in ways.values() for turned in angles_of(search, pose, plan.angles)], CLOSE)
    means = {pose: mean_value(search, pose, plan.angles) for pose in (*ways, *ways.values())}
    tied = [other if _ties(means[other], means[pose]) else pose for pose, other in ways.items()]
    search.counts([turned for pose in tied for turned in angles_of(search, pose, plan.sweep)], GLANCE)
    swept = [min(angles_of(search, pose, plan.sweep), key=search.value) for pose in tied]
    lowest = min(search.values(swept))
    return min(
        (pose for pose in swept if _ties(search.value(pose), lowest)),
        key=lambda pose: round(search.seen[pose].height_mm, 6),
    )


def _ties(value: float, lowest: float) -> bool:
    return value <= lowest + TIE * abs(lowest)
