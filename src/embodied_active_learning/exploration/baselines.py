"""The explorers that ergodic control is compared with (docs/method.md, section 7). They ignore the target."""

from __future__ import annotations

from typing import Mapping, Optional

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.commands import PoseCommand, VelocityCommand
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.dynamics import DoubleIntegrator
from embodied_active_learning.exploration.explorer import Explorer
from embodied_active_learning.exploration.memory import Memory, recall
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.exploration.target import flat_distribution
from embodied_active_learning.rng import Stream, generator, generator_state, set_generator_state

DRAWS = 10  # velocities tried before the random walk heads for a random state instead
BORDER = 0.05  # distance from the limits that the random walk keeps, normalised


class UniformErgodicExplorer(ErgodicController):
    """Ergodic control of a flat target: covers the workspace evenly, whatever the model has learned."""

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> VelocityCommand:
        """See Explorer."""
        return super().next_command(flat_distribution(len(target)), samples)


class RandomWalkExplorer(Explorer):
    """A velocity that forgets half of itself at each step; next to a limit it heads for a random state.

    The step predicted is the arm's own. The authors leave the gain of the dynamics out there.
    """

    def __init__(self, config: Config, seed: int) -> None:
        """Begin at rest in the middle of the workspace."""
        self._dynamics = DoubleIntegrator.from_config(config)
        self._random = generator(seed, Stream.EXPLORER)
        self._position = np.zeros(config.workspace.box().size)
        self.reset()

    def reset(self) -> None:
        """See Explorer."""
        self._velocity = np.zeros_like(self._position)

    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """See Explorer; the walk goes on with the velocity it commanded."""
        self._position = np.array(position, dtype=np.float64)

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> VelocityCommand:
        """See Explorer."""
        self._velocity = self._draw_velocity()
        return VelocityCommand(*self._dynamics.to_si(self._velocity).tolist(), duration=self._dynamics.step)

    def memory(self) -> Memory:
        """See Explorer."""
        return {
            "position": self._position.copy(),
            "velocity": self._velocity.copy(),
            "generator": generator_state(self._random),
        }

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """See Explorer."""
        recalled = recall(memory, self.memory())
        self._position, self._velocity = recalled["position"], recalled["velocity"]
        set_generator_state(self._random, recalled["generator"])

    @property
    def planned_states(self) -> np.ndarray:
        """None: (0, D)."""
        return np.empty((0, self._position.size))

    def _draw_velocity(self) -> np.ndarray:
        limit, step = self._dynamics.velocity_limit, self._dynamics.step * self._dynamics.gain
        for _ in range(DRAWS):
            velocity = 0.5 * (self._velocity + self._random.uniform(-limit, limit))
            if np.all(np.abs(self._position + step * velocity) <= 1.0 - BORDER):
                return velocity
        goal = self._random.uniform(-1.0, 1.0, limit.size)
        return np.clip((goal - self._position) / step, -limit, limit)


class UniformExplorer(Explorer):
    """Poses drawn uniformly from the workspace, one after another: independent samples, at the price of long ways."""

    def __init__(self, config: Config, seed: int) -> None:
        """Nothing is remembered but the generator."""
        self._workspace = config.workspace.box()
        self._random = generator(seed, Stream.EXPLORER)

    def reset(self) -> None:
        """See Explorer; there is nothing to forget."""

    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """See Explorer; where the arm is makes no difference."""

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> PoseCommand:
        """See Explorer."""
        state = self._random.uniform(-1.0, 1.0, self._workspace.size)
        return PoseCommand(*self._workspace.clip(self._workspace.denormalise(state)).tolist())

    def memory(self) -> Memory:
        """See Explorer."""
        return {"generator": generator_state(self._random)}

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """See Explorer."""
        set_generator_state(self._random, recall(memory, self.memory())["generator"])

    @property
    def planned_states(self) -> np.ndarray:
        """None: (0, D)."""
        return np.empty((0, self._workspace.size))
