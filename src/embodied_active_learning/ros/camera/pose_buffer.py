"""The arm's states as they come in, and the state at any stamp between them."""

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

KEPT = 200
"""States kept for matching: two seconds of a real arm's 100 Hz."""
JUMP_FACTOR = 2.0
JUMP_SLACK = np.array([0.005, 0.005, 0.05])  # m, m, rad
"""A change larger than this, and than so many times what the arm's top speeds allow, is no motion but a jump."""


class PoseBuffer:
    """States in the order of their stamps. Whatever breaks them begins them anew: nothing is interpolated across it.

    That is a jump, a state that is not finite, and time that goes back, as when the arm's node was started anew.
    """

    def __init__(self, config: Config) -> None:
        self._max_age = config.camera.max_age
        self._speeds = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
        self._states: Deque[PlanarState] = deque(maxlen=KEPT)
        self._track = 0
        self._restarts = 0
        self._repeats = 0
        self._finite = True
        self._jump = ""

    @property
    def track(self) -> int:
        """Number of the track, which grows whenever it begins anew."""
        return self._track

    @property
    def restarts(self) -> int:
        """How often time has gone back."""
        return self._restarts

    @property
    def newest(self) -> Optional[rospy.Time]:
        """The newest state's stamp, if there is one."""
        return self._states[-1].header.stamp if self._states else None

    def add(self, message: PlanarState) -> None:
        """Take in the newest state."""
        self._finite = bool(np.isfinite(np.concatenate(state_arrays(message))).all())
        if not self._finite:
            self._begin_anew()
            return
        if self._states:
            self._compare(self._states[-1], message)
        if not self._repeats:
            self._states.append(message)

    def raise_jump(self) -> None:
        """Raise ObservationError for a jump since the last call."""
        jump, self._jump = self._jump, ""
        if jump:
            raise ObservationError(jump)

    def at(self, stamp: rospy.Time) -> PlanarState:
        """The state at a stamp, interpolated. Raises ObservationError when it is not known."""
        topic = rospy.resolve_name(names.ARM_STATE)
        if not self._finite:
            raise ObservationError(f"{topic} holds values that are not finite")
        before = after = None
        for state in reversed(self._states):
            if state.header.stamp == stamp:
                return state
            if state.header.stamp < stamp:
                before = state
                break
            after = state
        if before is None or after is None:
            raise ObservationError(f"no state on {topic} around the image's stamp: {self._what_there_is(stamp)}")
        gap = (after.header.stamp - before.header.stamp).to_sec()
        if gap > self._max_age:
            raise ObservationError(
                f"no state on {topic} for {gap:.2f} s around the image's stamp: camera/max_age is {self._max_age:g} s"
            )
        return interpolate(before, after, stamp)

    def _compare(self, last: PlanarState, message: PlanarState) -> None:
        elapsed = (message.header.stamp - last.header.stamp).to_sec()
        self._repeats = self._repeats + 1 if elapsed == 0.0 else 0
        change = _change(last, message)
        if elapsed < 0.0:
            self._begin_anew()
            self._restarts += 1
        elif np.any(np.abs(change) > JUMP_SLACK + JUMP_FACTOR * elapsed * self._speeds):
            self._begin_anew()
            self._jump = (
                f"the pose on {rospy.resolve_name(names.ARM_STATE)} jumped by {math.hypot(change[0], change[1]):.3f} m "
                f"and {abs(change[2]):.2f} rad in {elapsed:.3f} s, faster than the arm can move (arm/max_speed, "
                "arm/max_turn_rate)"
            )

    def _begin_anew(self) -> None:
        self._states.clear()
        self._repeats = 0
        self._track += 1

    def _what_there_is(self, stamp: rospy.Time) -> str:
        if not self._states:
            return "there is none yet"
        if self._states[0].header.stamp > stamp:
            return f"the oldest is {(self._states[0].header.stamp - stamp).to_sec():.2f} s newer than the image"
        newest = self._states[-1].header.stamp
        if self._repeats:
            return f"they keep coming with one stamp, {newest.to_sec():.3f} s"
        return (
            f"the newest is {(stamp - newest).to_sec():.2f} s older than the image, and nothing came within "
            f"camera/max_age ({self._max_age:g} s)"
        )


def interpolate(before: PlanarState, after: PlanarState, stamp: rospy.Time) -> PlanarState:
    """The state at a stamp between two states, linearly; yaw the short way round."""
    share = (stamp - before.header.stamp).to_sec() / (after.header.stamp - before.header.stamp).to_sec()
    (state, velocity), (_, velocity_after) = state_arrays(before), state_arrays(after)
    state, velocity = state + share * _change(before, after), velocity + share * (velocity_after - velocity)
    header = type(before.header)(stamp=stamp, frame_id=before.header.frame_id)
    return PlanarState(header, *state.tolist(), *velocity.tolist())


def moved(before: PlanarState, after: PlanarState, distance: float, turn: float) -> bool:
    """Whether two states lie farther apart than a distance [m] or a turn [rad]."""
    change = _change(before, after)
    return math.hypot(change[0], change[1]) > distance or abs(change[2]) > turn


def _change(before: PlanarState, after: PlanarState) -> np.ndarray:
    """(3,) from one state to another, m, m, rad; yaw the short way round."""
    change = state_arrays(after)[0] - state_arrays(before)[0]
    change[2] = math.remainder(change[2], 2.0 * math.pi)
    return change
