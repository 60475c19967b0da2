"""Ergodic trajectories optimised as a whole by iterated LQR.

L. M. Miller, T. D. Murphey: Trajectory optimization for continuous ergodic exploration. ACC 2013. The dynamics are
linear here, so each descent direction is feasible and the projection of that paper is the identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from embodied_active_learning.evaluation.spectral import SpectralMetric
from embodied_active_learning.exploration.dynamics import DoubleIntegrator

ITERATIONS = 100
_ERGODIC_WEIGHT = 100.0
_CONTROL_WEIGHT = 0.01
_LIMIT_WEIGHT = 10.0
"""Weight of the squared violation of limits, summed over the trajectory."""
_MARGIN = 0.95
"""Share of the limits at which the penalty begins."""
_SUFFICIENT, _SHRINK, _SMALLEST = 1e-4, 0.5, 1e-6
_STATE_MODEL = np.diag([1.0, 1.0, 0.1, 0.1])
"""Quadratic model of the cost of states, which scales descent directions."""
_CONTROL_MODEL = 0.1 * np.eye(2)


@dataclass(frozen=True)
class _Problem:
    metric: SpectralMetric
    dynamics: DoubleIntegrator
    acceleration_limit: float

    def matrices(self) -> Tuple[np.ndarray, np.ndarray]:
        """Return A (4, 4) and B (4, 2) of s' = A s + B u, with s = (position, velocity)."""
        dt, gain = self.dynamics.step, np.diag(self.dynamics.gain)
        a, b = np.eye(4), np.zeros((4, 2))
        a[:2, 2:], b[:2], b[2:] = dt * gain, 0.5 * dt**2 * gain, dt * np.eye(2)
        return a, b

    def limits(self) -> np.ndarray:
        """Return the limits (4,) of the state."""
        return np.concatenate([np.ones(2), self.dynamics.velocity_limit])

    def cost(self, states: np.ndarray, controls: np.ndarray) -> float:
        """Return the cost of states (N, 4) and controls (N, 2)."""
        over_state, over_control = self._excess(states, self.limits()), self._excess(controls, self._control_limits())
        smooth = _CONTROL_WEIGHT * np.sum(controls**2) / len(controls)
        penalty = _LIMIT_WEIGHT * (np.sum(over_state**2) + np.sum(over_control**2))
        return float(_ERGODIC_WEIGHT * self.metric.value(_square(states)) + smooth + penalty)

    def gradients(self, states: np.ndarray, controls: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return the partial derivatives of the cost by states (N, 4) and controls (N, 2)."""
        over_state, over_control = self._excess(states, self.limits()), self._excess(controls, self._control_limits())
        by_state = 2.0 * _LIMIT_WEIGHT * over_state
        square, count = _square(states), len(states)
        missing = self.metric.weights * (self.metric.coefficients(square) - self.metric.target)
        by_state[:, :2] += 0.5 * 2.0 * _ERGODIC_WEIGHT / count * self.metric.gradient(square, missing)
        return by_state, 2.0 * _CONTROL_WEIGHT / count * controls + 2.0 * _LIMIT_WEIGHT * over_control

    def _control_limits(self) -> np.ndarray:
        return np.full(2, self.acceleration_limit)

    @staticmethod
    def _excess(values: np.ndarray, limits: np.ndarray) -> np.ndarray:
        limits = _MARGIN * limits
        return values - np.clip(values, -limits, limits)


def optimise_trajectory(
    metric: SpectralMetric,
    dynamics: DoubleIntegrator,
    acceleration_limit: float,
    start: np.ndarray,
    steps: int,
    seed: int,
    iterations: int = ITERATIONS,
) -> np.ndarray:
    """Return positions (steps, 2), normalised, that minimise the spectral metric from rest at a start.

    Limits of the dynamics are kept by penalties, and exactly by the final rollout.

    Args:
        metric: Metric of the density to cover.
        dynamics: Planar dynamics.
        acceleration_limit: Largest acceleration of each axis.
        start: (2,) normalised.
        steps: Length of the trajectory.
        seed: Seed of the first guess.
        iterations: Largest number of iterations.
    """
    problem = _Problem(metric, dynamics, acceleration_limit)
    a, b = problem.matrices()
    gains, inverses, feedback = _riccati(a, b, steps)
    first = np.concatenate([start, np.zeros(2)])
    controls = _first_guess(steps, acceleration_limit, seed)
    states = _simulate(a, b, first, controls)
    cost = problem.cost(states, controls)
    for _ in range(iterations):
        by_state, by_control = problem.gradients(states, controls)
        towards_state, towards_control = _direction(a, b, gains, inverses, feedback, by_state, by_control)
        directional_derivative = float(np.sum(by_state * towards_state) + np.sum(by_control * towards_control))
        size = 1.0
        while size > _SMALLEST:
            changed = problem.cost(states + size * towards_state, controls + size * towards_control)
            if changed <= cost + _SUFFICIENT * size * directional_derivative:
                break
            size *= _SHRINK
        if size <= _SMALLEST:
            break
        states, controls, cost = states + size * towards_state, controls + size * towards_control, changed
    limited = np.clip(controls, -acceleration_limit, acceleration_limit)
    return dynamics.rollout(start, np.zeros(2), limited[np.newaxis]).positions[0]


def _riccati(a: np.ndarray, b: np.ndarray, steps: int) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return, for each step, the gains K (2, 4), (R + B'PB)^-1 (2, 2) and B'PA (2, 4), the same for any cost."""
    value = _STATE_MODEL
    gains, inverses, feedback = np.empty((steps, 2, 4)), np.empty((steps, 2, 2)), np.empty((steps, 2, 4))
    for t in reversed(range(steps)):
        inverses[t] = np.linalg.inv(_CONTROL_MODEL + b.T @ value @ b)
        feedback[t] = b.T @ value @ a
        gains[t] = -inverses[t] @ feedback[t]
        value = _STATE_MODEL + a.T @ value @ a + feedback[t].T @ gains[t]
    return gains, inverses, feedback


def _direction(
    a: np.ndarray,
    b: np.ndarray,
    gains: np.ndarray,
    inverses: np.ndarray,
    feedback: np.ndarray,
    by_state: np.ndarray,
    by_control: np.ndarray,
) -> Tuple[np.ndarray, np.ndarray]:
    """Return the change of states (N, 4) and controls (N, 2) that minimises the quadratic model of the cost."""
    steps = len(by_state)
    offsets, linear = np.empty((steps, 2)), np.zeros(4)
    for t in reversed(range(steps)):
        linear = linear + by_state[t]  # of the state after control t
        offsets[t] = -inverses[t] @ (by_control[t] + b.T @ linear)
        linear = a.T @ linear + feedback[t].T @ offsets[t]
    states, controls, state = np.empty((steps, 4)), np.empty((steps, 2)), np.zeros(4)
    for t in range(steps):
        controls[t] = gains[t] @ state + offsets[t]
        state = states[t] = a @ state + b @ controls[t]
    return states, controls


def _simulate(a: np.ndarray, b: np.ndarray, state: np.ndarray, controls: np.ndarray) -> np.ndarray:
    states = np.empty((len(controls), 4))
    for t, control in enumerate(controls):
        state = states[t] = a @ state + b @ control
    return states


def _first_guess(steps: int, limit: float, seed: int) -> np.ndarray:
    """Return controls (N, 2) that swing back and forth with random phases, so that the trajectory is not at rest."""
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 2)
    time = np.arange(steps)[:, np.newaxis]
    return 0.3 * limit * np.cos(2.0 * np.pi * time / np.array([23.0, 31.0]) + phase)


def _square(states: np.ndarray) -> np.ndarray:
    return 0.5 * (states[:, :2] + 1.0)
