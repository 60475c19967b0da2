"""The barrier that keeps plans away from the limits before the clamp has to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from embodied_active_learning.config import Config


@dataclass(frozen=True)
class Barrier:
    """b(x) = weight * sum max(0, |x| - (limit - margin))^power over positions and velocities (paper, Sec. 2.3).

    Soft: at the default weight it is 0.0005 at the limit itself. What must not be crossed is the clamp of the dynamics.
    """

    weight: float
    power: float
    position_begin: float  # normalised
    velocity_begin: np.ndarray  # (D,) velocity units

    @classmethod
    def from_config(cls, config: Config) -> Barrier:
        """The configured barrier; the margin holds for positions and velocities alike, as the authors have it."""
        planner = config.planner
        velocity_begin = np.maximum(np.asarray(planner.velocity_limits) - planner.barrier_margin, 0.0)
        return cls(planner.barrier_weight, planner.barrier_power, 1.0 - planner.barrier_margin, velocity_begin)

    def cost(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """Sum over the steps of each plan. (..., H, D) each -> (...)."""
        excess = self._excess(positions, self.position_begin) ** self.power
        excess += self._excess(velocities, self.velocity_begin) ** self.power
        return self.weight * np.sum(excess, axis=(-2, -1))

    def gradient(self, positions: np.ndarray, velocities: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Gradient of the cost by positions and by velocities, (..., H, D) each."""
        return self._slope(positions, self.position_begin), self._slope(velocities, self.velocity_begin)

    def _slope(self, values: np.ndarray, begin: np.ndarray) -> np.ndarray:
        excess = self._excess(values, begin)
        # power 1 would make 0^0 = 1 where there is no excess
        slope = np.where(excess > 0.0, excess ** (self.power - 1.0), 0.0)
        return self.weight * self.power * np.sign(values) * slope

    @staticmethod
    def _excess(values: np.ndarray, begin: np.ndarray) -> np.ndarray:
        return np.maximum(np.abs(values) - begin, 0.0)
