"""Commands that an explorer gives to the arm, in SI units and the base frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np


@dataclass(frozen=True)
class VelocityCommand:
    """Hold a planar velocity for a duration."""

    vx: float  # m/s
    vy: float  # m/s
    omega: float  # rad/s
    duration: float  # s

    @classmethod
    def from_array(cls, velocity: np.ndarray, duration: float) -> VelocityCommand:
        """Build a command from a velocity (3,) [m/s, m/s, rad/s] and a duration [s]."""
        vx, vy, omega = map(float, velocity)
        return cls(vx, vy, omega, duration)

    @property
    def velocity(self) -> np.ndarray:
        """Velocity (3,) [m/s, m/s, rad/s]."""
        return np.array([self.vx, self.vy, self.omega])


@dataclass(frozen=True)
class PoseCommand:
    """Go to a planar pose and stop there."""

    x: float  # m
    y: float  # m
    theta: float  # rad

    @classmethod
    def from_array(cls, state: np.ndarray) -> PoseCommand:
        """Build a command from a state (3,) [m, m, rad]."""
        x, y, theta = map(float, state)
        return cls(x, y, theta)

    @property
    def state(self) -> np.ndarray:
        """State (3,) [m, m, rad]."""
        return np.array([self.x, self.y, self.theta])


Command = Union[VelocityCommand, PoseCommand]
