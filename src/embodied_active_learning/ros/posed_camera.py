"""Images with the state they were taken from, or a sentence that says what is missing."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from typing import Deque, Optional, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import image_array, state_arrays
from embodied_active_learning.ros.node import ShutdownRequestedError

KEPT = 200
"""States kept for matching: two seconds of a real arm's 100 Hz."""


class PosedCamera:
    """Pairs camera images with the arm's state at the image's stamp, interpolated between two states."""

    def __init__(self, config: CameraConfig) -> None:
        self._config = config
        self._condition = threading.Condition()
        self._states: Deque[PlanarState] = deque(maxlen=KEPT)
        self._image: Optional[Image] = None
        self._state_subscriber = rospy.Subscriber(names.ARM_STATE, PlanarState, self._on_state, queue_size=KEPT)
        # A buffer smaller than an image would let old images queue up in the socket.
        self._image_subscriber = rospy.Subscriber(
            names.CAMERA_IMAGE, Image, self._on_image, queue_size=1, buff_size=2**24
        )

    @property
    def connected(self) -> bool:
        """Whether somebody publishes images and states."""
        return self._image_subscriber.get_num_connections() > 0 and self._state_subscriber.get_num_connections() > 0

    def take(self, after: rospy.Time) -> Tuple[rospy.Time, np.ndarray, PlanarState]:
        """The first image taken at or after a time, when it comes within camera/max_age of wall time.

        -> (stamp, image (H, W, 3) uint8, state). Raises ObservationError that names what is missing or wrong, and
        ShutdownRequestedError.
        """
        give_up_at = time.monotonic() + self._config.max_age
        with self._condition:
            while True:
                found = self._match(after)
                if found is not None:
                    return found
                if rospy.is_shutdown():
                    raise ShutdownRequestedError
                if not self._condition.wait(timeout=min(0.1, max(0.0, give_up_at - time.monotonic()))) and (
                    time.monotonic() >= give_up_at
                ):
                    raise ObservationError(self._what_is_missing(after))

    def _on_state(self, message: PlanarState) -> None:
        with self._condition:
            if self._states and message.header.stamp < self._states[-1].header.stamp:
                self._states.clear()  # time went back: the simulation was started anew
            self._states.append(message)
            self._condition.notify_all()

    def _on_image(self, message: Image) -> None:
        with self._condition:
            self._image = message
            self._condition.notify_all()

    def _match(self, after: rospy.Time) -> Optional[Tuple[rospy.Time, np.ndarray, PlanarState]]:
        if self._image is None or self._image.header.stamp < after:
            return None
        stamp = self._image.header.stamp
        state = self._state_at(stamp)
        if state is None:
            return None
        if not all(map(math.isfinite, np.concatenate(state_arrays(state)))):
            raise ObservationError(f"{rospy.resolve_name(names.ARM_STATE)} holds values that are not finite")
        return stamp, image_array(self._image, self._config.height, self._config.width), state

    def _state_at(self, stamp: rospy.Time) -> Optional[PlanarState]:
        before = after = None
        for state in reversed(self._states):
            if state.header.stamp == stamp:
                return state
            if state.header.stamp < stamp:
                before = state
                break
            after = state
        return None if before is None or after is None else interpolate(before, after, stamp)

    def _what_is_missing(self, after: rospy.Time) -> str:
        topic = rospy.resolve_name(names.CAMERA_IMAGE)
        if self._image is None:
            return f"no image on {topic} yet"
        if self._image.header.stamp < after:
            return f"no new image on {topic} within camera/max_age ({self._config.max_age:g} s)"
        return f"no state on {rospy.resolve_name(names.ARM_STATE)} around the image's stamp"


def interpolate(before: PlanarState, after: PlanarState, stamp: rospy.Time) -> PlanarState:
    """The state at a stamp between two states, linearly; yaw the short way round."""
    share = (stamp - before.header.stamp).to_sec() / (after.header.stamp - before.header.stamp).to_sec()
    (state_a, velocity_a), (state_b, velocity_b) = state_arrays(before), state_arrays(after)
    change = state_b - state_a
    change[2] = math.remainder(change[2], 2.0 * math.pi)
    state, velocity = state_a + share * change, velocity_a + share * (velocity_b - velocity_a)
    header = type(before.header)(stamp=stamp, frame_id=before.header.frame_id)
    return PlanarState(header, *state.tolist(), *velocity.tolist())
