"""The robot's measured poses as they come in: their velocity, and whether they can be of one moving arm."""

from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.franka.mount import CameraPose

_FILTER = 0.05
"""Time constant of the low-pass on differenced poses, s: a few states of 100 Hz, one or two of 30 Hz."""
_SHORTEST = 0.004
"""Poses closer in time than this, s, are not differenced: a stamp's jitter would become velocity."""
_TOLD = 2.0 * _FILTER
"""s of unbroken poses after which their velocity tells motion from rest."""
_JUMP_FACTOR, _JUMP_SLACK, _JUMP_TURN_SLACK = 2.0, 0.01, 0.1  # -, m, rad
"""A change larger than the slack, and than so many times what the top speeds allow, is no motion but a jump."""


class StateTrack:
    """Poses in the order of their stamps. What breaks them begins them anew, at rest until the next pose tells more.

    The velocity is differenced here: O_dP_EE_c, which the robot gives, is the commanded one, and no command of a
    torque controller.
    """

    def __init__(self, config: Config) -> None:
        self._top_speed = config.arm.max_speed
        self._top_turn_rate = config.arm.max_turn_rate
        self._longest = config.franka.state_max_age
        self._middle = float(config.workspace.box().centre[2])
        self._pose: Optional[CameraPose] = None
        self._stamp = 0.0
        self._base: Tuple[float, Sequence[float]] = (0.0, ())  # stamp and pose that the next is differenced from
        self._velocity = (0.0, 0.0, 0.0)
        self._unbroken_since = 0.0  # stamp

    @property
    def pose(self) -> Optional[CameraPose]:
        """The newest pose; its yaw goes on beyond pi where the arm does."""
        return self._pose

    @property
    def velocity(self) -> Tuple[float, float, float]:
        """m/s, m/s, rad/s in the base frame."""
        return self._velocity

    @property
    def tells_motion(self) -> bool:
        """Whether poses have followed each other for long enough that a velocity of zero means rest."""
        return self._pose is not None and self._stamp >= self._unbroken_since + _TOLD

    def is_new(self, stamp: float) -> bool:
        """Whether a state of this stamp, s, says more than those before; states may be sent again."""
        return self._pose is None or stamp != self._stamp

    def add(self, stamp: float, pose: CameraPose) -> None:
        """Take in a pose with its stamp, s.

        Raises ObservationError when the arm cannot have moved there; it is taken for where the arm is all the same.
        """
        last, elapsed = self._pose, stamp - self._stamp
        near = self._middle if last is None else last.planar[2]
        x, y, theta = pose.planar
        pose = pose._replace(planar=(x, y, near + math.remainder(theta - near, 2.0 * math.pi)))
        if last is not None and elapsed == 0.0:
            return
        self._pose, self._stamp = pose, stamp
        velocity, self._velocity = self._velocity, (0.0, 0.0, 0.0)
        base, self._base = self._base, (stamp, pose.planar)
        unbroken_since, self._unbroken_since = self._unbroken_since, stamp
        if last is None:
            return
        self._refuse_jump(last, pose, elapsed)
        if 0.0 < stamp - base[0] <= self._longest:
            self._velocity, self._base, self._unbroken_since = velocity, base, unbroken_since
            self._difference(stamp, pose)

    def _difference(self, stamp: float, pose: CameraPose) -> None:
        since, base = self._base
        period = stamp - since
        if period < _SHORTEST:
            return
        share = 1.0 - math.exp(-period / _FILTER)
        x, y, omega = (
            speed + share * ((now - before) / period - speed)
            for speed, now, before in zip(self._velocity, pose.planar, base)
        )
        self._velocity = x, y, omega
        self._base = stamp, pose.planar

    def _refuse_jump(self, last: CameraPose, pose: CameraPose, elapsed: float) -> None:
        if elapsed < 0.0:
            raise ObservationError(
                f"the stamps of the robot's states went back by {-elapsed:.3f} s: see to the clock of its computer"
            )
        change = [now - before for now, before in zip((*pose.planar[:2], pose.height), (*last.planar[:2], last.height))]
        distance = math.hypot(math.hypot(change[0], change[1]), change[2])
        turns = (pose.planar[2] - last.planar[2], pose.tilt[0] - last.tilt[0], pose.tilt[1] - last.tilt[1])
        turn = max(map(abs, turns))
        may_go = _JUMP_SLACK + _JUMP_FACTOR * elapsed * math.sqrt(2.0) * self._top_speed
        may_turn = _JUMP_TURN_SLACK + _JUMP_FACTOR * elapsed * self._top_turn_rate
        if distance > may_go or turn > may_turn:
            raise ObservationError(
                f"the robot's pose jumped by {distance:.3f} m and {turn:.2f} rad in {elapsed:.3f} s, faster than it is "
                "moved (arm/max_speed, arm/max_turn_rate): somebody pushes it, or has changed its end effector frame"
            )
