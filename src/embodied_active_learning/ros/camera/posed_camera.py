"""A camera of which each image comes with the arm state at its stamp; what the planner observes with."""

from __future__ import annotations

import threading
import time
from typing import Callable, Optional, Tuple

import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.camera.image_buffer import ImageBuffer, exposure_stamp
from embodied_active_learning.ros.camera.pose_buffer import CAPACITY, PoseBuffer
from embodied_active_learning.ros.runtime.node import ShutdownRequestedError


class PosedCamera:
    """Subscribes to camera images and arm states, and returns fresh pairs of them only."""

    def __init__(self, config: Config, clock: Callable[[], rospy.Time] = rospy.Time.now) -> None:
        self._max_age = config.camera.max_age
        self._latency = config.camera.latency
        self._clock = clock
        self._condition = threading.Condition()
        self._poses = PoseBuffer(config)
        self._images = ImageBuffer(config.camera, self._poses)
        self._state_subscriber = rospy.Subscriber(names.ARM_STATE, PlanarState, self.add_state, queue_size=CAPACITY)
        # With a receive buffer smaller than an image, old images would queue up in the socket.
        self._image_subscriber = rospy.Subscriber(
            names.CAMERA_IMAGE, Image, self.add_image, queue_size=1, buff_size=2**24
        )

    @property
    def connected(self) -> bool:
        """Whether images and states both have a publisher."""
        return self._image_subscriber.get_num_connections() > 0 and self._state_subscriber.get_num_connections() > 0

    @property
    def restarts(self) -> int:
        """Number of times that the states' time went back: restarts of a simulated arm."""
        return self._poses.restarts

    @property
    def newest_state(self) -> Optional[rospy.Time]:
        """Stamp of the newest arm state, if any."""
        with self._condition:
            return self._poses.newest

    def add_state(self, message: PlanarState) -> None:
        """Store an arm state."""
        with self._condition:
            self._poses.add(message)
            self._condition.notify_all()

    def add_image(self, message: Image) -> None:
        """Store an image with its stamp corrected by camera/latency."""
        message.header.stamp = exposure_stamp(message.header.stamp, self._latency)
        with self._condition:
            self._images.add(message, self._clock())
            self._condition.notify_all()

    def take(self, after: rospy.Time) -> Tuple[Image, PlanarState]:
        """Wait for an image taken at or after a time, up to camera/max_age of wall time.

        Returns:
            The image with the stamp of its exposure, and the state at that time.

        Raises:
            ObservationError: No valid pair arrived in time; the message has the reason.
            ShutdownRequestedError: The node shuts down.
        """
        deadline = time.monotonic() + self._max_age
        with self._condition:
            self._images.begin_attempt()
            while True:
                self._poses.raise_jump()
                try:
                    return self._pair(after)
                except ObservationError:
                    if rospy.is_shutdown():
                        raise ShutdownRequestedError from None
                    if time.monotonic() >= deadline:
                        raise
                self._condition.wait(timeout=min(0.1, max(0.0, deadline - time.monotonic())))

    def _pair(self, after: rospy.Time) -> Tuple[Image, PlanarState]:
        # The arm's response may arrive before the clock message with the same time.
        stamp = self._images.require_fresh(after, max(self._clock(), after))
        state = self._poses.at(stamp)
        return self._images.accept(state), state
