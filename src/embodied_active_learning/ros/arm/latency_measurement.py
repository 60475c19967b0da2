"""Measurement of the camera's latency: the arm rotates the camera while images and poses are recorded."""

from __future__ import annotations

import threading
from typing import List

import rospy
from sensor_msgs.msg import Image

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError
from embodied_active_learning.franka.latency import LatencyEstimate, RotationTracker, estimate_latency
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.client import ArmClient
from embodied_active_learning.ros.arm.lease import Lease
from embodied_active_learning.ros.conversions import image_array
from embodied_active_learning.ros.runtime.node import wall_sleep

RATE = 0.3
"""Turn rate, rad/s; less if arm/max_turn_rate is lower."""
STEP = 0.1
"""Duration of one velocity command, s."""
SWEEPS = ((1.0, 1.0), (-1.0, 2.0), (1.0, 2.0), (-1.0, 1.0))
"""Sense and duration [s] of each sweep."""
DELAY = 1.0
"""Wall seconds until both topics are connected, and until the last images have arrived."""


class LatencyRecorder:
    """Records the yaw of the arm and the rotation of the images with their stamps."""

    def __init__(self, config: Config) -> None:
        """Subscribe to both topics."""
        self._camera = config.camera
        self._lock = threading.Lock()
        self._tracker = RotationTracker()
        self._stamps: List[float] = []
        self._rotations: List[float] = []
        self._times: List[float] = []
        self._yaws: List[float] = []
        rospy.Subscriber(names.ARM_STATE, PlanarState, self.add_state, queue_size=1000)
        rospy.Subscriber(names.CAMERA_IMAGE, Image, self.add_image, queue_size=1000, buff_size=2**24)

    def add_state(self, message: PlanarState) -> None:
        """Record the yaw; repeated states are skipped."""
        stamp = message.header.stamp.to_sec()
        with self._lock:
            if not self._times or stamp > self._times[-1]:
                self._times.append(stamp)
                self._yaws.append(message.theta)

    def add_image(self, message: Image) -> None:
        """Record the rotation of an image; repeated images are skipped."""
        stamp = message.header.stamp.to_sec()
        with self._lock:
            if not self._stamps or stamp > self._stamps[-1]:
                image = image_array(message, self._camera.height, self._camera.width)
                self._stamps.append(stamp)
                self._rotations.append(self._tracker.rotation(image))

    def estimate(self) -> LatencyEstimate:
        """Estimate the latency from everything recorded. Raises ObservationError."""
        with self._lock:
            return estimate_latency(self._stamps, self._rotations, self._times, self._yaws)


def measure_latency(arm: ArmClient, config: Config) -> LatencyEstimate:
    """Rotate the camera in the middle of the workspace, and return its latency.

    Raises:
        CommandError: The arm rejects a command, for example because another node commands it.
        ObservationError: Images and poses do not determine the latency.
        ShutdownRequestedError: The node ends.
    """
    arm.go_to(config.workspace.box().centre.tolist())
    lease = Lease(config.arm.commander_timeout, arm.heartbeat)
    lease.renew()
    try:
        recorder = LatencyRecorder(config)
        wall_sleep(DELAY)
        rate = min(RATE, config.arm.max_turn_rate)
        for sense, duration in SWEEPS:
            for _ in range(round(duration / STEP)):
                arm.move((0.0, 0.0, sense * rate), STEP)
                lease.renew()
    finally:
        lease.end()
        try:
            arm.stop_if_commander()
        except CommandError as error:
            rospy.logwarn("stop not confirmed: %s; the arm stops after the last command", error)
    wall_sleep(DELAY)
    return recorder.estimate()
