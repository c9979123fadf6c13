"""What a search found: the poses, their figures, and which of them no other beats in every aim."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from layerfix.orientation.aims import MORE_IS_BETTER, Aims
from layerfix.orientation.directions import Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh
    from layerfix.orientation.objective import Counts, Objective


@dataclass(frozen=True)
class Candidate:
    """A pose and what it needs.

    theta_rad    (θ₁, θ₂), radians; psi_rad: turned on the plate after that
    direction    what points up, a unit vector in the part as it is given
    value        the weighted sum that was minimised; 1 for the part as it is given, if only correction counts;
                 infinite where nothing of the part would be printed
    added_px, removed_px, added_mm3, removed_mm3  what correction changes
    height_mm, layers  of the part in this pose
    terms        the other aims (`layerfix.orientation.aims`), each in its unit
    mean_px      added and removed pixels, the mean over in-plane angles; None where only one was counted
    """

    theta_rad: tuple[float, float]
    psi_rad: float
    direction: tuple[float, float, float]
    value: float
    added_px: int
    removed_px: int
    added_mm3: float
    removed_mm3: float
    height_mm: float
    layers: int
    terms: Mapping[str, float]
    mean_px: float | None = None

    @property
    def pose(self) -> Pose:
        """The angles as one."""
        return Pose(*self.theta_rad, self.psi_rad)

    @property
    def changed_px(self) -> int:
        """C: added and removed pixels."""
        return self.added_px + self.removed_px

    @property
    def printed(self) -> bool:
        """Whether anything of the part is in the layers of this pose."""
        return self.value < math.inf

    @property
    def changed_mm3(self) -> float:
        """C as a volume."""
        return self.added_mm3 + self.removed_mm3


@dataclass(frozen=True, eq=False)
class Orientation:
    """What a search found.

    objective    C of the part, for whoever wants to ask for more
    initial      the part as it is given; best: the pose found, which may be that
    candidates   the ten best distinct directions: `best`, then by value
    aims         what was minimised
    evaluations  poses counted in full; screened: poses looked at; equivalents: layers counted, in full poses
    seconds      of the search; computed_s: of all workers together
    interrupted  it was broken off, and this is the best so far
    seen         all that was counted, by pose
    """

    objective: Objective
    method: str
    initial: Candidate
    best: Candidate
    candidates: tuple[Candidate, ...]
    aims: Aims
    evaluations: int
    screened: int
    equivalents: float
    seconds: float
    computed_s: float
    interrupted: bool
    engine: str
    seen: Mapping[Pose, Counts]
    notes: tuple[str, ...] = ()

    @property
    def theta_rad(self) -> tuple[float, float]:
        """(θ₁, θ₂) of the best."""
        return self.best.theta_rad

    @property
    def reduction_percent(self) -> float:
        """How much less correction the best needs than the part as it is given; by pixels, as the paper counts."""
        before = self.initial.changed_px
        return 100 * (1 - self.best.changed_px / before) if before else 0.0

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4): takes the part as it is given to the best pose on the plate."""
        return self.objective.placement(self.best.pose)

    def mesh(self) -> Mesh:
        """The part in the best pose, its lowest point at z = 0."""
        return self.objective.placed(self.best.pose)

    def landscape(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """((n, 3) directions, (n,) values) of all poses that were looked at, estimated where not all layers were.

        Values are pixels of correction, or the weighted sum if other aims count; then opposite directions differ, and
        both are there.
        """
        poses = [pose for pose, counts in self.seen.items() if not counts.empty]
        if self.aims.of_shape:
            both = [(p, self.seen[pose]) for pose in poses for p in (pose, pose.flipped())]
            values = [self.aims.value(pose, counts) for pose, counts in both]
            return np.array([pose.direction for pose, _ in both]), np.array(values)
        found = [self.seen[pose].estimate() for pose in poses]
        values = [counts.added + counts.removed for counts in found]
        return np.array([pose.direction for pose in poses]), np.array(values, np.float64)

    def front(self, names: Sequence[str] = ()) -> list[Candidate]:
        """The poses counted in full of which no other is better in every aim: in correction, and in `names` (of
        OF_SHAPE; without any, those that have a weight, else support and height)."""
        return [one for one, _ in front_of(self.aims, self.objective, self.seen, chosen_aims(self.aims, names))]

    def summary(self) -> dict[str, Any]:
        """What `layerfix orient --json` prints."""
        return {
            "method": self.method,
            "initial": written(self.initial),
            "best": written(self.best),
            "reduction_percent": self.reduction_percent,
            "theta_rad": list(self.theta_rad),
            "psi_rad": self.best.psi_rad,
            "matrix": self.matrix.tolist(),
            "evaluations": self.evaluations,
            "screened": self.screened,
            "equivalents": self.equivalents,
            "seconds": self.seconds,
            "computed_s": self.computed_s,
            "workers": self.engine,
            "interrupted": self.interrupted,
            "weights": {name: weight for name, weight in self.aims.weights.items() if weight > 0},
            "candidates": [written(one) for one in self.candidates],
            "notes": list(self.notes),
        }


def chosen_aims(aims: Aims, names: Sequence[str]) -> tuple[str, ...]:
    """Aims besides correction that a front is of."""
    return tuple(names) or aims.of_shape or ("support", "height")


def front_of(
    aims: Aims, objective: Objective, seen: Mapping[Pose, Counts], names: Sequence[str], estimated: bool = False
) -> list[tuple[Candidate, Pose]]:
    """The non-dominated candidates, least correction first, each with the pose that was counted (itself or its
    opposite); with those that are only estimated, if told so."""
    counted = [pose for pose, counts in seen.items() if not counts.empty and (counts.whole or estimated)]
    found = [
        (candidate_of(aims, objective, turned, seen[pose]), pose)
        for pose in counted
        for turned in (pose, pose.flipped())
    ]
    signs = np.array([1.0] + [-1.0 if name in MORE_IS_BETTER else 1.0 for name in names])
    scores = np.array([[one.changed_px, *(one.terms[name] for name in names)] for one, _ in found]) * signs
    return sorted((found[k] for k in non_dominated(scores)), key=lambda one: one[0].changed_px)


def non_dominated(scores: NDArray[np.float64]) -> list[int]:
    """Rows of (n, aims) scores, less being better, of which no other is as good in all and better in one.

    Of equal rows the first is kept.
    """
    order = np.lexsort(scores.T[::-1])
    kept: list[int] = []
    for k in order.tolist():
        if not kept or not (scores[kept] <= scores[k]).all(axis=1).any():
            kept.append(k)
    return kept


def candidate_of(
    aims: Aims, objective: Objective, pose: Pose, counts: Counts, mean_px: float | None = None
) -> Candidate:
    """What was counted of a pose, with all its figures."""
    counts = counts.estimate()
    _, added_mm3, removed_mm3 = objective.volumes_mm3(counts)
    x, y, z = pose.direction.tolist()
    return Candidate((pose.theta1, pose.theta2), pose.psi, (x, y, z), aims.value(pose, counts), counts.added,
                     counts.removed, added_mm3, removed_mm3, counts.height_mm, counts.layers,
                     aims.shape.terms(pose), mean_px)  # fmt: skip


def written(one: Candidate) -> dict[str, Any]:
    """A candidate for JSON."""
    return {
        "changed_px": one.changed_px,
        "changed_mm3": one.changed_mm3,
        "added_px": one.added_px,
        "removed_px": one.removed_px,
        "added_mm3": one.added_mm3,
        "removed_mm3": one.removed_mm3,
        "mean_px": one.mean_px,
        "value": one.value if one.printed else None,
        "theta_rad": list(one.theta_rad),
        "psi_rad": one.psi_rad,
        "direction": list(one.direction),
        "height_mm": one.height_mm,
        "layers": one.layers,
        **{f"{name}_{'mm' if name == 'height' else unit}": one.terms[name] for name, unit in _UNITS.items()},
    }


_UNITS = {"support": "mm3", "overhang": "mm2", "staircase": "mm3", "contact": "mm2"}
