"""Supervisor of an arm with velocity service: starts its controller, and releases it at a person's request."""

from __future__ import annotations

import threading

import rospy

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.errors import ArmNotReadyError, RobotError, ServiceError
from embodied_active_learning.franka.set_point_driver import SetPointDriver
from embodied_active_learning.ros.arm.requested_recovery import requested_recovery
from embodied_active_learning.ros.arm.velocity_interface import VelocityInterface
from embodied_active_learning.ros.runtime.timers import WallTimer

PERIOD = 0.2
"""Wall seconds between two checks of the arm's readiness."""
_READY_TIMEOUT = 2.0  # s


class VelocitySupervisor:
    """Keeps the arm ready where no person is needed. It switches controllers only while the arm is at rest."""

    def __init__(self, interface: VelocityInterface, driver: SetPointDriver, config: FrankaConfig) -> None:
        self._interface = interface
        self._driver = driver
        self._config = config
        self._lock = threading.Lock()  # held by the thread that makes the robot do something
        WallTimer(PERIOD, self.check)

    def check(self) -> None:
        """Start the controller once it can be."""
        with self._lock:
            with self._driver.readiness() as readiness:
                is_due = readiness.needs_preparation
            if is_due:
                self._try_start()

    def recover(self) -> None:
        """Make the robot ready at the request of a person who has checked it; if that fails, hold it.

        Raises:
            ArmNotReadyError: The arm moves, is still not ready, or is being started.
            RobotError: The robot does not follow.
            ServiceError: The robot's node does not respond.
        """
        with requested_recovery(self._driver, self._lock):
            if not self._driver.why_not_ready():
                return
            if not self._driver.is_at_rest():
                raise ArmNotReadyError(
                    f"the arm is not known to be at rest: {self._driver.why_not_ready() or 'another node moves it'}"
                )
            self._start()
            self._driver.update_control(errors=())
            with self._driver.readiness() as readiness:
                readiness.release()
            if not self._driver.wait_until_ready(_READY_TIMEOUT):
                raise ArmNotReadyError(self._driver.why_not_ready())

    def _try_start(self) -> None:
        if not self._driver.is_at_rest():
            with self._driver.readiness() as readiness:
                if not readiness.preparation_error:  # the reason why it stopped is more useful
                    wait = "the velocity controller is started once the arm is at rest: stop what moves it"
                    readiness.set_unprepared(wait, retry=True)
            return
        try:
            self._start()
        except (RobotError, ServiceError) as error:
            with self._driver.readiness() as readiness:
                # What the robot rejects needs a person; what does not respond yet does not.
                readiness.set_unprepared(str(error), retry=isinstance(error, ServiceError))

    def _start(self) -> None:
        self._interface.start(self._config.rate)
        with self._driver.readiness() as readiness:
            readiness.set_prepared()
        rospy.loginfo("velocity controller started")
