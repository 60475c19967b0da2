"""Ways to cover a density on the unit square with a planar double integrator: peers of the package's planner.

All move with the planner's dynamics and limits, but SMC limits the magnitude of the acceleration where the planner
limits each axis. Positions are normalised to [-1, 1], where trajectories are made, and returned on the unit square.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Callable, Dict

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.evaluation.spectral import Density, SpectralMetric
from embodied_active_learning.evaluation.trajectory_optimisation import optimise_trajectory
from embodied_active_learning.exploration.baselines import RandomWalkExplorer
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.dynamics import DoubleIntegrator
from embodied_active_learning.exploration.samples import WorkspaceSamples

DAMPING = 100.0
"""Weight of the velocity in second-order spectral multiscale coverage; the best of 3, 10, 30, 100 and 300."""
NARROW: Dict[str, Any] = {"kernel_variance": 0.0144, "samples": 2000, "fresh_samples": 200}
"""A planner whose kernel has a standard deviation of 0.06 of the unit square, instead of 0.12."""
_INSIDE = 1e-3
"""Distance from the border, where the gradients of all basis functions vanish, within which they are not evaluated."""
Method = Callable[[Density, int, int], np.ndarray]


def planar_dynamics(config: Config) -> DoubleIntegrator:
    """Return the dynamics of x and y of the configured arm."""
    full = DoubleIntegrator.from_config(config)
    return DoubleIntegrator(full.step, full.gain[:2], full.velocity_limit[:2], full.speed_unit[:2])


def to_square(normalised: np.ndarray) -> np.ndarray:
    """Return normalised positions (..., 2) on the unit square."""
    return 0.5 * (normalised + 1.0)


def planner_trajectory(density: Density, steps: int, seed: int, **settings: Any) -> np.ndarray:
    """Return the trajectory (steps, 2) of the package's planner in x, y and theta, for a density constant in theta.

    settings: keys of the section `exploration`.
    """
    config = Config()
    config = replace(config, exploration=replace(config.exploration, seed=seed, **settings))
    controller = ErgodicController(config, seed)
    samples = WorkspaceSamples(config, [np.append(_start(seed), 0.0)])
    for _ in range(steps):
        controller.observe(samples.visited[-1])
        samples.refresh()
        values = density(to_square(samples.states[:, :2]))
        controller.next_command(values / values.sum(), samples)
        samples.visit(controller.planned_states[0])
    return to_square(samples.visited[1:, :2])


def random_walk_trajectory(density: Density, steps: int, seed: int) -> np.ndarray:
    """Return the trajectory (steps, 2) of the random walk, which does not use the density."""
    config = Config()
    walk, step = RandomWalkExplorer(config, seed), config.exploration.step_duration
    state, visited = np.append(_start(seed), 0.0), []
    dynamics = DoubleIntegrator.from_config(config)
    samples = WorkspaceSamples(config)
    for _ in range(steps):
        walk.observe(state)
        command = walk.next_command(np.empty(0), samples)
        state = np.clip(state + step * dynamics.gain * dynamics.from_si(command.velocity), -1.0, 1.0)
        visited.append(state[:2])
    return to_square(np.array(visited))


def independent_samples(density: Density, steps: int, seed: int) -> np.ndarray:
    """Return points (steps, 2) drawn independently from the density, which no arm can visit in one step each."""
    random, points = np.random.default_rng(seed), np.empty((0, 2))
    highest = density(random.uniform(size=(100000, 2))).max()
    while len(points) < steps:
        proposals = random.uniform(size=(4 * steps, 2))
        points = np.concatenate([points, proposals[random.uniform(0.0, highest, 4 * steps) < density(proposals)]])
    return points[:steps]


def smc_trajectory(density: Density, steps: int, seed: int, damping: float = DAMPING) -> np.ndarray:
    """Return the trajectory (steps, 2) of spectral multiscale coverage with acceleration control.

    Mathew and Mezic 2011: the acceleration has its largest magnitude, against c v + B, where B is the gradient of the
    basis functions weighted by how much more than wanted each was visited.
    """
    config = Config()
    dynamics, metric, limit = planar_dynamics(config), SpectralMetric.of(density), config.planner.acceleration_limit
    position, velocity, visited = _start(seed), np.zeros(2), []
    surplus = np.zeros_like(metric.target)
    for _ in range(steps):
        here = np.clip(to_square(position), _INSIDE, 1.0 - _INSIDE)[np.newaxis]
        surplus += metric.coefficients(here) - metric.target
        direction = damping * velocity + metric.gradient(here, metric.weights * surplus)[0]
        control = -limit * direction / max(float(np.linalg.norm(direction)), 1e-12)
        motion = dynamics.rollout(position, velocity, control[np.newaxis, np.newaxis])
        position, velocity = motion.positions[0, 0], motion.velocities[0, 0]
        visited.append(position)
    return to_square(np.array(visited))


def optimised_trajectory(density: Density, steps: int, seed: int) -> np.ndarray:
    """Return the trajectory (steps, 2) optimised as a whole, which needs the number of steps in advance."""
    config = Config()
    limit = config.planner.acceleration_limit
    start = _start(seed)
    return to_square(
        optimise_trajectory(SpectralMetric.of(density), planar_dynamics(config), limit, start, steps, seed)
    )


METHODS: Dict[str, Method] = {
    "planner": planner_trajectory,
    "planner, narrow kernel": partial(planner_trajectory, **NARROW),
    "SMC": smc_trajectory,
    "trajectory optimisation": optimised_trajectory,
    "random walk": random_walk_trajectory,
    "independent samples": independent_samples,
}
PLANS_WHOLE = ("trajectory optimisation",)
"""Methods whose first steps depend on the number of steps."""


def _start(seed: int) -> np.ndarray:
    """Return the first position (2,), normalised."""
    return np.random.default_rng(seed).uniform(-0.9, 0.9, 2)
