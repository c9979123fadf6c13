"""What every method searches with: evaluations that are remembered, computed in parallel, recorded and told of."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from layerfix.orientation.directions import AS_GIVEN, Pose
from layerfix.orientation.objective import FULL, Counts

if TYPE_CHECKING:
    from layerfix.orientation.aims import Aims
    from layerfix.orientation.engines import Engine
    from layerfix.orientation.objective import Objective
    from layerfix.orientation.record import Record


class State(NamedTuple):
    """How far a search is.

    done, total  in full evaluations; the total is a guess
    best         value of the best pose so far, 1 being the part as it is given (if only correction counts)
    doing        in a word
    """

    done: float
    total: float
    best: float
    doing: str


Tell = Callable[[State], None]


class Best(NamedTuple):
    """A pose, what was counted for it, and its value."""

    pose: Pose
    counts: Counts
    value: float


@dataclass(eq=False)
class Search:
    """Evaluations, each done once. seen: all counts so far, by pose; equivalents: layers counted, in full poses."""

    objective: Objective
    engine: Engine
    record: Record | None = None
    tell: Tell = lambda state: None
    fits: Callable[[Pose], bool] = lambda pose: True

    def __post_init__(self) -> None:
        """Nothing is seen yet."""
        self.seen: dict[Pose, Counts] = {}
        self.order: list[Pose] = []  # as they were first asked for
        self.equivalents, self.computed_s, self.started = 0.0, 0.0, time.perf_counter()
        self.total, self.doing = 1.0, "initial pose"
        self.aims: Aims | None = None
        self.best: Best | None = None

    def counts(self, poses: Sequence[Pose], layers: int = FULL) -> list[Counts]:
        """Of each pose the first `layers` layers of the evenly spread order, or all: with those seen before."""
        wanted: dict[Pose, int] = {}
        for pose in poses:
            before = self.seen.get(pose)
            if before is None or not (before.whole or before.seen >= layers):
                wanted[pose] = before.seen if before is not None else 0
        left: list[tuple[Pose, int]] = []
        for pose, first in wanted.items():
            known = self.record.known.get((*pose, first, layers)) if self.record else None
            if known is not None:
                self._take(pose, known)
            else:
                left.append((pose, first))
        self._compute(left, layers)
        return [self.seen[pose] for pose in poses]

    def _compute(self, left: Sequence[tuple[Pose, int]], layers: int) -> None:
        """Tasks are poses, or parts of their layers if there are fewer poses than workers."""
        pieces = max(self.engine.workers // len(left), 1) if left else 1
        tasks, owner, waiting = [], [], []
        sums: list[Counts | None] = [None] * len(left)
        for k, (pose, first) in enumerate(left):
            cuts = self._cuts(pose, first, layers, pieces)
            waiting.append(len(cuts) - 1)
            for a, b in pairwise(cuts):
                tasks.append((pose, a, b))
                owner.append(k)
        with closing(self.engine.run(tasks)) as results:  # or threads would go on after a Ctrl-C
            for done in results:
                k = owner[done.number]
                before = sums[k]
                sums[k] = found = done.counts if before is None else before.with_more(done.counts)
                waiting[k] -= 1
                self.computed_s += done.seconds
                if waiting[k]:
                    continue
                pose, first = left[k]
                if self.record is not None:
                    self.record.add(pose, first, layers, found)
                self._take(pose, found)

    def _cuts(self, pose: Pose, first: int, layers: int, pieces: int) -> list[int]:
        if pieces < 2:
            return [first, layers]
        stop = min(layers, math.ceil(self.objective.height_mm(pose) / self.objective.printing.layer_mm))
        step = max((stop - first) / pieces, 8)
        inner = [first + round(k * step) for k in range(1, pieces) if first + round(k * step) < stop]
        return [first, *inner, layers]

    def _take(self, pose: Pose, more: Counts) -> None:
        before = self.seen.get(pose)
        found = more if before is None else before.with_more(more)
        self.seen[pose] = found  # first: a Ctrl-C may come between
        if before is None:
            self.order.append(pose)
        self.equivalents += more.seen / max(found.layers, 1)
        if found.whole and self.aims is not None and self.fits(pose):
            value = self.value(pose)
            if self.best is None or value < self.best.value:
                self.best = Best(pose, found, value)
        self._say()

    def _say(self) -> None:
        best = self.best.value if self.best is not None else math.nan
        self.tell(State(self.equivalents, max(self.total, self.equivalents), best, self.doing))

    def begin(self, doing: str, total: float | None = None) -> None:
        """A new step, and how many full evaluations the whole search may come to."""
        self.doing = doing
        if total is not None:
            self.total = total
        self._say()

    def value(self, pose: Pose) -> float:
        """Of a pose that was looked at, or its opposite, whichever is better: an estimate unless all was counted."""
        assert self.aims is not None
        counts = self.seen[pose]
        if not self.aims.of_shape:
            return self.aims.value(pose, counts)
        return min(self.aims.value(pose, counts), self.aims.value(pose.flipped(), counts))

    def values(self, poses: Sequence[Pose], layers: int = FULL) -> list[float]:
        """`value` of each, counted now if it was not."""
        self.counts(poses, layers)
        return [self.value(pose) for pose in poses]

    def whole(self) -> list[Pose]:
        """Poses that were counted in full, and fit, best first."""
        return self._ranked(lambda counts: counts.whole)

    def close(self) -> list[Pose]:
        """Poses that were counted closely, and fit, best first."""
        return self._ranked(lambda counts: counts.close)

    def _ranked(self, enough: Callable[[Counts], bool]) -> list[Pose]:
        found = [p for p in self.order if not self.seen[p].empty and enough(self.seen[p]) and self.fits(p)]
        return sorted(found, key=lambda pose: (self.value(pose), pose != AS_GIVEN))
