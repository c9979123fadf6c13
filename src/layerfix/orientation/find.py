"""The whole search as one call: `orient`, and what it found."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from layerfix.errors import InputError
from layerfix.orientation.aims import MORE_IS_BETTER, OF_SHAPE, Aims, Shape, aims_for, check_weights
from layerfix.orientation.anneal import COOLINGS, EVALUATIONS, Annealing, Cooling, anneal, direct
from layerfix.orientation.directions import AS_GIVEN, Pose, distinct, fibonacci, pose_of
from layerfix.orientation.executors import engine_for
from layerfix.orientation.objective import Counts, Objective, Printing
from layerfix.orientation.race import QUICK, RACE, angles_of, race
from layerfix.orientation.record import Record
from layerfix.orientation.search import Search, State
from layerfix.stack import pitch_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.layers.correction import Mode
    from layerfix.layers.skeleton import Spurs
    from layerfix.mesh.slicing import Fill
    from layerfix.mesh.triangles import Mesh

Method = Literal["race", "anneal", "direct", "quick"]
METHODS: tuple[Method, ...] = get_args(Method)
APART = math.radians(5.0)  # candidates that are listed differ by so much
LISTED = 10
FRONT_ROUNDS = 3
NEARLY = 0.02  # of the best: what is within is called as good


@dataclass(frozen=True)
class Candidate:
    """A pose and what it needs.

    theta_rad    (θ₁, θ₂), radians; psi_rad: turned on the plate after that
    direction    what points up, a unit vector in the part as it is given
    value        the weighted sum that was minimised; 1 for the part as it is given, if only correction counts
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
        poses = [pose for pose, counts in self.seen.items() if counts.layers]
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
    counted = [pose for pose, counts in seen.items() if counts.layers and (counts.whole or estimated)]
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
        "value": one.value,
        "theta_rad": list(one.theta_rad),
        "psi_rad": one.psi_rad,
        "direction": list(one.direction),
        "height_mm": one.height_mm,
        "layers": one.layers,
        **{f"{name}_{'mm' if name == 'height' else unit}": one.terms[name] for name, unit in _UNITS.items()},
    }


_UNITS = {"support": "mm3", "overhang": "mm2", "staircase": "mm3", "contact": "mm2"}


