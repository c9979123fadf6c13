"""Methods that go from one direction to the next: the paper's simulated annealing, and SciPy's DIRECT.

Annealing (paper, section 5; Kirkpatrick et al. 1983): new angles are drawn from a Gaussian around the present ones
whose variance is proportional to the temperature T; what is better is always taken, what is worse with probability
exp(-ΔE / T). E is C divided by that of the part as it is given, so that one T suits every part. The bounds clip, as
the paper's θ₂ = 0.00 for the threaded cylinder suggests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from layerfix.orientation.directions import AS_GIVEN, HALF_TURN, QUARTER_TURN, Pose, clipped

if TYPE_CHECKING:
    from layerfix.orientation.search import Search

Cooling = Literal["exponential", "linear", "logarithmic"]
COOLINGS: tuple[Cooling, ...] = get_args(Cooling)
EVALUATIONS = 300  # "in all of our examples, the optimization converges under 300 iterations"
HOT, COLD = 0.3, 0.001  # of the initial C: the temperatures at the start and at the end
REACH = QUARTER_TURN / 2  # standard deviation of each angle at the start


@dataclass(frozen=True)
class Annealing:
    """How it is cooled and for how long; the same seed goes the same way."""

    cooling: Cooling = "exponential"
    evaluations: int = EVALUATIONS
    seed: int = 0


def temperature(cooling: Cooling, step: int, steps: int) -> float:
    """At a step from 0 to steps - 1, in shares of the initial C. All fall; the logarithm does not get far."""
    if cooling == "logarithmic":
        return HOT * math.log(2) / math.log(2 + step)
    share = step / max(steps - 1, 1)
    if cooling == "linear":
        return HOT + (COLD - HOT) * share
    return HOT * math.exp(math.log(COLD / HOT) * share)


def accepted(change: float, hot: float, chance: float) -> bool:
    """Metropolis: whether to go on from what is worse by `change`; chance: 0 … 1, drawn evenly."""
    return change <= 0 or chance < math.exp(-change / hot)


def anneal(search: Search, how: Annealing) -> Pose:
    """The best pose seen in so many evaluations, the first being the part as it is given."""
    search.begin(f"annealing ({how.cooling})", how.evaluations)
    random = np.random.default_rng(how.seed)
    now = AS_GIVEN
    value = search.values([now])[0]
    best, lowest = now, value
    for step in range(how.evaluations - 1):
        hot = temperature(how.cooling, step, how.evaluations - 1)
        reach = REACH * math.sqrt(hot / HOT)
        one, two, chance = random.normal(), random.normal(), random.random()
        there = clipped(now.theta1 + reach * one, now.theta2 + reach * two)
        found = search.values([there])[0] if search.fits(there) else math.inf
        if found < lowest:
            best, lowest = there, found
        if accepted(found - value, hot, chance):
            now, value = there, found
    return best


def direct(search: Search, evaluations: int = EVALUATIONS) -> Pose:
    """The best pose of SciPy's DIRECT (the global form: the local one ended 1–2 % higher)."""
    from scipy.optimize import Bounds
    from scipy.optimize import direct as divide

    search.begin("DIRECT", evaluations)
    best: list[tuple[float, Pose]] = []
    worst = [0.0]

    def value_of(theta: np.ndarray) -> float:
        pose = Pose(float(theta[0]), float(theta[1]))
        value = search.values([pose])[0] if search.fits(pose) else math.inf
        if not math.isfinite(value):  # rectangles are divided by their values: as bad as the worst, and a little
            return worst[0] * 1.01 + 1e-9
        worst[0] = max(worst[0], value)
        best.append((value, pose))
        return value

    objective: Callable[[np.ndarray], float] = value_of
    bounds = Bounds([-QUARTER_TURN, 0.0], [QUARTER_TURN, HALF_TURN])
    # DIRECT ends its round of divisions before it looks at the count: it may go a few over.
    divide(objective, bounds, maxfun=evaluations, maxiter=evaluations, locally_biased=False)
    return min(best, key=lambda one: one[0])[1] if best else AS_GIVEN
