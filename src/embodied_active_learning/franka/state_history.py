"""History of the robot's measured poses: velocity by differences, and detection of jumps."""

from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.mount import CameraPose

_FILTER_TIME = 0.05
"""Time constant of the low-pass on differenced poses, s: a few states at 100 Hz, one or two at 30 Hz."""
_MIN_PERIOD = 0.004
"""Poses closer in time than this, s, are not differenced: jitter of the stamps would become velocity."""
_VELOCITY_KNOWN_AFTER = 2.0 * _FILTER_TIME
"""s of continuous poses after which a velocity of zero means rest."""
_JUMP_FACTOR, _JUMP_SLACK, _JUMP_TURN_SLACK = 2.0, 0.01, 0.1  # -, m, rad
"""A jump exceeds the slack plus this multiple of what the speed limits allow."""


class StateHistory:
    """Follows the poses in the order of their stamps; a jump restarts it, at rest until the next pose.

    The velocity is differenced because O_dP_EE_c is the commanded one, which a torque controller does not set.
    """

    def __init__(self, config: Config) -> None:
        self._max_speed = config.arm.max_speed
        self._max_turn_rate = config.arm.max_turn_rate
        self._max_period = config.franka.state_max_age
        self._middle = float(config.workspace.box().centre[2])
        self._pose: Optional[CameraPose] = None
        self._stamp = 0.0
        self._base: Tuple[float, Sequence[float]] = (0.0, ())  # stamp and pose that the next one is differenced from
        self._velocity = (0.0, 0.0, 0.0)
        self._continuous_since = 0.0  # stamp

    @property
    def pose(self) -> Optional[CameraPose]:
        """The newest pose; its yaw is unwrapped, so that it continues beyond pi."""
        return self._pose

    @property
    def velocity(self) -> Tuple[float, float, float]:
        """m/s, m/s, rad/s in the base frame."""
        return self._velocity

    @property
    def is_velocity_known(self) -> bool:
        """Whether poses have been continuous for long enough that a velocity of zero means rest."""
        return self._pose is not None and self._stamp >= self._continuous_since + _VELOCITY_KNOWN_AFTER

    def is_new(self, stamp: float) -> bool:
        """Whether a state's stamp [s] differs from the newest; the same state may arrive repeatedly."""
        return self._pose is None or stamp != self._stamp

    def add(self, stamp: float, pose: CameraPose) -> None:
        """Add a pose with its stamp [s].

        Raises ObservationError if the arm cannot have moved there since the last pose; the pose is adopted anyway.
        """
        last, elapsed = self._pose, stamp - self._stamp
        near = self._middle if last is None else last.planar[2]
        x, y, theta = pose.planar
        pose = pose._replace(planar=(x, y, near + math.remainder(theta - near, 2.0 * math.pi)))
        if last is not None and elapsed == 0.0:
            return
        self._pose, self._stamp = pose, stamp
        problem = "" if last is None else self._discontinuity(last, pose, elapsed)
        if last is not None and not problem and 0.0 < stamp - self._base[0] <= self._max_period:
            self._difference(stamp, pose)
        else:
            self._velocity, self._base, self._continuous_since = (0.0, 0.0, 0.0), (stamp, pose.planar), stamp
        if problem:
            raise ObservationError(problem)

    def _difference(self, stamp: float, pose: CameraPose) -> None:
        """Update the velocity with a pose, unless it is too close in time."""
        since, base = self._base
        period = stamp - since
        if period < _MIN_PERIOD:
            return
        weight = 1.0 - math.exp(-period / _FILTER_TIME)
        x, y, omega = (
            speed + weight * ((now - before) / period - speed)
            for speed, now, before in zip(self._velocity, pose.planar, base)
        )
        self._velocity = x, y, omega
        self._base = stamp, pose.planar

    def _discontinuity(self, last: CameraPose, pose: CameraPose, elapsed: float) -> str:
        """Return whether stamps went back, or the pose changed by more than the speed limits allow; "" if not."""
        if elapsed < 0.0:
            return f"stamps of the robot's states went back by {-elapsed:.3f} s: check the clock of its computer"
        change = [now - before for now, before in zip((*pose.planar[:2], pose.height), (*last.planar[:2], last.height))]
        distance = math.hypot(math.hypot(change[0], change[1]), change[2])
        turns = (pose.planar[2] - last.planar[2], pose.tilt[0] - last.tilt[0], pose.tilt[1] - last.tilt[1])
        turn = max(map(abs, turns))
        max_distance = _JUMP_SLACK + _JUMP_FACTOR * elapsed * math.sqrt(2.0) * self._max_speed
        max_turn = _JUMP_TURN_SLACK + _JUMP_FACTOR * elapsed * self._max_turn_rate
        if distance <= max_distance and turn <= max_turn:
            return ""
        return (
            f"the robot's pose jumped by {distance:.3f} m and {turn:.2f} rad in {elapsed:.3f} s, more than "
            "arm/max_speed and arm/max_turn_rate allow: the arm was pushed, or its end effector frame was changed"
        )