@dataclass(frozen=True)
class Options:
    """How to search: see `orient`."""

    method: Method = "race"
    weights: Mapping[str, float] = field(default_factory=dict)
    cooling: Cooling = "exponential"
    evaluations: int | None = None
    seed: int = 0
    room_mm: tuple[float, float, float] | None = None
    front: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Raises InputError for what cannot be used."""
        check_weights(self.weights)
        if self.method not in METHODS:
            raise InputError(f"method='{self.method}' is not known; choose from {', '.join(METHODS)}")
        if self.cooling not in COOLINGS:
            raise InputError(f"cooling='{self.cooling}' is not known; choose from {', '.join(COOLINGS)}")
        if self.evaluations is not None:
            if self.method not in ("anneal", "direct"):
                raise InputError(f"evaluations: the method {self.method} takes as many as it needs")
            if self.evaluations < 2:
                raise InputError(f"evaluations {self.evaluations}: at least 2")
        for name in self.front or ():
            if name not in OF_SHAPE:
                raise InputError(f"'{name}' is no aim of a front; choose from {', '.join(OF_SHAPE)}")
        if self.room_mm is not None and not all(0 < side < math.inf for side in self.room_mm):
            raise InputError(f"room of {self.room_mm} mm: all three must be above 0")


def orient(
    mesh: Mesh,
    *,
    pixel_mm: float | tuple[float, float],
    layer_mm: float,
    min_feature_mm: float,
    first_layer_mm: float | None = None,
    mode: Mode = "as_printed",
    spurs: Spurs = "metric",
    fill: Fill = "nonzero",
    method: Method = "race",
    weights: Mapping[str, float] | None = None,
    cooling: Cooling = "exponential",
    evaluations: int | None = None,
    seed: int = 0,
    room_mm: tuple[float, float, float] | None = None,
    front: Sequence[str] | None = None,
    executor: object = None,
    workers: int = 0,
    log: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[State], None] | None = None,
) -> Orientation:
    """The build direction in which a part needs the least correction (paper, section 5).

    pixel_mm … fill  how it would be sliced and corrected, as `slice_mesh` and `correct` take it
    method       "race": many directions on some layers, the best in full; "quick": fewer; "anneal": the paper's
                 simulated annealing; "direct": SciPy's DIRECT
    weights      of what is minimised: added, removed (1 each unless given), support, overhang, height, staircase,
                 contact; each is divided by what it is for the part as it is given (`layerfix.orientation.aims`)
    cooling      of "anneal": "exponential", "linear", "logarithmic"; evaluations: 300 unless given, for "direct", too
    room_mm      only poses of at most that size (x, y, z); x and y may be swapped
    front        other aims to look for a good trade with: what may be on that front is counted in full, too; (): the
                 aims with weights, else support and height. See `Orientation.front`
    executor     None: threads here (`workers` of them, 0: one per core); a number: so many processes; an executor
                 with submit(); a distributed.Client, or the address of a scheduler ("tcp://host:8786")
    log, resume  every evaluation is a line of this file; with resume it goes on from there, to the same end
    progress     told of a `State` after every evaluation
    returns      an `Orientation`. The same for any number of workers, and for the same seed. After Ctrl-C the best so
                 far, if anything was counted (`interrupted`)
    raises       InputError for a flat part, unusable numbers, weights that are all 0, one that fits in no direction
    """
    printing = Printing(pitch_mm(pixel_mm), layer_mm, min_feature_mm, first_layer_mm, mode, spurs, fill)
    options = Options(method, weights or {}, cooling, evaluations, seed, room_mm,
                      None if front is None else tuple(front))  # fmt: skip
    return find(Objective(mesh, printing), options, executor, workers, log, resume, progress)


def find(
    objective: Objective,
    options: Options,
    executor: object = None,
    workers: int = 0,
    log: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[State], None] | None = None,
) -> Orientation:
    """`orient` of an objective that is there."""
    fits = _fitting(objective, options.room_mm)
    engine = engine_for(executor, objective, workers)
    record = None
    try:
        record = Record(Path(log), objective.token, resume=resume) if log is not None else None
        search = Search(objective, engine, record, progress or (lambda state: None), fits)
        initial = search.counts([AS_GIVEN])[0]
        shape = Shape(objective.mesh, objective.printing.layer_mm)
        search.aims = aims_for(shape, check_weights(options.weights), initial)
        interrupted, pose = False, AS_GIVEN
        try:
            pose = _by_method(search, options)
            if options.front is not None:
                _widen_front(search, chosen_aims(search.aims, options.front))
        except KeyboardInterrupt:
            interrupted = True
        return _outcome(search, options, pose, interrupted)
    finally:
        engine.close()
        if record is not None:
            record.close()


def _by_method(search: Search, options: Options) -> Pose:
    if options.method == "anneal":
        how = Annealing(options.cooling, options.evaluations or EVALUATIONS, options.seed)
        return anneal(search, how)
    if options.method == "direct":
        return direct(search, options.evaluations or EVALUATIONS)
    return race(search, QUICK if options.method == "quick" else RACE)


def _widen_front(search: Search, names: Sequence[str]) -> None:
    """Count in full what is on the front by its estimate, until all of it is, or FRONT_ROUNDS are over."""
    assert search.aims is not None
    search.begin("front")
    for _ in range(FRONT_ROUNDS):
        found = front_of(search.aims, search.objective, search.seen, names, estimated=True)
        left = [pose for pose in dict.fromkeys(pose for _, pose in found) if not search.seen[pose].whole]
        if not left:
            return
        search.counts(left)


def _outcome(search: Search, options: Options, pose: Pose, interrupted: bool) -> Orientation:
    aims = search.aims
    assert aims is not None
    whole = search.whole()
    if not whole:
        raise InputError(
            f"{search.objective.mesh.name}: no pose that fits, and is as high as a layer, was counted in full"
        )
    if interrupted:
        pose = whole[0]
    if aims.of_shape and aims.value(pose.flipped(), search.seen[pose]) < aims.value(pose, search.seen[pose]):
        search.seen[pose.flipped()] = search.seen[pose]  # it was found for its opposite
        pose = pose.flipped()
    given = aims.value(AS_GIVEN, search.seen[AS_GIVEN])
    fits = search.fits(AS_GIVEN)
    if fits and given <= aims.value(pose, search.seen[pose]):
        pose = AS_GIVEN
    best = _candidate(search, pose)
    listed = [pose, *whole]
    kept = distinct([one.direction for one in listed], APART)[:LISTED]
    candidates = [_candidate(search, listed[k]) for k in kept]
    initial = _candidate(search, AS_GIVEN)
    return Orientation(
        search.objective,
        options.method,
        initial,
        best,
        tuple(candidates),
        aims,
        len(whole),
        len(search.order),
        search.equivalents,
        time.perf_counter() - search.started,
        search.computed_s,
        interrupted,
        search.engine.name,
        {pose: search.seen[pose] for pose in search.order},
        _notes(search, initial, best, interrupted),
    )


def _candidate(search: Search, pose: Pose) -> Candidate:
    assert search.aims is not None
    turned = [search.seen[p] for p in angles_of(search, pose, 4) if p in search.seen and search.seen[p].whole]
    mean_px = sum(c.added + c.removed for c in turned) / len(turned) if len(turned) > 1 else None
    return candidate_of(search.aims, search.objective, pose, search.seen[pose], mean_px)


def _notes(search: Search, initial: Candidate, best: Candidate, interrupted: bool) -> tuple[str, ...]:
    notes = list(search.objective.mesh.notes)
    if interrupted:
        notes.append("broken off: this is the best so far; with --log and --resume it goes on from there")
    if not initial.changed_px:
        notes.append("the part needs no correction as it stands")
    elif best.pose == AS_GIVEN:
        notes.append("the part stands best as it is given: nothing better was found")
    elif initial.value > 0 and initial.value <= best.value * (1 + NEARLY):
        percent = 100 * (initial.value / best.value - 1)
        notes.append(f"as it is given, the part is already within {percent:.2g} % of the best found")
    return tuple(notes)


def _fitting(objective: Objective, room_mm: tuple[float, float, float] | None) -> Callable[[Pose], bool]:
    """Whether a pose fits. Raises InputError if none does."""
    if room_mm is None:
        return lambda pose: True
    room = np.sort(room_mm[:2])

    def fits(pose: Pose) -> bool:
        x, y, z = objective.size_mm(pose)
        small, large = min(x, y), max(x, y)
        return small <= room[0] * (1 + 1e-9) and large <= room[1] * (1 + 1e-9) and z <= room_mm[2] * (1 + 1e-9)

    if not any(fits(pose_of(d).turned(k * math.pi / 16)) for d in [*np.eye(3), *fibonacci(500)] for k in range(8)):
        size = " × ".join(f"{side:.4g}" for side in objective.mesh.size_mm)
        raise InputError(
            f"{objective.mesh.name}: the part, {size} mm as it is given, fits"
            f" {' × '.join(f'{side:.4g}' for side in room_mm)} mm in no direction"
        )
    return fits


__all__ = ["MORE_IS_BETTER", "OF_SHAPE", "Candidate", "Orientation", "orient"]
