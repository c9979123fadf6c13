"""Build directions: the paper's angles against an independent maker of rotations, and even samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from layerfix.orientation.directions import (
    AS_GIVEN,
    Pose,
    axis_angle,
    beside,
    clipped,
    distinct,
    fibonacci,
    pose_of,
    spacing,
    wrapped,
)

half, whole, any_angle = st.floats(-math.pi / 2, math.pi / 2), st.floats(0, math.pi), st.floats(-7, 7)
vectors = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.01)


def test_as_given_is_plus_z():
    """θ = [0, 0] is +z, and turns nothing, to the bit."""
    assert AS_GIVEN.direction.tolist() == [0, 0, 1]
    assert np.array_equal(AS_GIVEN.matrix, np.eye(3))


@given(any_angle, any_angle, any_angle)
def test_angles_are_extrinsic_about_x_then_z(theta1, theta2, psi):
    """The direction is +z turned about x by θ₁, then about z by θ₂; the part is turned back, then on the plate."""
    turn = Rotation.from_euler("xz", [theta1, theta2])  # small letters: extrinsic
    pose = Pose(theta1, theta2, psi)
    assert np.allclose(pose.direction, turn.apply([0, 0, 1]), atol=1e-12)
    assert np.allclose(pose.matrix, Rotation.from_euler("z", psi).as_matrix() @ turn.inv().as_matrix(), atol=1e-12)
    assert np.allclose(pose.matrix @ pose.direction, [0, 0, 1], atol=1e-12)


@given(half, whole)
def test_the_bounds_are_the_upper_half(theta1, theta2):
    """θ₁ from -π/2 to π/2 and θ₂ from 0 to π reach directions with z ≥ 0, and `pose_of` leads back to them."""
    direction = Pose(theta1, theta2).direction
    assert direction[2] >= -1e-12
    assert axis_angle(pose_of(direction).direction, direction) < 1e-7


@given(vectors)
def test_every_direction_has_a_pose_within_the_bounds(vector):
    """Itself or its opposite points up."""
    pose = pose_of(vector)
    assert -math.pi / 2 <= pose.theta1 <= math.pi / 2
    assert 0 <= pose.theta2 <= math.pi
    assert axis_angle(pose.direction, np.array(vector) / np.linalg.norm(vector)) < 1e-7
    again = pose_of(-np.array(vector))
    assert np.allclose(again.direction, pose.direction, atol=1e-9)


@given(any_angle, any_angle, any_angle)
def test_upside_down_is_the_opposite(theta1, theta2, psi):
    """And twice is the same again."""
    pose = Pose(theta1, theta2, psi)
    assert np.allclose(pose.flipped().direction, -pose.direction, atol=1e-12)
    assert np.allclose(pose.flipped().flipped().direction, pose.direction, atol=1e-12)


@given(any_angle)
def test_wrapped_beyond_the_bounds(theta):
    """(π/2, θ₂) and (-π/2, θ₂) are one axis; (θ₁, 0) and (-θ₁, π) are one direction."""
    assert np.allclose(np.abs(wrapped(math.pi / 2, theta).direction), np.abs(wrapped(-math.pi / 2, theta).direction))
    assert np.allclose(wrapped(theta, 0).direction, wrapped(-theta, math.pi).direction, atol=1e-9)


def test_clipped_to_the_bounds():
    """Each angle by itself, as in the paper's method."""
    assert clipped(2, -1) == Pose(math.pi / 2, 0)
    assert clipped(-2, 4) == Pose(-math.pi / 2, math.pi)
    assert clipped(0.3, 0.4) == Pose(0.3, 0.4)


@pytest.mark.parametrize("count", [100, 400, 1000])
def test_fibonacci_directions_are_even(count):
    """Upper half; no two much nearer than the spacing, no place much further from all of them."""
    directions = fibonacci(count)
    assert directions.shape == (count, 3)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)
    assert (directions[:, 2] > 0).all()
    cosines = np.abs(directions @ directions.T) - 2 * np.eye(count)
    inner = directions[:, 2] > 0.2  # at the rim a direction's neighbour may be the opposite of one there
    assert math.acos(cosines[inner].max()) > 0.6 * spacing(count)
    random = np.random.default_rng(1).normal(size=(2000, 3))
    random /= np.linalg.norm(random, axis=1)[:, None]
    assert math.acos(np.abs(random @ directions.T).max(axis=1).min()) < 1.3 * spacing(count)


def test_distinct_keeps_the_first_of_each():
    """Opposite directions are one."""
    tilted = [math.sin(0.05), 0, math.cos(0.05)]
    assert distinct([[0, 0, 1], [0, 0, -1], tilted, [1, 0, 0]], 0.04) == [0, 2, 3]
    assert distinct([[0, 0, 1], [0, 0, -1], tilted, [1, 0, 0]], 0.06) == [0, 3]


@given(vectors, st.floats(0.001, 0.5))
def test_beside_is_a_step_away_on_four_sides(vector, step):
    """Opposite each other in pairs."""
    direction = np.array(vector) / np.linalg.norm(vector)
    around = beside(direction, step)
    assert np.allclose([math.acos(np.clip(d @ direction, -1, 1)) for d in around], step, atol=1e-6)
    assert np.allclose(around[0] + around[1], 2 * math.cos(step) * direction)
    assert np.allclose(around[2] + around[3], 2 * math.cos(step) * direction)
    assert abs((around[0] - around[1]) @ (around[2] - around[3])) < 1e-9
