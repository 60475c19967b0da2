"""What every way of exploring can be asked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Mapping, Optional

import numpy as np

from embodied_active_learning.exploration.commands import Command
from embodied_active_learning.exploration.memory import Memory
from embodied_active_learning.exploration.samples import WorkspaceSamples


class Explorer(ABC):
    """Decides the next motion. Each step: observe() where the arm is, then next_command().

    All are compared by one measure taken outside: kl_ergodic(target, samples.visitation) over the visited states.
    """

    @abstractmethod
    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """Say where the arm is. position: (D,) normalised; measured_velocity: (D,) m/s, m/s, rad/s, None if unknown."""

    @abstractmethod
    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> Command:
        """The next motion for a target distribution (S,) over the samples, in SI units."""

    @abstractmethod
    def reset(self) -> None:
        """Forget what was under way: the arm was stopped."""

    @abstractmethod
    def memory(self) -> Memory:
        """Copies of everything that decides what it does next."""

    @abstractmethod
    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Go on as the one did whose memory this is.

        Raises CorruptFileError when it does not fit; then nothing is changed.
        """

    @property
    @abstractmethod
    def planned_states(self) -> np.ndarray:
        """(H, D) normalised states that the last command begins; (0, D) when there is no plan."""
