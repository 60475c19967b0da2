"""The exploring half of the paper's Algorithm 1, without robot or ROS: observe, assess, choose the next command."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Mapping, Optional

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.exploration.commands import Command, VelocityCommand
from embodied_active_learning.exploration.explorers import make_explorer
from embodied_active_learning.exploration.memory import Memory, as_part, part, recall
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.exploration.target import (
    flat_distribution,
    kl_ergodic,
    normalise,
    target_distribution,
)
from embodied_active_learning.rng import resumed_seed


@dataclass(frozen=True)
class Assessment:
    """How one step stands: the target, what the trajectory has covered of it, and what that has cost."""

    step: int
    target: np.ndarray  # (S,) h(s), sum 1
    time_average: np.ndarray  # (S,) d(s) of the visited states, sum 1
    coverage: float  # k
    ergodic_measure: float  # D_KL(h || d) [nat], without planned states
    distance: float  # [m]
    turning: float  # [rad]
    effort: float  # integral of the squared normalised acceleration [1/s^3]; NaN for poses without a velocity


class ExplorationRun:
    """Holds everything that an explorer knows, for one run. States go in and commands come out in SI units."""

    def __init__(self, config: Config, trajectory: Optional[np.ndarray] = None, effort: float = 0.0) -> None:
        """Begin, or go on after a trajectory (N, 3) [m, m, rad] and the effort it took."""
        self._workspace = config.workspace.box()
        visited = np.empty((0, self._workspace.size)) if trajectory is None else np.asarray(trajectory)
        seed = resumed_seed(config.exploration.seed, len(visited))
        exploration = replace(config.exploration, seed=seed)
        config = replace(config, exploration=exploration)
        self._samples = WorkspaceSamples(config, self._workspace.normalise(visited))
        self._explorer = make_explorer(exploration.explorer, config, seed)
        self._step_duration = exploration.step_duration
        self._step = len(visited)
        self._state: Optional[np.ndarray] = visited[-1] if len(visited) else None
        changes = np.diff(visited, axis=0)
        self._distance = float(np.sum(np.hypot(changes[:, 0], changes[:, 1])))
        self._turning = float(np.sum(np.abs(changes[:, 2])))
        self._effort = effort
        self._velocity = np.zeros(self._workspace.size)
        self._target = flat_distribution(config.exploration.samples)

    @property
    def step(self) -> int:
        """Observations so far."""
        return self._step

    @property
    def sample_states(self) -> np.ndarray:
        """(S, 3) the workspace samples of this step, SI units."""
        return self._workspace.denormalise(self._samples.states)

    @property
    def planned_states(self) -> np.ndarray:
        """(H, 3) the states that the explorer means to visit next, SI units; empty when it does not plan."""
        return self._workspace.denormalise(self._explorer.planned_states)

    @property
    def travelled_states(self) -> np.ndarray:
        """(N, 3) the visited states, SI units."""
        return self._workspace.denormalise(self._samples.visited)

    def observe(self, state: np.ndarray, velocity: np.ndarray) -> None:
        """Count one observation from a state (3,) with measured velocity (3,), SI units, and draw fresh samples."""
        if self._state is not None:
            change = state - self._state
            self._distance += float(np.hypot(change[0], change[1]))
            self._turning += float(abs(change[2]))
        self._state = state
        self._step += 1
        normalised = self._workspace.normalise(state)
        self._samples.visit(normalised)
        self._samples.refresh()
        self._explorer.observe(normalised, velocity)

    def assess(self, log_std: Optional[np.ndarray]) -> Assessment:
        """Set the target from the model's log standard deviation (S,) at the samples; None: nothing learned, flat."""
        coverage = self._samples.coverage
        visitation = self._samples.visitation
        if log_std is None:
            self._target = flat_distribution(len(visitation))
        else:
            self._target = target_distribution(log_std, coverage)
        return Assessment(
            self._step,
            self._target,
            normalise(visitation),
            coverage,
            kl_ergodic(self._target, visitation),
            self._distance,
            self._turning,
            self._effort,
        )

    def memory(self) -> Memory:
        """Copies of everything but the visited states that decides what it does next."""
        state = np.full(self._workspace.size, np.nan) if self._state is None else self._state
        own = {
            "step": np.array([self._step]),
            "state": np.array(state, dtype=np.float64),
            "velocity": np.array(self._velocity, dtype=np.float64),
            "sums": np.array([self._distance, self._turning, self._effort]),
            "target": np.array(self._target, dtype=np.float64),
        }
        return {
            **own,
            **as_part("samples", self._samples.memory()),
            **as_part("explorer", self._explorer.memory()),
        }

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Go on, after the same trajectory, exactly as the run did whose memory this is.

        Raises CorruptFileError when it is of another trajectory or configuration; the run is of no use then.
        """
        own = recall(memory, {name: array for name, array in self.memory().items() if "/" not in name})
        if int(own["step"][0]) != self._step:
            raise CorruptFileError(
                f"the planner's memory is of step {int(own['step'][0])}, the trajectory of step {self._step}"
            )
        self._samples.recall(part(memory, "samples"))
        self._explorer.recall(part(memory, "explorer"))
        self._state = own["state"] if self._step else None
        self._velocity, self._target = own["velocity"], own["target"]
        self._distance, self._turning, self._effort = own["sums"].tolist()

    def interrupt(self) -> None:
        """Tell the explorer that the arm was stopped: its plan and its idea of the velocity no longer hold."""
        self._explorer.reset()
        self._velocity = np.zeros(self._workspace.size)

    def next_command(self) -> Command:
        """What the arm should do next, for the target that was assessed last."""
        command = self._explorer.next_command(self._target, self._samples)
        if isinstance(command, VelocityCommand):
            acceleration = (command.velocity - self._velocity) / self._workspace.scale / self._step_duration
            self._effort += float(acceleration @ acceleration) * self._step_duration
            self._velocity = command.velocity
        else:
            self._effort = float("nan")
        return command
