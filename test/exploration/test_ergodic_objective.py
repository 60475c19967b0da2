"""Planning objective and its gradient, against a plain double-precision implementation of the formula."""

import dataclasses

import numpy as np
import pytest
from scipy.special import ndtr

from embodied_active_learning.config import Config
from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.exploration.controller import ErgodicController, Plan
from embodied_active_learning.exploration.dynamics import DoubleIntegrator
from embodied_active_learning.exploration.ergodic_objective import Barrier, ErgodicObjective
from embodied_active_learning.exploration.samples import WorkspaceSamples

VARIANCE = 0.2  # wide enough that no sample of a short history is at the floor, where J has no gradient


def make(normalise, visited=40):
    config = Config()
    config = dataclasses.replace(
        config,
        exploration=dataclasses.replace(config.exploration, samples=300, kernel_variance=VARIANCE),
        planner=dataclasses.replace(config.planner, normalise_kernels=normalise),
    )
    random = np.random.default_rng(5)
    samples = WorkspaceSamples(config, random.uniform(-1, 1, (visited, 3)))
    target = np.exp(random.normal(size=300))
    return ErgodicObjective(target, samples, Barrier.from_config(config)), samples, target, config


def mass(states, box=1.0):
    std = np.sqrt(VARIANCE)
    return np.prod(ndtr((box - states) / std) - ndtr((-box - states) / std), axis=-1)


def plain_cost(samples, target, config, normalise, positions, velocities):
    states = np.concatenate([samples.visited, positions])
    psi = np.exp(-0.5 * np.sum((samples.states[:, np.newaxis] - states) ** 2, axis=-1) / VARIANCE)
    visitation = (psi / mass(states) if normalise else psi).sum(axis=1)
    h, d = target / target.sum(), visitation / visitation.sum()
    return np.sum(h * np.log(h / d)) + Barrier.from_config(config).cost(positions, velocities)


def start(seed):
    """Return position, velocity and controls of a plan that reaches a limit."""
    random = np.random.default_rng(seed)
    return random.uniform(-0.95, 0.95, 3), random.uniform(-0.6, 0.6, 3), random.uniform(-1, 1, (1, 10, 3))


def numeric_gradient(measure, position, velocity, controls, step=1e-5):
    """Return the derivative of plain_cost by each control (1, H, D); measure: its first four arguments."""
    dynamics = DoubleIntegrator.from_config(measure[2])

    def cost(plan):
        rollout = dynamics.rollout(position, velocity, plan)
        return plain_cost(*measure, rollout.positions[0], rollout.velocities[0])

    numeric = np.empty_like(controls)
    for index in np.ndindex(*controls.shape):
        shift = np.zeros_like(controls)
        shift[index] = step
        numeric[index] = (cost(controls + shift) - cost(controls - shift)) / (2 * step)
    return numeric


@pytest.mark.parametrize("normalise", [False, True])
def test_cost_equals_formula(normalise):
    objective, samples, target, config = make(normalise)
    dynamics = DoubleIntegrator.from_config(config)
    position, velocity, _ = start(0)
    rollout = dynamics.rollout(position, velocity, np.random.default_rng(1).uniform(-1, 1, (4, 10, 3)))
    plain = [
        plain_cost(samples, target, config, normalise, positions, velocities)
        for positions, velocities in zip(rollout.positions, rollout.velocities)
    ]
    np.testing.assert_allclose(objective.cost(rollout), plain, rtol=1e-5)


@pytest.mark.parametrize("normalise", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_gradient_equals_finite_differences_of_formula(normalise, seed):
    objective, samples, target, config = make(normalise)
    dynamics = DoubleIntegrator.from_config(config)
    position, velocity, controls = start(seed)
    rollout = dynamics.rollout(position, velocity, controls)
    gradient = dynamics.backpropagate(rollout, *objective.gradient(rollout))
    numeric = numeric_gradient((samples, target, config, normalise), position, velocity, controls)
    np.testing.assert_allclose(gradient, numeric, atol=2e-4 * np.abs(numeric).max())


def test_control_update_is_scaled_gradient_over_weight():
    objective, samples, target, config = make(normalise=True)
    weight = 1e6  # so that no control comes to its limit
    planner = dataclasses.replace(config.planner, control_weight=weight, acceleration_limit=10.0)
    controller = ErgodicController(dataclasses.replace(config, planner=planner), 0)
    position, _, controls = start(0)
    rollout = controller.dynamics.rollout(position, np.zeros(3), controls)
    update = controller._updated_controls(Plan(controls[0], rollout, 0.0), objective) - controls[0]
    numeric = numeric_gradient((samples, target, config, True), position, np.zeros(3), controls)
    np.testing.assert_allclose(update, -objective.scale * numeric[0] / weight, rtol=1e-2, atol=1e-4 * np.ptp(update))


def test_gradient_finite_without_visited_states():
    objective, _, _, config = make(normalise=True, visited=0)
    rollout = DoubleIntegrator.from_config(config).rollout(np.ones(3), np.zeros(3), np.zeros((1, 10, 3)))
    assert all(np.all(np.isfinite(part)) for part in objective.gradient(rollout))
    assert np.isfinite(objective.scale)


@pytest.mark.parametrize("target", [np.ones(299), np.ones(1), np.full(300, np.nan)])
def test_target_of_wrong_size_or_not_finite_rejected(target):
    _, samples, _, config = make(normalise=True)
    with pytest.raises(EmbodiedActiveLearningError, match="300 samples"):
        ErgodicObjective(target, samples, Barrier.from_config(config))
