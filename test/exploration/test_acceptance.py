"""Acceptance of the ergodic controller in closed loop with perfect dynamics."""

import dataclasses

import numpy as np
import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.ergodic_objective import kl_ergodic, target_distribution, uniform_distribution
from embodied_active_learning.exploration.samples import WorkspaceSamples

BUMPS = np.array([[-0.63, -0.67], [0.3, 0.53]])  # normalised x, y
# D_KL [nat] at these steps: 2.3, 1.25, 0.52, 0.22 with a prototype, 1.6, 0.7, 0.25, 0.13 with this controller
STEPS, LIMITS = (31, 60, 120, 200), (2.1, 1.1, 0.42, 0.20)


def configuration(seed, planner=None, **exploration):
    config = Config()
    return dataclasses.replace(
        config,
        exploration=dataclasses.replace(config.exploration, seed=seed, **exploration),
        planner=dataclasses.replace(config.planner, **(planner or {})),
    )


def two_bumps(samples):
    """Return the target for std(s) = 0.02 + 0.15 sum exp(-d^2 / 0.08), d the distance to a bump in x and y."""
    square = np.sum((samples.states[:, np.newaxis, :2] - BUMPS) ** 2, axis=-1)
    log_std = np.log(0.02 + 0.15 * np.sum(np.exp(-0.5 * square / 0.04), axis=1))
    return target_distribution(log_std, samples.coverage)


def flat(samples):
    return uniform_distribution(len(samples.states))


def explore(config, target_of, steps):
    """Run a controller from rest in the middle; yield samples, target and planned states of each step."""
    controller, samples = ErgodicController(config, config.exploration.seed), WorkspaceSamples(config)
    samples.visit(np.zeros(3))
    for _ in range(steps):
        controller.observe(samples.visited[-1])
        samples.refresh()
        target = target_of(samples)
        controller.next_command(target, samples)
        yield samples, target, controller.planned_states
        samples.visit(controller.planned_states[0])


def measure_with(samples, target, planned):
    """Return the ergodic measure of visited and planned states."""
    return kl_ergodic(target, samples.visitation + samples.kernel(samples.states, planned).sum(axis=0, dtype=float))


@pytest.mark.parametrize(("fresh", "normalise"), [(1000, False), (100, True)])
def test_ergodic_measure_of_two_bumps_beats_prototype(fresh, normalise):
    measures = []
    for seed in range(2):
        config = configuration(
            seed, {"normalise_kernels": normalise}, sample_box=1.15, authors_coverage=True, fresh_samples=fresh
        )
        run = enumerate(explore(config, two_bumps, 200), start=1)
        measures.append([measure_with(samples, h, plan) for i, (samples, h, plan) in run if i in STEPS])
    assert np.all(np.mean(measures, axis=0) <= LIMITS), np.mean(measures, axis=0)


@pytest.mark.parametrize("seed", range(2))
def test_flat_target_covered_evenly_without_standstill(seed):
    samples = list(explore(configuration(seed), flat, 400))[-1][0]
    assert longest_standstill(samples.visited) <= 5
    evaluation = WorkspaceSamples(configuration(seed + 1000), samples.visited)
    assert kl_ergodic(flat(evaluation), evaluation.visitation) <= 0.06


def longest_standstill(visited):
    """Return the largest number of consecutive steps that change every coordinate by less than 0.001."""
    longest = current = 0
    for still in np.max(np.abs(np.diff(visited, axis=0)), axis=1) < 1e-3:
        current = current + 1 if still else 0
        longest = max(longest, current)
    return longest


def test_controller_leaves_corner_immediately():
    config = configuration(0)
    controller, samples = ErgodicController(config, 0), WorkspaceSamples(config)
    position = np.ones(3)
    for _ in range(10):
        samples.visit(position)
        controller.observe(position)
        samples.refresh()
        controller.next_command(flat(samples), samples)
        position = controller.planned_states[0]
    assert np.all(np.abs(position) < 1.0)
