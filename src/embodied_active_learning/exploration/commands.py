"""What an explorer asks of the arm, in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np


@dataclass(frozen=True)
class VelocityCommand:
    """Hold this planar velocity in the base frame for a duration."""

    vx: float  # m/s
    vy: float  # m/s
    omega: float  # rad/s
    duration: float  # s

    @property
    def velocity(self) -> np.ndarray:
        """(3,) m/s, m/s, rad/s."""
        return np.array([self.vx, self.vy, self.omega])


@dataclass(frozen=True)
class PoseCommand:
    """Go to this planar pose in the base frame and stop there."""

    x: float  # m
    y: float  # m
    theta: float  # rad


Command = Union[VelocityCommand, PoseCommand]
