"""Build directions: the paper's angles, rotation matrices, and even samples of the half-sphere.

A build direction is +z turned about x by θ₁ and then about z by θ₂, both axes being those of the part as it is given
(extrinsic Euler angles; paper, equation 5): d = Rz(θ₂) Rx(θ₁) ẑ, and [0, 0] is +z. The part is turned the other way,
by Rx(-θ₁) Rz(-θ₂), so that d points up. With θ₁ in [-π/2, π/2] and θ₂ in [0, π] these are the directions of the upper
half-sphere; -d, which needs as much correction, has θ₁ ± π. ψ then turns the part on the plate: Rz(ψ).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

HALF_TURN, QUARTER_TURN = math.pi, math.pi / 2
GOLDEN_ANGLE = HALF_TURN * (3 - math.sqrt(5))
EPS = 1e-12


class Pose(NamedTuple):
    """How a part stands on the plate: θ₁, θ₂ and ψ in radians."""

    theta1: float
    theta2: float
    psi: float = 0.0

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(3, 3): turns the part so that the direction points up. Exact at quarter turns."""
        return about_z(self.psi) @ about_x(-self.theta1) @ about_z(-self.theta2)

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector in the part as it is given, which points up when it is printed."""
        direction: NDArray[np.float64] = self.matrix[2].copy()
        return direction

    def turned(self, psi: float) -> Pose:
        """The same direction with another angle on the plate."""
        return Pose(self.theta1, self.theta2, psi)

    def flipped(self) -> Pose:
        """The same turned upside down: -d points up."""
        return Pose(self.theta1 - HALF_TURN if self.theta1 > 0 else self.theta1 + HALF_TURN, self.theta2, self.psi)


AS_GIVEN = Pose(0.0, 0.0, 0.0)


def about_x(angle: float) -> NDArray[np.float64]:
    """(3, 3): a turn about x, counter-clockwise seen from its tip."""
    c, s = _cos_sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def about_z(angle: float) -> NDArray[np.float64]:
    """(3, 3): a turn about z, counter-clockwise seen from above."""
    c, s = _cos_sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, whole at quarter turns: a part that is turned by 90° stays on its pixels."""
    quarters = angle / QUARTER_TURN
    if abs(quarters - round(quarters)) < EPS:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
    return math.cos(angle), math.sin(angle)


def pose_of(direction: ArrayLike) -> Pose:
    """The pose, within the paper's bounds, of a direction or of its opposite: whichever is in the upper half."""
    x, y, z = (float(v) for v in unit(direction))
    if z < -EPS or (abs(z) <= EPS and (y > EPS or (abs(y) <= EPS and x < 0))):
        x, y, z = -x, -y, -z
    across = math.hypot(x, y)
    if across < EPS:
        return AS_GIVEN
    theta1, theta2 = math.atan2(across, z), math.atan2(x, -y)
    if theta2 < -EPS:  # the other way round: turned back about x
        theta1, theta2 = -theta1, theta2 + HALF_TURN
    return Pose(min(max(theta1, -QUARTER_TURN), QUARTER_TURN), min(max(theta2, 0.0), HALF_TURN))


def wrapped(theta1: float, theta2: float) -> Pose:
    """Angles beyond the bounds as the same axis within them: (π/2, θ₂) is (-π/2, θ₂), and (θ₁, 0) is (-θ₁, π)."""
    return pose_of(Pose(theta1, theta2).direction)


def clipped(theta1: float, theta2: float) -> Pose:
    """Angles beyond the bounds put on them, as the paper seems to have done (it reports θ₂ = 0.00)."""
    return Pose(min(max(theta1, -QUARTER_TURN), QUARTER_TURN), min(max(theta2, 0.0), HALF_TURN))


def unit(vector: ArrayLike) -> NDArray[np.float64]:
    """(3,) of length 1."""
    v = np.asarray(vector, np.float64)
    out: NDArray[np.float64] = v / np.linalg.norm(v)
    return out


def fibonacci(count: int) -> NDArray[np.float64]:
    """(count, 3): directions spread evenly over the upper half-sphere, on a golden spiral."""
    k = np.arange(count)
    z = 1 - (k + 0.5) / count
    across = np.sqrt(1 - z * z)
    return np.column_stack([across * np.cos(GOLDEN_ANGLE * k), across * np.sin(GOLDEN_ANGLE * k), z])


def spacing(count: int) -> float:
    """How far apart neighbours of `fibonacci` are, about, in radians."""
    return math.sqrt(2 * HALF_TURN / count)


def axis_angle(one: ArrayLike, other: ArrayLike) -> float:
    """Angle between two axes (a direction and its opposite are one), 0 to π/2."""
    a, b = np.asarray(one, np.float64), np.asarray(other, np.float64)
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), abs(float(a @ b)))


def distinct(directions: Iterable[ArrayLike], apart: float) -> list[int]:
    """Indices of those that are at least so many radians from every earlier one that was kept, as axes."""
    kept: list[int] = []
    units: list[NDArray[np.float64]] = []
    cosine = math.cos(apart)
    for k, direction in enumerate(directions):
        d = unit(direction)
        if not units or np.abs(np.array(units) @ d).max() < cosine:
            kept.append(k)
            units.append(d)
    return kept


def beside(direction: ArrayLike, step: float) -> list[NDArray[np.float64]]:
    """Four directions around one, a step of so many radians away each."""
    d = unit(direction)
    helper = np.eye(3)[int(np.abs(d).argmin())]
    u = unit(np.cross(d, helper))
    v = np.cross(d, u)
    c, s = math.cos(step), math.sin(step)
    return [c * d + s * side for side in (u, -u, v, -v)]
