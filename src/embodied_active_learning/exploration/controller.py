"""Receding-horizon KL-ergodic control (paper, Sec. 2.3; docs/method.md, section 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.exploration.barrier import Barrier
from embodied_active_learning.exploration.candidates import random_candidates, update_windows, window_candidates
from embodied_active_learning.exploration.commands import VelocityCommand
from embodied_active_learning.exploration.dynamics import DoubleIntegrator, Rollout
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.exploration.memory import Memory, recall
from embodied_active_learning.exploration.objective import ErgodicObjective
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.rng import Stream, generator, generator_state, set_generator_state


@dataclass(frozen=True)
class Plan:
    """Controls over the horizon and the states they lead to."""

    controls: np.ndarray  # (H, D) velocity units per second
    rollout: Rollout  # the one motion that the controls lead to
    cost: float  # J, nats

    @property
    def positions(self) -> np.ndarray:
        """(H, D) normalised, after each step."""
        return self.rollout.positions[0]

    @property
    def velocities(self) -> np.ndarray:
        """(H, D) velocity units, after each step."""
        return self.rollout.velocities[0]


class ErgodicController(Explorer):
    """Plans motion whose time average matches a target distribution, and commands the first step of each plan."""

    def __init__(self, config: Config, seed: int) -> None:
        """Build a controller that believes to rest in the middle of the workspace until it is told by observe()."""
        self.dynamics = DoubleIntegrator.from_config(config)
        self._barrier = Barrier.from_config(config)
        self._planner = config.planner
        axes = config.workspace.box().size
        self._random = generator(seed, Stream.EXPLORER)
        self._windows = update_windows(config.planner.horizon)
        self._position = np.zeros(axes)
        self.reset()

    def reset(self) -> None:
        """Forget plan and velocity: the arm was stopped, whatever had been planned."""
        self._controls = np.zeros((self._planner.horizon, self._position.size))
        self._velocity = np.zeros_like(self._position)
        self._expected_velocity = np.zeros_like(self._position)
        self._commanded = np.zeros_like(self._position)
        # Positions and velocities of the plan whose first step was commanded and not yet observed.
        self._under_way = np.empty((2, 0, self._position.size))

    @property
    def planned_states(self) -> np.ndarray:
        """(H, D) normalised states of the plan whose first step was commanded; (0, D) before that."""
        return self._under_way[0].copy()

    def memory(self) -> Memory:
        """See Explorer."""
        return {
            "position": self._position.copy(),
            "velocity": self._velocity.copy(),
            "expected_velocity": self._expected_velocity.copy(),
            "commanded": self._commanded.copy(),
            "controls": self._controls.copy(),
            "under_way": self._under_way.copy(),
            "generator": generator_state(self._random),
        }

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """See Explorer."""
        like = {**self.memory(), "under_way": np.empty((2, 0, self._position.size))}
        recalled = recall(memory, like)
        self._position, self._velocity = recalled["position"], recalled["velocity"]
        self._expected_velocity, self._commanded = recalled["expected_velocity"], recalled["commanded"]
        self._controls, self._under_way = recalled["controls"], recalled["under_way"]
        set_generator_state(self._random, recalled["generator"])

    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """Re-anchor the plan. position: (D,) normalised; measured_velocity: (D,) m/s, m/s, rad/s, None if unknown.

        The plan's velocity takes over measured_velocity_weight of the difference between measured and commanded one.
        Observing twice between two commands corrects the first observation, it does not move the plan on.
        """
        for values in (position, () if measured_velocity is None else measured_velocity):
            if not np.all(np.isfinite(values)):
                raise ObservationError(
                    f"observed position or velocity {list(values)} is not finite: check tf and the arm"
                )
        self._position = np.array(position, dtype=np.float64)
        if self._under_way.size:
            self._controls = np.concatenate([self._controls[1:], np.zeros_like(self._controls[:1])])
            self._expected_velocity = self._under_way[1, 0]
            self._under_way = self._under_way[:, :0]
        correction = np.zeros_like(self._position)
        if measured_velocity is not None:
            error = self.dynamics.from_si(measured_velocity) - self._commanded
            correction = self._planner.measured_velocity_weight * error
        limit = self.dynamics.velocity_limit
        self._velocity = np.clip(self._expected_velocity + correction, -limit, limit)

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> VelocityCommand:
        """Plan, and command the plan's first step: a constant velocity that ends the step where the plan does.

        From a position in the workspace it never leads out of it; from outside it leads back.
        """
        plan = self.plan(target, samples)
        self._under_way = np.stack([plan.positions, plan.velocities])
        way = (plan.positions[0] - self._position) / self.dynamics.gain
        limit = self.dynamics.velocity_limit
        self._commanded = np.clip(way / self.dynamics.step, -limit, limit)
        return VelocityCommand(*self.dynamics.to_si(self._commanded).tolist(), duration=self.dynamics.step)

    def plan(self, target: np.ndarray, samples: WorkspaceSamples) -> Plan:
        """Improve the previous plan for a target distribution (S,) over the samples, as long as J falls."""
        objective = ErgodicObjective(target, samples, self._barrier)
        best = self._best_of(self._controls[np.newaxis], objective)
        for iteration in range(self._planner.iterations):
            candidates = window_candidates(best.controls, self._update(best, objective), self._windows)
            if iteration == 0:
                candidates = np.concatenate([candidates, self._random_plans()])
            improved = self._best_of(candidates, objective)
            if improved.cost >= best.cost:
                break
            best = improved
        self._controls = best.controls
        return best

    def _update(self, plan: Plan, objective: ErgodicObjective) -> np.ndarray:
        """The plan's controls after the adjoint update u - scale * rho / R, within their limit, (H, D).

        rho is the gradient of J, which sums over steps and not over seconds, by the control of each step: that is the
        authors' adjoint too. The scale is theirs as well, as they divide target and visitation by their largest values
        instead of their sums: it keeps the update of one size however long the history is, and so large that most
        controls reach their limit.
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
