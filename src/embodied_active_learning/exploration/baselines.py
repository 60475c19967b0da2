"""Explorers for comparison with ergodic control; none of them uses the target."""

from __future__ import annotations

from typing import Mapping, Optional

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.commands import PoseCommand, VelocityCommand
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.dynamics import DoubleIntegrator
from embodied_active_learning.exploration.ergodic_objective import uniform_distribution
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.rng import Stream, generator, generator_state, set_generator_state
from embodied_active_learning.state_dict import StateDict, matching_arrays

MAX_DRAWS = 10  # random velocities tried before the random walk heads for a random state
BORDER = 0.05  # distance that the random walk keeps from the limits, normalised


class UniformErgodicExplorer(ErgodicController):
    """Ergodic control of a uniform target: covers the workspace evenly, whatever the model has learned."""

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> VelocityCommand:
        """See Explorer."""
        return super().next_command(uniform_distribution(len(target)), samples)


class RandomWalkExplorer(Explorer):
    """Random walk v+ = (v + U(-limit, limit)) / 2; near a limit it heads for a random state.

    Predicted steps use the gain of the arm; the authors leave it out here.
    """

    def __init__(self, config: Config, seed: int) -> None:
        """Start at rest in the middle of the workspace."""
        self._dynamics = DoubleIntegrator.from_config(config)
        self._random = generator(seed, Stream.EXPLORER)
        self._position = np.zeros(config.workspace.box().size)
        self.reset()

    def reset(self) -> None:
        """See Explorer."""
        self._velocity = np.zeros_like(self._position)

    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """See Explorer; the measured velocity is not used."""
        self._position = np.array(position, dtype=np.float64)

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> VelocityCommand:
        """See Explorer."""
        self._velocity = self._draw_velocity()
        return VelocityCommand.from_array(self._dynamics.to_si(self._velocity), self._dynamics.step)

    def state_dict(self) -> StateDict:
        """See Explorer."""
        return {
            "position": self._position.copy(),
            "velocity": self._velocity.copy(),
            "generator": generator_state(self._random),
        }

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """See Explorer."""
        arrays = matching_arrays(state, self.state_dict())
        self._position, self._velocity = arrays["position"], arrays["velocity"]
        set_generator_state(self._random, arrays["generator"])

    @property
    def planned_states(self) -> np.ndarray:
        """Empty, (0, D): this explorer does not plan."""
        return np.empty((0, self._position.size))

    def _draw_velocity(self) -> np.ndarray:
        limit, step = self._dynamics.velocity_limit, self._dynamics.step * self._dynamics.gain
        for _ in range(MAX_DRAWS):
            velocity = 0.5 * (self._velocity + self._random.uniform(-limit, limit))
            if np.all(np.abs(self._position + step * velocity) <= 1.0 - BORDER):
                return velocity
        goal = self._random.uniform(-1.0, 1.0, limit.size)
        return np.clip((goal - self._position) / step, -limit, limit)


class UniformExplorer(Explorer):
    """Poses drawn uniformly from the workspace: independent samples at the price of long paths."""

    def __init__(self, config: Config, seed: int) -> None:
        """Start the random stream; this explorer has no other state."""
        self._workspace = config.workspace.box()
        self._random = generator(seed, Stream.EXPLORER)

    def reset(self) -> None:
        """See Explorer; nothing to discard."""

    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """See Explorer; the state is not used."""

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> PoseCommand:
        """See Explorer."""
        state = self._random.uniform(-1.0, 1.0, self._workspace.size)
        return PoseCommand.from_array(self._workspace.clip(self._workspace.denormalise(state)))

    def state_dict(self) -> StateDict:
        """See Explorer."""
        return {"generator": generator_state(self._random)}

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """See Explorer."""
        set_generator_state(self._random, matching_arrays(state, self.state_dict())["generator"])

    @property
    def planned_states(self) -> np.ndarray:
        """Empty, (0, D): this explorer does not plan."""
        return np.empty((0, self._workspace.size))
