"""What else a direction is good or bad for, from the facets alone, and how aims are weighed against each other.

n is a facet's outward normal, A its area, d the direction that points up, h a facet's middle above the plate.

    support    mm³   Σ A |n·d| h over facets steeper than 45° from below: what would be filled down to the plate; what
                     stands in the part's own shade counts too, so it is an upper bound
    overhang   mm²   Σ A of those facets; both leave out what lies on the plate
    height     mm    of the part; layers, and most of a resin print's time, are proportional to it
    staircase  mm³   (t/2) Σ A |n·d| over facets that are not level: the volume of the steps of layers t high
    contact    mm²   Σ A |n·d| of level facets within a layer of the plate; more is better

The direction upside down needs the same correction and other supports: both are scored, and the better one is taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from layerfix.errors import InputError
from layerfix.orientation.candidates import facets
from layerfix.orientation.directions import AS_GIVEN, Pose, fibonacci, pose_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from layerfix.mesh.triangles import Mesh
    from layerfix.orientation.objective import Counts

CRITICAL = math.sin(math.radians(45.0))  # facets that face down more than this need support
LEVEL = math.cos(math.radians(1.0))  # facets that face up or down this much are level
CORRECTION = ("added", "removed")
OF_SHAPE = ("support", "overhang", "height", "staircase", "contact")
AIMS = (*CORRECTION, *OF_SHAPE)
UNITS = {"added": "px", "removed": "px", "support": "mm³", "overhang": "mm²", "height": "mm", "staircase": "mm³",
         "contact": "mm²"}  # fmt: skip
MORE_IS_BETTER = ("contact",)


@dataclass(frozen=True, eq=False)
class Shape:
    """A part's facets, for the aims that depend on nothing else."""

    mesh: Mesh
    layer_mm: float
    _normals: NDArray[np.float64] = field(init=False)
    _areas: NDArray[np.float64] = field(init=False)
    _corners: NDArray[np.float64] = field(init=False)
    _known: dict[tuple[float, float], dict[str, float]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Measure the facets once."""
        normals, areas, corners = facets(self.mesh)
        for name, value in (("_normals", normals), ("_areas", areas), ("_corners", corners)):
            object.__setattr__(self, name, value)

    def terms(self, pose: Pose) -> dict[str, float]:
        """Each of OF_SHAPE in its unit, for one pose. ψ does not matter."""
        key = pose.theta1, pose.theta2
        if key not in self._known:
            self._known[key] = self._measured(pose)
        return self._known[key]

    def _measured(self, pose: Pose) -> dict[str, float]:
        d = pose.direction
        z = self._corners @ d
        low, high = z.min(axis=1), z.max(axis=1)
        plate, top = float(low.min()), float(high.max())
        up = self._normals @ d
        level = np.abs(up) > LEVEL
        on_plate = high < plate + self.layer_mm
        hangs = (up < -CRITICAL) & ~on_plate
        footprint = self._areas * np.abs(up)
        return {
            "support": float(footprint[hangs] @ (z[hangs].mean(axis=1) - plate)) if hangs.any() else 0.0,
            "overhang": float(self._areas[hangs].sum()),
            "height": top - plate,
            "staircase": float(self.layer_mm / 2 * footprint[~level].sum()),
            "contact": float(footprint[on_plate & level & (up < 0)].sum()),
        }


@dataclass(frozen=True, eq=False)
class Aims:
    """A weighted sum of aims, each divided by what it is for the part as it is given.

    weights  of AIMS, 0 or more. added and removed are both divided by their initial sum: equal weights, the paper's C
    scale    what each is divided by
    """

    shape: Shape
    weights: Mapping[str, float]
    scale: Mapping[str, float]

    @property
    def of_shape(self) -> tuple[str, ...]:
        """The aims, besides correction, that count."""
        return tuple(name for name in OF_SHAPE if self.weights.get(name, 0.0) > 0)

    def value(self, pose: Pose, counts: Counts) -> float:
        """The weighted sum, less is better; infinite for a pose in which nothing would be printed."""
        if counts.empty:
            return math.inf
        found = counts.estimate()
        of_shape = self.shape.terms(pose) if self.of_shape else {}
        terms = {"added": found.added, "removed": found.removed, **of_shape}
        return math.fsum(
            (-1 if name in MORE_IS_BETTER else 1) * weight * terms[name] / self.scale[name]
            for name, weight in self.weights.items()
            if weight > 0
        )

    def upright(self, pose: Pose, counts: Counts) -> Pose:
        """The pose or its opposite: the better one; if they are equally good, the one with less to support."""
        other = pose.flipped()
        one, two = self.value(pose, counts), self.value(other, counts)
        if one != two:
            return pose if one < two else other
        here, there = self.shape.terms(pose), self.shape.terms(other)
        key = ("support", "overhang")
        return other if [there[k] for k in key] < [0.99 * here[k] for k in key] else pose


def check_weights(weights: Mapping[str, float]) -> dict[str, float]:
    """Weights of the aims; added and removed are 1 unless given. Raises InputError for unknown and unusable ones."""
    for name, weight in weights.items():
        if name not in AIMS:
            raise InputError(f"weight of '{name}': there is no such aim; choose from {', '.join(AIMS)}")
        if not 0 <= weight < math.inf:
            raise InputError(f"weight {name}={weight:g}: it must be 0 or more")
    given = {"added": 1.0, "removed": 1.0, **weights}
    if not any(given.values()):
        raise InputError("all weights are 0: nothing would be optimised; give one above 0, such as added=1")
    return {name: float(given[name]) for name in AIMS if name in given}


def aims_for(shape: Shape, weights: Mapping[str, float], initial: Counts) -> Aims:
    """Aims on the scale of the part as it is given; where it has nothing of an aim, of the middle direction."""
    scale = {name: float(max(initial.added + initial.removed, 1)) for name in CORRECTION}
    chosen = [name for name in OF_SHAPE if weights.get(name, 0.0) > 0]
    if chosen:
        given = shape.terms(AS_GIVEN)
        usual = _usual(shape, chosen)
        for name in chosen:
            scale[name] = given[name] if given[name] > 0.01 * usual[name] else usual[name]
    return Aims(shape, weights, {name: value or 1.0 for name, value in scale.items()})


def _usual(shape: Shape, names: Sequence[str]) -> dict[str, float]:
    """The mean of each over even directions."""
    found = [shape.terms(pose_of(d)) for d in fibonacci(32)]
    return {name: float(np.mean([terms[name] for terms in found])) for name in names}
