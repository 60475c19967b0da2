"""The planar workspace, and the conversion between SI units and the normalised states of the library."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence, Tuple, Union

import numpy as np

from embodied_active_learning.errors import ConfigError

STATE_NAMES = ("x", "y", "theta")
States = Union[np.ndarray, Sequence[float]]
_FULL_TURNS = np.array([[0.0, 0.0, turn] for turn in (0.0, -2.0 * np.pi, 2.0 * np.pi)])


@dataclass(frozen=True)
class Workspace:
    """A box of planar states (x [m], y [m], theta [rad]) in the base frame; normalised states lie in [-1, 1]."""

    lower: Tuple[float, ...] = (0.325, -0.15, -2.0)
    upper: Tuple[float, ...] = (0.625, 0.15, 2.0)

    def __post_init__(self) -> None:
        """Check that limits are finite and in order."""
        for name, low, high in zip(STATE_NAMES, self.lower, self.upper):
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ConfigError(
                    f"workspace/{name} is [{low}, {high}]: expected a finite lower limit below the upper one"
                )

    @property
    def size(self) -> int:
        """Number of state dimensions D."""
        return len(self.lower)

    @property
    def centre(self) -> np.ndarray:
        """Centre of the box. (D,) SI units."""
        return (np.asarray(self.upper) + np.asarray(self.lower)) / 2.0

    @property
    def scale(self) -> np.ndarray:
        """SI units per normalised unit: half the extent of the box. (D,)."""
        return (np.asarray(self.upper) - np.asarray(self.lower)) / 2.0

    def normalise(self, states: States) -> np.ndarray:
        """Convert states from SI units to normalised units. (..., D) -> (..., D)."""
        return (np.asarray(states, dtype=np.float64) - self.centre) / self.scale

    def denormalise(self, states: States) -> np.ndarray:
        """Convert states from normalised units to SI units. (..., D) -> (..., D)."""
        return np.asarray(states, dtype=np.float64) * self.scale + self.centre

    def contains(self, states: States, tolerance: float = 0.0) -> np.ndarray:
        """Return whether states lie in the box. NaN is outside.

        Args:
            states: (..., D) SI units.
            tolerance: Extension of the box on each side, normalised units.

        Returns:
            (...) booleans.
        """
        return np.all(np.abs(self.normalise(states)) <= 1.0 + tolerance, axis=-1)

    def nearest(self, states: States) -> np.ndarray:
        """Like clip, but a yaw may first change by a full turn, which is the same pose. (..., 3) -> (..., 3)."""
        turned = np.asarray(states, dtype=np.float64)[..., np.newaxis, :] + _FULL_TURNS
        clipped = self.clip(turned)
        best = np.abs(clipped - turned)[..., 2].argmin(axis=-1)[..., np.newaxis, np.newaxis]
        return np.take_along_axis(clipped, best, axis=-2)[..., 0, :]

    def clip(self, states: States) -> np.ndarray:
        """Move states to the nearest point of the box. (..., D) SI units -> (..., D)."""
        return np.clip(states, self.lower, self.upper)
