"""Receding-horizon KL-ergodic control (paper, Sec. 2.3; algorithm.md, section 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.exploration.barrier import Barrier
from embodied_active_learning.exploration.candidates import random_candidates, update_windows, window_candidates
from embodied_active_learning.exploration.commands import VelocityCommand
from embodied_active_learning.exploration.dynamics import DoubleIntegrator, Rollout
from embodied_active_learning.exploration.objective import ErgodicObjective
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.exploration.streams import Stream, generator


@dataclass(frozen=True)
class Plan:
    """Controls over the horizon and the states they lead to."""

    controls: np.ndarray  # (H, D) velocity units per second
    positions: np.ndarray  # (H, D) normalised, after each step
    velocities: np.ndarray  # (H, D) velocity units, after each step
    cost: float  # J, nats


class ErgodicController:
    """Plans motion whose time average matches a target distribution, and turns the plan's first step into a command."""

    def __init__(self, config: Config, seed: int) -> None:
        """Build a controller at rest in the middle of the workspace; tell it where it is with observe()."""
        self.dynamics = DoubleIntegrator.from_config(config)
        self._barrier = Barrier.from_config(config)
        self._planner = config.planner
        self._random = generator(seed, Stream.EXPLORER)
        self._windows = update_windows(config.planner.horizon)
        self._axes = config.workspace.box().size
        self._measured = np.zeros(self._axes)
        self._velocity = np.zeros(self._axes)
        self._commanded = np.zeros(self._axes)
        self._controls = np.zeros((config.planner.horizon, self._axes))
        self._plan: Optional[Plan] = None
