"""The images as they come in: whether the newest one is new, and whether the camera sees or only goes on sending."""

from __future__ import annotations

from contextlib import suppress
from typing import Optional

import numpy as np
import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.camera.pose_buffer import PoseBuffer, moved
from embodied_active_learning.ros.conversions import image_array

FUTURE_TOLERANCE = 0.1
"""Seconds that clocks of two computers, or a clock that comes as messages, may differ by."""
STILL_DISTANCE = 0.001
"""Farthest [m] that the camera may have moved ..."""
STILL_TURN = 0.01
"""... and turned [rad] while its images are the same to the last bit."""
FROZEN_LOOKS = 3
"""Looks in a row at a repeated image, the arm held still between them, after which the camera is called frozen."""


class ImageBuffer:
    """Keeps the newest image, and the state in which the camera was when its images began to be the same as that.

    A frozen camera may go on sending with new stamps. From another state the same bytes are never taken for a view.
    Where they were first seen is told by stamps and states that can be trusted only: a wrong one would call a camera
    frozen that sees the same because the arm is held still.
    """

    def __init__(self, config: CameraConfig, poses: PoseBuffer) -> None:
        self._config = config
        self._poses = poses
        self._newest: Optional[Image] = None
        self._arrived = 0  # images since the look began
        self._repeats = 0  # images with the newest one's stamp, but for the first
        self._used = rospy.Time()  # stamp of the last image that was taken for a view
        self._same_since: Optional[rospy.Time] = None  # the first of the same images whose stamp can be trusted
        self._origin: Optional[PlanarState] = None  # the state at that time, once it is known
        self._track = poses.track
        self._repeating = False
        self._repeated_looks = 0

    def add(self, image: Image, now: rospy.Time) -> None:
        """Take in the newest image, which arrived now."""
        last, self._newest = self._newest, image
        stamp = image.header.stamp
        self._arrived += 1
        self._repeats = self._repeats + 1 if last is not None and last.header.stamp == stamp else 0
        if last is None or image.data != last.data:
            self._same_since = self._origin = None
        if self._same_since is None and not self._repeats:
            age = (now - stamp).to_sec()
            self._same_since = stamp if -FUTURE_TOLERANCE <= age <= self._config.max_age else None
        self._find_origin()

    def begin_look(self) -> None:
        """Count what arrives from now on, and whether the last look has failed for a repeated image."""
        self._arrived = 0
        self._repeated_looks = self._repeated_looks + 1 if self._repeating else 0
        self._repeating = False

    def require_fresh(self, after: rospy.Time, now: rospy.Time) -> rospy.Time:
        """The newest image's stamp: not before a time, and not used yet. Raises ObservationError."""
        topic, max_age = rospy.resolve_name(names.CAMERA_IMAGE), self._config.max_age
        if self._newest is None:
            raise ObservationError(f"no image on {topic} yet")
        stamp = self._newest.header.stamp
        age = (now - stamp).to_sec()
        if age < -FUTURE_TOLERANCE:
            raise ObservationError(
                f"the newest image on {topic} is stamped {-age:.2f} s in the future: synchronise the computers' clocks"
            )
        is_new = stamp >= after and stamp != self._used
        if not is_new and self._repeats:
            raise ObservationError(
                f"images on {topic} keep coming with one stamp, {stamp.to_sec():.3f} s: the camera or its driver is "
                "frozen"
            )
        if not is_new and not self._arrived:
            raise ObservationError(
                f"no new image on {topic} within camera/max_age ({max_age:g} s): the newest is {age:.2f} s old"
            )
        if not is_new or age > max_age:
            raise ObservationError(
                f"images on {topic} come too late: the newest is {age:.2f} s old, camera/max_age is {max_age:g} s"
            )
        return stamp

    def view(self, state: PlanarState) -> Image:
        """The newest image as a view from a state. Raises ObservationError when it is none."""
        array = image_array(self._newest, self._config.height, self._config.width)
        if not np.all(array == array[0, 0]):
            self._require_seen_from(state)
        elif not self._config.allow_featureless:
            raise ObservationError(
                f"the image on {rospy.resolve_name(names.CAMERA_IMAGE)} is of one single colour, "
                f"{array[0, 0].tolist()}: the camera is covered or does not work; where such images are right, over a "
                "plain table, set camera/allow_featureless"
            )
        self._used = self._newest.header.stamp
        return self._newest

    def _require_seen_from(self, state: PlanarState) -> None:
        """Raise ObservationError when the newest image is the same as one from another state."""
        self._find_origin()
        if self._origin is None:
            self._same_since, self._origin = state.header.stamp, state
        self._repeating = moved(self._origin, state, STILL_DISTANCE, STILL_TURN)
        if not self._repeating:
            return
        topic = rospy.resolve_name(names.CAMERA_IMAGE)
        place = f"x {self._origin.x:.3f} m, y {self._origin.y:.3f} m, theta {self._origin.theta:.2f} rad"
        if self._repeated_looks + 1 < FROZEN_LOOKS:
            raise ObservationError(f"the image on {topic} is the same as from {place}: looking again")
        raise ObservationError(
            f"images on {topic} have been byte-identical since the arm was at {place}, although it moved: the camera "
            "is frozen"
        )

    def _find_origin(self) -> None:
        if self._track != self._poses.track:
            self._track, self._same_since, self._origin = self._poses.track, None, None
        if self._origin is None and self._same_since is not None:
            with suppress(ObservationError):
                self._origin = self._poses.at(self._same_since)
