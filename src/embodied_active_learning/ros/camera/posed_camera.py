"""Images with the state they were taken from, or a sentence that says what is missing or wrong."""

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
from embodied_active_learning.ros.camera.image_buffer import ImageBuffer
from embodied_active_learning.ros.camera.pose_buffer import KEPT, PoseBuffer
from embodied_active_learning.ros.runtime.node import ShutdownRequestedError


class PosedCamera:
    """Pairs camera images with the arm's state at the image's stamp. A pair that is not fresh is never handed out."""

    def __init__(self, config: Config, clock: Callable[[], rospy.Time] = rospy.Time.now) -> None:
        self._max_age = config.camera.max_age
        self._clock = clock
        self._condition = threading.Condition()
        self._poses = PoseBuffer(config)
        self._images = ImageBuffer(config.camera, self._poses)
        self._state_subscriber = rospy.Subscriber(names.ARM_STATE, PlanarState, self.add_state, queue_size=KEPT)
        # A buffer smaller than an image would let old images queue up in the socket.
        self._image_subscriber = rospy.Subscriber(
            names.CAMERA_IMAGE, Image, self.add_image, queue_size=1, buff_size=2**24
        )

    @property
    def connected(self) -> bool:
        """Whether somebody publishes images and states."""
        return self._image_subscriber.get_num_connections() > 0 and self._state_subscriber.get_num_connections() > 0

    @property
    def restarts(self) -> int:
        """How often the time of the arm's states has gone back, as it does when a simulated arm begins anew."""
        return self._poses.restarts

    @property
    def newest_state(self) -> Optional[rospy.Time]:
        """The stamp of the arm's newest state, if there is one."""
        with self._condition:
            return self._poses.newest

    def add_state(self, message: PlanarState) -> None:
        """Take in a state of the arm."""
        with self._condition:
            self._poses.add(message)
            self._condition.notify_all()

    def add_image(self, message: Image) -> None:
        """Take in an image."""
        with self._condition:
            self._images.add(message, self._clock())
            self._condition.notify_all()

    def take(self, after: rospy.Time) -> Tuple[Image, PlanarState]:
        """The first image taken at or after a time, when a good one comes within camera/max_age of wall time.

        -> (image as the camera published it, state at its stamp). Raises ObservationError that names what is missing or
        wrong, and ShutdownRequestedError.
        """
        give_up_at = time.monotonic() + self._max_age
        with self._condition:
            self._images.begin_look()
            while True:
                self._poses.raise_jump()
                try:
                    return self._pair(after)
                except ObservationError:
                    if rospy.is_shutdown():
                        raise ShutdownRequestedError from None
                    if time.monotonic() >= give_up_at:
                        raise
                self._condition.wait(timeout=min(0.1, max(0.0, give_up_at - time.monotonic())))

    def _pair(self, after: rospy.Time) -> Tuple[Image, PlanarState]:
        # The arm's answer may be here before the clock's message.
        stamp = self._images.require_fresh(after, max(self._clock(), after))
        state = self._poses.at(stamp)
        return self._images.view(state), state
