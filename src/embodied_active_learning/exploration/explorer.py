"""The interface of explorers. Register an implementation in `embodied_active_learning.registry.EXPLORERS`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Mapping, Optional

import numpy as np

from embodied_active_learning.exploration.commands import Command
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.state_dict import StateDict


class Explorer(ABC):
    """Chooses the next motion. Constructed as `Class(config, seed)` from the run's Config and the seed of its draws.

    In each step, `observe` the reached state, then ask for `next_command`.

    Explorers are compared by the KL-ergodic measure of the states they visit, which is computed outside of them.
    """

    @abstractmethod
    def observe(self, position: np.ndarray, measured_velocity: Optional[np.ndarray] = None) -> None:
        """Report where the arm is.

        Args:
            position: (D,) state, normalised to [-1, 1].
            measured_velocity: (D,) [m/s, m/s, rad/s], not normalised; None if unknown.
        """

    @abstractmethod
    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> Command:
        """Return the next motion for a target distribution (S,) over the workspace samples."""

    def set_open_places(self, places: np.ndarray) -> None:  # noqa: B027 - most explorers have no use for it
        """Set the places (P, 2) [m] about which an identification needs more views; ignored by default."""

    @abstractmethod
    def reset(self) -> None:
        """Discard plan and velocity after the arm was stopped from outside."""

    @abstractmethod
    def state_dict(self) -> StateDict:
        """Return copies of everything that determines the next commands."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue exactly like the explorer that returned this state.

        Raises:
            CorruptFileError: the state does not fit; the explorer is unchanged.
        """

    @property
    @abstractmethod
    def planned_states(self) -> np.ndarray:
        """Normalised states (H, D) predicted for the last command and its continuation; (0, D) without a plan."""
