"""Recent arm states, and the state interpolated at any stamp between them."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Optional

import numpy as np
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import state_arrays

CAPACITY = 200
"""Number of states kept: two seconds at the 100 Hz of a real arm."""
JUMP_FACTOR = 2.0
"""A change above this multiple of what the arm's speed limits allow, ..."""
JUMP_SLACK = np.array([0.005, 0.005, 0.05])
"""... plus this (m, m, rad), is a jump."""


class PoseBuffer:
    """Arm states in the order of their stamps.

    A jump, a non-finite state, or time going back (the arm node was restarted) begins a new track. States are never
    interpolated across tracks.
    """

    def __init__(self, config: Config) -> None:
        self._max_age = config.camera.max_age
        self._speeds = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
        self._states: Deque[PlanarState] = deque(maxlen=CAPACITY)
        self._track = 0
        self._restarts = 0
        self._repeated_stamps = 0
        self._finite = True
        self._jump = ""

    @property
    def track(self) -> int:
        """Number of the current track."""
        return self._track

    @property
    def restarts(self) -> int:
        """Number of times that time went back."""
        return self._restarts

    @property
    def newest(self) -> Optional[rospy.Time]:
        """Stamp of the newest state, if any."""
        return self._states[-1].header.stamp if self._states else None

    def add(self, message: PlanarState) -> None:
        """Store the newest state."""
        self._finite = bool(np.isfinite(np.concatenate(state_arrays(message))).all())
        if not self._finite:
            self._begin_track()
            return
        if self._states:
            self._compare(self._states[-1], message)
        if not self._repeated_stamps:
            self._states.append(message)

    def raise_jump(self) -> None:
        """Raise ObservationError if a jump occurred since the last call."""
        jump, self._jump = self._jump, ""
        if jump:
            raise ObservationError(jump)

    def at(self, stamp: rospy.Time) -> PlanarState:
        """Return the state interpolated at a stamp. Raises ObservationError if it is unknown."""
        topic = rospy.resolve_name(names.ARM_STATE)
        if not self._finite:
            raise ObservationError(f"invalid state on {topic}: non-finite values")
        before = after = None
        for state in reversed(self._states):
            if state.header.stamp == stamp:
                return state
            if state.header.stamp < stamp:
                before = state
                break
            after = state
        if before is None or after is None:
            raise ObservationError(f"no state on {topic} around the image's stamp: {self._availability(stamp)}")
        gap = (after.header.stamp - before.header.stamp).to_sec()
        if gap > self._max_age:
            raise ObservationError(
                f"no state on {topic} for {gap:.2f} s around the image's stamp: camera/max_age is {self._max_age:g} s"
            )
        return interpolate(before, after, stamp)

    def _compare(self, last: PlanarState, message: PlanarState) -> None:
        """Detect repeated stamps, time going back, and jumps."""
        elapsed = (message.header.stamp - last.header.stamp).to_sec()
        self._repeated_stamps = self._repeated_stamps + 1 if elapsed == 0.0 else 0
        change = _change(last, message)
        if elapsed < 0.0:
            self._begin_track()
            self._restarts += 1
        elif np.any(np.abs(change) > JUMP_SLACK + JUMP_FACTOR * elapsed * self._speeds):
            self._begin_track()
            self._jump = (
                f"pose jump on {rospy.resolve_name(names.ARM_STATE)}: {math.hypot(change[0], change[1]):.3f} m and "
                f"{abs(change[2]):.2f} rad in {elapsed:.3f} s, faster than arm/max_speed and arm/max_turn_rate allow"
            )

    def _begin_track(self) -> None:
        self._states.clear()
        self._repeated_stamps = 0
        self._track += 1

    def _availability(self, stamp: rospy.Time) -> str:
        """Describe which states are available around a stamp."""
        if not self._states:
            return "none was received"
        if self._states[0].header.stamp > stamp:
            return f"the oldest is {(self._states[0].header.stamp - stamp).to_sec():.2f} s newer than the image"
        newest = self._states[-1].header.stamp
        if self._repeated_stamps:
            return f"they repeat one stamp, {newest.to_sec():.3f} s"
        return (
            f"the newest is {(stamp - newest).to_sec():.2f} s older than the image, and none arrived within "
            f"camera/max_age ({self._max_age:g} s)"
        )


def interpolate(before: PlanarState, after: PlanarState, stamp: rospy.Time) -> PlanarState:
    """Interpolate linearly between two states at a stamp; yaw along the shorter arc."""
    weight = (stamp - before.header.stamp).to_sec() / (after.header.stamp - before.header.stamp).to_sec()
    (state, velocity), (_, velocity_after) = state_arrays(before), state_arrays(after)
    state, velocity = state + weight * _change(before, after), velocity + weight * (velocity_after - velocity)
    header = type(before.header)(stamp=stamp, frame_id=before.header.frame_id)
    return PlanarState(header, *state.tolist(), *velocity.tolist())


def moved(before: PlanarState, after: PlanarState, distance: float, turn: float) -> bool:
    """Return whether two states differ by more than a distance (m) or a turn (rad)."""
    change = _change(before, after)
    return math.hypot(change[0], change[1]) > distance or abs(change[2]) > turn


def _change(before: PlanarState, after: PlanarState) -> np.ndarray:
    """Difference of two states (3,), m, m, rad; yaw along the shorter arc."""
    change = state_arrays(after)[0] - state_arrays(before)[0]
    change[2] = math.remainder(change[2], 2.0 * math.pi)
    return change
