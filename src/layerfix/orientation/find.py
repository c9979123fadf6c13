"""The whole search as one call: `orient`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from layerfix.errors import InputError
from layerfix.orientation.aims import OF_SHAPE, Shape, aims_for, check_weights
from layerfix.orientation.anneal import COOLINGS, EVALUATIONS, Annealing, Cooling, anneal, direct
from layerfix.orientation.directions import AS_GIVEN, Pose, distinct, fibonacci, pose_of
from layerfix.orientation.executors import engine_for
from layerfix.orientation.objective import Objective, Printing
from layerfix.orientation.outcome import Candidate, Orientation, candidate_of, chosen_aims, front_of
from layerfix.orientation.race import QUICK, RACE, race
from layerfix.orientation.record import Record
from layerfix.orientation.search import Search, State
from layerfix.stack import pitch_mm

if TYPE_CHECKING:
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
            _count_listed(search)
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


def _count_listed(search: Search) -> None:
    """The best distinct directions in full, of those that were looked at closely."""
    search.begin("the ten best in full")
    best = search.close()
    search.counts([best[k] for k in distinct([one.direction for one in best], APART)[:LISTED]])


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
        raise InputError(f"{search.objective.mesh.name}: no pose that fits, and prints anything, was counted in full")
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
    alike = (p for p in search.seen if (p.theta1, p.theta2) == (pose.theta1, pose.theta2))
    turned = [search.seen[p].estimate() for p in alike if search.seen[p].close]
    mean_px = sum(c.added + c.removed for c in turned) / len(turned) if len(turned) > 1 else None
    return candidate_of(search.aims, search.objective, pose, search.seen[pose], mean_px)


def _notes(search: Search, initial: Candidate, best: Candidate, interrupted: bool) -> tuple[str, ...]:
    notes = list(search.objective.mesh.notes)
    if interrupted:
        notes.append("broken off: this is the best so far; with --log and --resume it goes on from there")
    if not initial.printed:
        notes.append("as it is given, nothing of the part would be printed: no layer meets it")
    elif not initial.changed_px:
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
