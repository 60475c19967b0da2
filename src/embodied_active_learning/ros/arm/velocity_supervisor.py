"""Supervisor of an arm with velocity service: starts its controller, and releases it at a person's request."""

from __future__ import annotations

import threading
import time

import rospy

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.errors import ArmNotReadyError, RobotError
from embodied_active_learning.franka.driver import FrankaDriver
from embodied_active_learning.ros.arm.velocity_interface import VelocityInterface
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle
from embodied_active_learning.ros.runtime.timers import WallTimer

PERIOD = 0.2
"""Wall seconds between two checks of the arm's readiness."""
_READY_TIMEOUT = 2.0  # s


class VelocitySupervisor:
    """Keeps the arm ready where no person is needed. It switches controllers only while the arm is at rest."""

    def __init__(self, interface: VelocityInterface, driver: FrankaDriver, config: FrankaConfig) -> None:
        self._interface = interface
        self._driver = driver
        self._config = config
        self._lock = threading.Lock()  # held by the thread that makes the robot do something
        self._throttle = LogThrottle()
        self.started_at = 0.0  # monotonic time of the last start of the controller
        WallTimer(PERIOD, self.check)

    def check(self) -> None:
        """Start the controller once it can be; log what prevents the arm from moving."""
        with self._lock:
            reason = self._driver.why_not_ready()
            with self._driver.lock:
                is_due = self._driver.readiness.needs_preparation
            if is_due and self._driver.is_at_rest() and self._interface.is_available:
                try:
                    self._start()
                    reason = ""
                except RobotError as error:
                    reason = str(error)
                    with self._driver.lock:
                        self._driver.readiness.set_unprepared(reason)
            if reason and self._throttle.should_log(reason):
                rospy.logwarn("the arm cannot be moved: %s", reason)

    def recover(self) -> None:
        """Make the robot ready at the request of a person who has checked it; if that fails, hold it.

        Raises:
            ArmNotReadyError: The arm moves, or is still not ready.
            RobotError: The robot does not follow.
        """
        with self._lock:
            if not self._driver.why_not_ready():
                return
            try:
                self._make_ready()
            except Exception as error:
                # The person was told that it failed, and may approach: it must not become ready by itself later.
                with self._driver.lock:
                    self._driver.readiness.hold(f"the requested recovery failed ({error})")
                raise

    def _make_ready(self) -> None:
        if not self._driver.is_at_rest():
            raise ArmNotReadyError(
                f"the arm is not known to be at rest: {self._driver.why_not_ready() or 'another node moves it'}"
            )
        self._start()
        self._driver.update_control(errors=())
        with self._driver.lock:
            self._driver.readiness.release()
        if not self._driver.wait_until_ready(_READY_TIMEOUT):
            raise ArmNotReadyError(self._driver.why_not_ready())

    def _start(self) -> None:
        self._interface.start(self._config.rate)
        self.started_at = time.monotonic()
        with self._driver.lock:
            self._driver.readiness.set_prepared()
        rospy.loginfo("velocity controller started")
