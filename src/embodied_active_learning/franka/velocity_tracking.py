"""Velocities of the end effector that make an arm with velocity service follow the driver's set-points."""

from __future__ import annotations

import math
from typing import Callable, List, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.franka.motions import Brake
from embodied_active_learning.franka.mount import CameraMount
from embodied_active_learning.franka.set_point_driver import SetPointDriver
from embodied_active_learning.franka.set_points import MAX_PERIOD, Tracking, level_limits
from embodied_active_learning.franka.velocity_readiness import VelocityReadiness, why_not_ready
from embodied_active_learning.motion_limits import MIN_PERIOD, MotionLimits

GAIN = 2.0
"""1/s: velocity per distance from the set-point. With a delay of 0.1 s in the loop, well damped."""
_UNBOUNDED = (math.inf, math.inf, math.inf)
_ZERO = (0.0, 0.0, 0.0)

Twist = Tuple[Tuple[float, ...], Tuple[float, ...]]
"""Linear (3,) m/s and angular (3,) rad/s velocity of the end effector in the base frame."""
REST: Twist = (_ZERO, _ZERO)


def velocity_driver(config: Config, clock: Callable[[], float]) -> SetPointDriver:
    """Return a driver whose set-points a VelocityTracker follows. clock: returns the time [s]."""
    # Stop by braking: a velocity towards the measured pose, which is late, would hardly decay.
    return SetPointDriver(config, clock, VelocityReadiness(config.franka, clock), why_not_ready, Brake)


class VelocityTracker:
    """Adds feedback on the measured pose to the set-point's velocity, within the limits of speed and acceleration.

    The workspace is enforced on the set-points, which the arm trails. Height and tilt are held by feedback.
    """

    def __init__(self, config: Config) -> None:
        lower = [-bound for bound in _UNBOUNDED]
        self._mount = CameraMount.from_config(config)
        self._limits = MotionLimits.from_config(config).with_box(lower, _UNBOUNDED)
        self._level_limits = level_limits().with_box(lower, _UNBOUNDED)
        self.reset()

    def reset(self) -> None:
        """Start from rest."""
        self._planar: Sequence[float] = _ZERO
        self._level: Sequence[float] = _ZERO

    def twist(self, tracking: Tracking, period: float) -> Twist:
        """Return the velocity of the end effector for the next period [s]."""
        period = min(max(period, MIN_PERIOD), MAX_PERIOD)
        set_point, measured = tracking.set_point, tracking.measured
        requested = _with_feedback(tracking.velocity, set_point.planar, measured.planar)
        self._planar = self._limits.next_velocity(measured.planar, self._planar, requested, period).velocity
        level_at, level_to = (measured.height, *measured.tilt), (set_point.height, *set_point.tilt)
        requested = _with_feedback(_ZERO, level_to, level_at)
        self._level = self._level_limits.next_velocity(level_at, self._level, requested, period).velocity
        camera: np.ndarray = np.array([self._planar[0], self._planar[1], self._level[0]])
        angular: np.ndarray = np.array([self._level[1], self._level[2], self._planar[2]])
        _, rotation = self._mount.end_effector(measured)
        linear = camera - np.cross(angular, rotation @ self._mount.position)
        return tuple(linear.tolist()), tuple(angular.tolist())


def _with_feedback(velocity: Sequence[float], target: Sequence[float], at: Sequence[float]) -> List[float]:
    return [speed + GAIN * (goal - here) for speed, goal, here in zip(velocity, target, at)]
