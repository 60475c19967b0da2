"""Sends velocities to an arm with velocity service, so that it follows the driver's set-points."""

from __future__ import annotations

import time
from typing import Callable

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ServiceError
from embodied_active_learning.franka.set_point_driver import SetPointDriver
from embodied_active_learning.franka.velocity_readiness import STOPPED_ERROR
from embodied_active_learning.franka.velocity_tracking import REST, VelocityTracker
from embodied_active_learning.ros.arm.velocity_interface import VelocityInterface
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle


class VelocitySender:
    """Sends a velocity per tick while the robot is ready, and one of zero after the last set-point.

    A service that does not respond makes the robot unprepared; a robot that does not follow gets an error.
    """

    def __init__(
        self,
        interface: VelocityInterface,
        driver: SetPointDriver,
        config: Config,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """clock: returns the time [s]."""
        self._interface = interface
        self._driver = driver
        self._clock = clock
        self._tracker = VelocityTracker(config)
        self._sent_at = clock()
        self._is_moving = False
        self._throttle = LogThrottle()

    def send(self) -> None:
        """Send the velocity that follows the driver's next set-point; zero once it has ended, then nothing."""
        now = self._clock()
        period, self._sent_at = now - self._sent_at, now
        tracking = self._driver.tracking() if self._driver.tick() is not None else None
        if tracking is None:
            self._tracker.reset()
            if not self._is_moving:
                return
        try:
            follows = self._interface.send(self._tracker.twist(tracking, period) if tracking else REST)
        except ServiceError as error:
            self._is_moving = False
            with self._driver.readiness() as readiness:
                readiness.set_unprepared(str(error), retry=True)  # restarted, it is in an unknown mode
            if self._throttle.should_log(str(error)):
                rospy.logerr("%s", error)
            return
        self._is_moving = tracking is not None
        if self._is_moving and not follows:
            self._driver.update_control(errors=(STOPPED_ERROR,))

    def send_rest(self) -> None:
        """Send a zero velocity, because the controller lets the last one decay only after two steps."""
        try:
            self._interface.send(REST)
        except ServiceError as error:
            rospy.logerr("the arm was not stopped: %s", error)
