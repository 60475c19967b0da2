"""The planar workspace, and the one conversion between SI units and the normalised states that the library works in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from embodied_active_learning.errors import ConfigError

STATE_NAMES = ("x", "y", "theta")


@dataclass(frozen=True)
class Workspace:
    """A box of planar states (x [m], y [m], theta [rad]) in the base frame; normalised states lie in [-1, 1]."""

    lower: Tuple[float, ...] = (0.325, -0.15, -2.0)
    upper: Tuple[float, ...] = (0.625, 0.15, 2.0)

    def __post_init__(self) -> None:
        """Refuse limits that are not finite or not in order, by name."""
        for name, low, high in zip(STATE_NAMES, self.lower, self.upper):
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ConfigError(f"workspace/{name} is [{low}, {high}]: give a finite lower limit below the upper one")

    @property
    def size(self) -> int:
        """Number of state dimensions."""
        return len(self.lower)

    @property
    def centre(self) -> np.ndarray:
        """(D,) middle of the box, SI units."""
        return (np.asarray(self.upper) + np.asarray(self.lower)) / 2.0

    @property
    def scale(self) -> np.ndarray:
        """(D,) SI units per normalised unit: half the extent of the box."""
        return (np.asarray(self.upper) - np.asarray(self.lower)) / 2.0

    def normalise(self, states: np.ndarray) -> np.ndarray:
        """States in SI units (..., D) -> normalised states (..., D)."""
        return (np.asarray(states, dtype=np.float64) - self.centre) / self.scale

    def denormalise(self, states: np.ndarray) -> np.ndarray:
        """Normalised states (..., D) -> states in SI units (..., D)."""
        return np.asarray(states, dtype=np.float64) * self.scale + self.centre

    def contains(self, states: np.ndarray, tolerance: float = 0.0) -> np.ndarray:
        """Whether SI states (..., D) lie in the box, widened by tolerance (normalised units) -> (...).

        NaN is outside.
        """
        return np.all(np.abs(self.normalise(states)) <= 1.0 + tolerance, axis=-1)

    def clip(self, states: np.ndarray) -> np.ndarray:
        """SI states (..., D) moved to the nearest point of the box."""
        return np.clip(states, self.lower, self.upper)
