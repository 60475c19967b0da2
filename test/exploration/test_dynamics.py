"""Double integrator and barrier: hand-computed numbers, limits, gradients against finite differences."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.dynamics import DoubleIntegrator
from embodied_active_learning.exploration.ergodic_objective import Barrier

DYNAMICS = DoubleIntegrator.from_config(Config())
BARRIER = Barrier.from_config(Config())
POSITION = arrays(np.float64, (3,), elements=st.floats(-1, 1))
RELATIVE_VELOCITY = arrays(np.float64, (3,), elements=st.floats(-1, 1))
CONTROLS = arrays(np.float64, (4, 10, 3), elements=st.floats(-1, 1))


def test_default_gains_follow_from_speed_limits():
    np.testing.assert_allclose(DYNAMICS.gain, [0.8, 0.8, 1.2])


def test_velocity_limit_is_top_speed_of_arm():
    np.testing.assert_allclose(DYNAMICS.to_si(DYNAMICS.velocity_limit), [0.15, 0.15, 1.5])
    np.testing.assert_allclose(DYNAMICS.from_si([0.12, -0.06, 2.4]), [1.0, -0.5, 1.0])


def test_one_step_by_hand():
    control = np.array([1.0, -1.0, 0.5])
    rollout = DYNAMICS.rollout(np.array([0.1, 0.2, -0.3]), np.array([0.5, 0.0, 0.5]), control[np.newaxis, np.newaxis])
    # pos + 0.16 vel + 0.016 u in x and y, pos + 0.24 vel + 0.024 u in theta; vel + 0.2 u
    np.testing.assert_allclose(rollout.positions[0, 0], [0.196, 0.184, -0.168])
    np.testing.assert_allclose(rollout.velocities[0, 0], [0.7, -0.2, 0.6])


def test_border_stops_position_and_outward_velocity():
    rollout = DYNAMICS.rollout(np.array([0.95, -0.95, 0.0]), np.array([1.0, -1.0, 0.0]), np.zeros((1, 3, 3)))
    np.testing.assert_array_equal(rollout.positions[0, -1], [1.0, -1.0, 0.0])
    np.testing.assert_array_equal(rollout.velocities[0, -1], [0.0, 0.0, 0.0])


@given(POSITION, RELATIVE_VELOCITY, CONTROLS, st.floats(0.1, 1000))
def test_predictions_stay_within_workspace_and_speed(position, velocity, controls, strength):
    rollout = DYNAMICS.rollout(position, velocity * DYNAMICS.velocity_limit, strength * controls)
    assert np.all(np.abs(rollout.positions) <= 1.0)
    assert np.all(np.abs(rollout.velocities) <= DYNAMICS.velocity_limit)


@given(POSITION, RELATIVE_VELOCITY, CONTROLS)
def test_step_length_limited_by_top_speed(position, velocity, controls):
    rollout = DYNAMICS.rollout(position, velocity * DYNAMICS.velocity_limit, controls)
    start = np.broadcast_to(position, rollout.positions[:, :1].shape)
    way = np.diff(np.concatenate([start, rollout.positions], axis=1), axis=1)
    assert np.all(np.abs(way) <= DYNAMICS.step * DYNAMICS.gain * DYNAMICS.velocity_limit + 1e-12)


def numeric_gradient(function, point, step=1e-6):
    gradient = np.empty_like(point)
    for index in np.ndindex(*point.shape):
        shift = np.zeros_like(point)
        shift[index] = step
        gradient[index] = (function(point + shift) - function(point - shift)) / (2 * step)
    return gradient


def test_adjoint_by_hand():
    """Per unit of control, the second position moves by 3 * 0.08 * 0.2 (first control) and 0.08 * 0.2 (second)."""
    dynamics = DoubleIntegrator(0.2, np.array([0.8]), np.array([1.25]), np.array([0.12]))
    rollout = dynamics.rollout(np.zeros(1), np.zeros(1), np.zeros((1, 2, 1)))
    last = np.array([[[0.0], [1.0]]])
    np.testing.assert_allclose(dynamics.backpropagate(rollout, last, np.zeros((1, 2, 1)))[0, :, 0], [0.048, 0.016])
    np.testing.assert_allclose(dynamics.backpropagate(rollout, np.zeros((1, 2, 1)), last)[0, :, 0], [0.2, 0.2])


@pytest.mark.parametrize("seed", range(8))
def test_adjoint_equals_finite_differences_of_rollout(seed):
    random = np.random.default_rng(seed)
    position, velocity = random.uniform(-1, 1, 3), random.uniform(-0.6, 0.6, 3)
    controls = random.uniform(-3, 3, (1, 10, 3))
    by_position, by_velocity = random.normal(size=(2, 1, 10, 3))

    def weighted(plan):
        rollout = DYNAMICS.rollout(position, velocity, plan)
        return np.sum(by_position * rollout.positions + by_velocity * rollout.velocities)

    adjoint = DYNAMICS.backpropagate(DYNAMICS.rollout(position, velocity, controls), by_position, by_velocity)
    np.testing.assert_allclose(adjoint, numeric_gradient(weighted, controls), atol=1e-7)


def test_barrier_by_hand():
    positions = np.array([[[0.95, 0.0, -1.0]]])
    velocities = np.array([[[0.0, 1.2, 0.0]]])
    assert BARRIER.cost(positions, velocities)[0] == pytest.approx(5 * (0.05**4 + 0.1**4 + 0.05**4))
    by_position, by_velocity = BARRIER.gradient(positions, velocities)
    np.testing.assert_allclose(by_position[0, 0], [20 * 0.05**3, 0.0, -20 * 0.1**3])
    np.testing.assert_allclose(by_velocity[0, 0], [0.0, 20 * 0.05**3, 0.0])


@settings(max_examples=20)
@given(st.sampled_from([1.0, 2.0, 4.0]), st.integers(0, 1000))
def test_barrier_gradient_equals_finite_differences(power, seed):
    barrier = dataclasses.replace(BARRIER, power=power)
    positions, velocities = np.random.default_rng(seed).uniform(-1.3, 1.3, (2, 1, 2, 3))
    by_position, by_velocity = barrier.gradient(positions, velocities)
    numeric = numeric_gradient(lambda values: barrier.cost(values, velocities)[0], positions)
    np.testing.assert_allclose(by_position, numeric, atol=1e-6)
    numeric = numeric_gradient(lambda values: barrier.cost(positions, values)[0], velocities)
    np.testing.assert_allclose(by_velocity, numeric, atol=1e-6)
