"""The newest camera image, and checks that it is fresh and the camera not frozen."""

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
"""Clock difference in seconds that is tolerated between two computers, or with a simulated clock."""
STILL_DISTANCE = 0.001
"""Distance (m) ..."""
STILL_TURN = 0.01
"""... and turn (rad) within which byte-identical images are accepted."""
FROZEN_ATTEMPTS = 3
"""Consecutive attempts with a repeated image, the arm at rest between them, before the camera is reported as frozen."""


def exposure_stamp(stamp: rospy.Time, latency: float) -> rospy.Time:
    """Return the time of an image's exposure for its stamp and camera/latency [s]; a zero stamp stays zero."""
    return rospy.Time.from_sec(max(stamp.to_sec() - latency, 0.0)) if latency > 0.0 else stamp


class ImageBuffer:
    """Stores the newest image, and the state from which its content was first seen.

    A frozen camera may repeat one image with new stamps, so byte-identical images from different states are rejected.
    The state of first sight is derived from plausible stamps only: a wrong one would make a live camera at rest look
    frozen.
    """

    def __init__(self, config: CameraConfig, poses: PoseBuffer) -> None:
        self._config = config
        self._poses = poses
        self._newest: Optional[Image] = None
        self._arrived = 0  # images since the attempt began
        self._repeated_stamps = 0  # images with the newest one's stamp, without the first
        self._used = rospy.Time()  # stamp of the last image returned by view()
        self._same_since: Optional[rospy.Time] = None  # first plausible stamp of the current content
        self._origin: Optional[PlanarState] = None  # state at that stamp, once known
        self._track = poses.track
        self._repeating = False
        self._repeated_attempts = 0

    def add(self, image: Image, now: rospy.Time) -> None:
        """Store an image that arrived now."""
        last, self._newest = self._newest, image
        stamp = image.header.stamp
        self._arrived += 1
        self._repeated_stamps = self._repeated_stamps + 1 if last is not None and last.header.stamp == stamp else 0
        if last is None or image.data != last.data:
            self._same_since = self._origin = None
        if self._same_since is None and not self._repeated_stamps:
            age = (now - stamp).to_sec()
            self._same_since = stamp if -FUTURE_TOLERANCE <= age <= self._config.max_age else None
        self._find_origin()

    def begin_attempt(self) -> None:
        """Reset the count of arriving images, and update the count of attempts that saw a repeated image."""
        self._arrived = 0
        self._repeated_attempts = self._repeated_attempts + 1 if self._repeating else 0
        self._repeating = False

    def require_fresh(self, after: rospy.Time, now: rospy.Time) -> rospy.Time:
        """Return the newest image's stamp. Raises ObservationError if it is before `after`, too old or already used."""
        topic, max_age = rospy.resolve_name(names.CAMERA_IMAGE), self._config.max_age
        if self._newest is None:
            raise ObservationError(f"no image on {topic} yet")
        stamp = self._newest.header.stamp
        if stamp.is_zero() and not now.is_zero():
            raise ObservationError(
                f"images on {topic} have no time stamp (header.stamp is 0): use a camera driver that sets it"
            )
        age = (now - stamp).to_sec()
        if age < -FUTURE_TOLERANCE:
            raise ObservationError(
                f"the newest image on {topic} is stamped {-age:.2f} s in the future: synchronise the computers' clocks"
            )
        is_new = stamp >= after and stamp != self._used
        if not is_new and self._repeated_stamps:
            raise ObservationError(
                f"images on {topic} repeat one stamp, {stamp.to_sec():.3f} s: the camera or its driver is frozen"
            )
        if not is_new and not self._arrived:
            raise ObservationError(
                f"camera timeout: no new image on {topic} within camera/max_age ({max_age:g} s), the newest is "
                f"{age:.2f} s old"
            )
        if not is_new or age > max_age:
            raise ObservationError(
                f"images on {topic} are late: the newest is {age:.2f} s old, camera/max_age is {max_age:g} s"
            )
        return stamp

    def accept(self, state: PlanarState) -> Image:
        """Check the newest image, taken from a state, mark it as used and return it.

        Raises ObservationError if it is unusable: of a single colour, or the same as from another state.
        """
        image = self._newest
        if image is None:
            raise ObservationError(f"no image on {rospy.resolve_name(names.CAMERA_IMAGE)} yet")
        array = image_array(image, self._config.height, self._config.width)
        if not np.all(array == array[0, 0]):
            self._require_moving_content(state)
        elif not self._config.allow_featureless:
            raise ObservationError(
                f"the image on {rospy.resolve_name(names.CAMERA_IMAGE)} has a single colour, {array[0, 0].tolist()}: "
                "the camera is covered or broken; set camera/allow_featureless if a plain table is expected"
            )
        self._used = image.header.stamp
        return image

    def _require_moving_content(self, state: PlanarState) -> None:
        """Raise ObservationError if the same content was seen from another state."""
        self._find_origin()
        if self._origin is None:
            self._same_since, self._origin = state.header.stamp, state
        self._repeating = moved(self._origin, state, STILL_DISTANCE, STILL_TURN)
        if not self._repeating:
            return
        topic = rospy.resolve_name(names.CAMERA_IMAGE)
        place = f"x {self._origin.x:.3f} m, y {self._origin.y:.3f} m, theta {self._origin.theta:.2f} rad"
        if self._repeated_attempts + 1 < FROZEN_ATTEMPTS:
            raise ObservationError(f"the image on {topic} is the same as from {place}: retrying")
        raise ObservationError(
            f"camera frozen: images on {topic} have been byte-identical since the arm was at {place}, although it moved"
        )

    def _find_origin(self) -> None:
        """Look up the state of first sight, unless the arm's track was interrupted since."""
        if self._track != self._poses.track:
            self._track, self._same_since, self._origin = self._poses.track, None, None
        if self._origin is None and self._same_since is not None:
            with suppress(ObservationError):
                self._origin = self._poses.at(self._same_since)
