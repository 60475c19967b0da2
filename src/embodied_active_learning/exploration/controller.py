"""Receding-horizon KL-ergodic control (Paper, Sec. 2.3, and Alg. 1, line 11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.exploration.commands import VelocityCommand
from embodied_active_learning.exploration.dynamics import DoubleIntegrator, Rollout
from embodied_active_learning.exploration.ergodic_objective import Barrier, ErgodicObjective
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.rng import Stream, generator, generator_state, set_generator_state
from embodied_active_learning.state_dict import StateDict, matching_arrays

MAX_WINDOW = 5  # steps, as in the authors' search for the application time


@dataclass(frozen=True)
class Plan:
    """Controls over the horizon and the predicted motion."""

    controls: np.ndarray  # (H, D) velocity units per second
    rollout: Rollout  # of this plan alone
    cost: float  # J, nat

    @property
    def positions(self) -> np.ndarray:
        """Predicted states (H, D), normalised, after each step."""
        return self.rollout.positions[0]

    @property
    def velocities(self) -> np.ndarray:
        """Predicted velocities (H, D), velocity units, after each step."""
        return self.rollout.velocities[0]


class ErgodicController(Explorer):
    """Plans motion whose time average matches the target distribution, and commands the first step of each plan."""

    def __init__(self, config: Config, seed: int) -> None:
        """Start with an empty plan, at rest in the middle of the workspace until `observe` is called."""
        self.dynamics = DoubleIntegrator.from_config(config)
        self._barrier = Barrier.from_config(config)
        self._planner = config.planner
        axes = config.workspace.box().size
        self._random = generator(seed, Stream.EXPLORER)
        self._windows = update_windows(config.planner.horizon)
        self._position = np.zeros(axes)
        self.reset()

    def reset(self) -> None:
        """See Explorer."""
        self._controls = np.zeros((self._planner.horizon, self._position.size))
        self._velocity = np.zeros_like(self._position)
        self._expected_velocity = np.zeros_like(self._position)
        self._commanded = np.zeros_like(self._position)
        # Positions and velocities of the commanded plan, until the state after its first step is observed.
        self._pending = np.empty((2, 0, self._position.size))

    @property
    def planned_states(self) -> np.ndarray:
        """Normalised states (H, D) of the commanded plan; (0, D) before the first command and after `observe`."""
        return self._pending[0].copy()

    def state_dict(self) -> StateDict:
        """See Explorer."""
        return {
            "position": self._position.copy(),
            "velocity": self._velocity.copy(),
            "expected_velocity": self._expected_velocity.copy(),
            "commanded": self._commanded.copy(),
            "controls": self._controls.copy(),
            "pending": self._pending.copy(),
            "generator": generator_state(self._random),
        }

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """See Explorer."""
        expected = {**self.state_dict(), "pending": np.empty((2, 0, self._position.size))}
        arrays = matching_arrays(state, expected)
        self._position, self._velocity = arrays["position"], arrays["velocity"]
        self._expected_velocity, self._commanded = arrays["expected_velocity"], arrays["commanded"]
        self._controls, self._pending = arrays["controls"], arrays["pending"]
        set_generator_state(self._random, arrays["generator"])

    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """Set the start of the next plan; see Explorer.

        The planned velocity is corrected by `measured_velocity_weight` times the difference between measured and
        commanded velocity. A second observation between two commands replaces the first; the plan is shifted once.

        Raises:
            ObservationError: position or velocity is not finite.
        """
        for values in (position, () if measured_velocity is None else measured_velocity):
            if not np.all(np.isfinite(values)):
                raise ObservationError(f"position or velocity {list(values)} is not finite: check tf and the arm")
        self._position = np.array(position, dtype=np.float64)
        if self._pending.size:
            self._controls = np.concatenate([self._controls[1:], np.zeros_like(self._controls[:1])])
            self._expected_velocity = self._pending[1, 0]
            self._pending = self._pending[:, :0]
        correction = np.zeros_like(self._position)
        if measured_velocity is not None:
            error = self.dynamics.from_si(measured_velocity) - self._commanded
            correction = self._planner.measured_velocity_weight * error
        limit = self.dynamics.velocity_limit
        self._velocity = np.clip(self._expected_velocity + correction, -limit, limit)

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> VelocityCommand:
        """Plan, and return the constant velocity that ends the step where the plan does.

        The command never leads out of the workspace; from outside it leads back in.
        """
        plan = self.plan(target, samples)
        self._pending = np.stack([plan.positions, plan.velocities])
        displacement = (plan.positions[0] - self._position) / self.dynamics.gain
        limit = self.dynamics.velocity_limit
        self._commanded = np.clip(displacement / self.dynamics.step, -limit, limit)
        return VelocityCommand.from_array(self.dynamics.to_si(self._commanded), self.dynamics.step)

    def plan(self, target: np.ndarray, samples: WorkspaceSamples) -> Plan:
        """Improve the previous plan for a target distribution (S,) over the samples while its cost J decreases."""
        objective = ErgodicObjective(target, samples, self._barrier)
        best = self._best_of(self._controls[np.newaxis], objective)
        for iteration in range(self._planner.iterations):
            candidates = window_candidates(best.controls, self._updated_controls(best, objective), self._windows)
            if iteration == 0:
                candidates = np.concatenate([candidates, self._random_plans()])
            improved = self._best_of(candidates, objective)
            if improved.cost >= best.cost:
                break
            best = improved
        self._controls = best.controls
        return best

    def _updated_controls(self, plan: Plan, objective: ErgodicObjective) -> np.ndarray:
        """Controls (H, D) after the adjoint update u_t - scale * rho_t / R, clamped to the acceleration limit.

        rho_t = dJ/du_t is the adjoint, R the control weight. The authors normalise h and d by their maxima instead of
        their sums; `objective.scale` reproduces the step size that follows from it, which does not shrink as the
        history grows and takes most controls to their limit.
        """
        rho = self.dynamics.backpropagate(plan.rollout, *objective.gradient(plan.rollout))[0]
        limit = self._planner.acceleration_limit
        return np.clip(plan.controls - objective.scale * rho / self._planner.control_weight, -limit, limit)

    def _random_plans(self) -> np.ndarray:
        planner = self._planner
        shape = (planner.random_candidates, planner.horizon, self._position.size)
        return random_candidates(self._random, shape, planner.acceleration_limit)

    def _best_of(self, candidates: np.ndarray, objective: ErgodicObjective) -> Plan:
        """The cheapest of the plans (B, H, D)."""
        start = np.clip(self._position, -1.0, 1.0)
        rollout = self.dynamics.rollout(start, self._velocity, candidates)
        costs = objective.cost(rollout)
        best = int(np.argmin(costs))
        return Plan(candidates[best], rollout.select(best), float(costs[best]))


def update_windows(horizon: int) -> np.ndarray:
    """Return every window of 1 to MAX_WINDOW steps, then the whole horizon, as (W, horizon) bool."""
    windows = [
        [begin <= t < begin + length for t in range(horizon)]
        for begin in range(horizon)
        for length in range(1, min(MAX_WINDOW, horizon - begin) + 1)
    ]
    return np.array([*windows, [True] * horizon])


def window_candidates(controls: np.ndarray, update: np.ndarray, windows: np.ndarray) -> np.ndarray:
    """Return plans (W, H, D) in which one window of the controls is replaced by the update.

    All steps of a window get the update of its first step, but in the last plan each step gets its own update.

    Args:
        controls: (H, D) controls of the previous plan.
        update: (H, D) updated controls.
        windows: (W, H) bool, see `update_windows`.
    """
    held = update[np.argmax(windows, axis=1)][:, np.newaxis]
    candidates = np.where(windows[..., np.newaxis], held, controls)
    candidates[-1] = update
    return candidates


def random_candidates(random: np.random.Generator, shape: Tuple[int, int, int], limit: float) -> np.ndarray:
    """Return plans (B, H, D) of two random constant controls within +-limit, switched at a random step."""
    count, horizon, axes = shape
    switch = random.integers(1, horizon, (count, 1))
    first, second = random.uniform(-limit, limit, (2, count, 1, axes))
    return np.where((np.arange(horizon) < switch)[..., np.newaxis], first, second)
