"""Supervisor of the Panda: prepares it, checks its controllers, and recovers it from reflexes."""

from __future__ import annotations

import threading
import time
from typing import Callable

import rospy

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.errors import ArmNotReadyError, RobotError
from embodied_active_learning.franka.report import CONTROLLER, Condition
from embodied_active_learning.franka.set_point_driver import SetPointDriver
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.franka_interface import FrankaInterface
from embodied_active_learning.ros.arm.requested_recovery import requested_recovery
from embodied_active_learning.ros.runtime.timers import WallTimer
from embodied_active_learning.ros.runtime.wait_log import log_wait

PERIOD = 0.1
"""Wall seconds between two checks of the robot's readiness."""
CONTROLLERS_PERIOD = 1.0
"""Wall seconds between two requests for the list of controllers."""
_READY_TIMEOUT = 5.0  # s that a prepared or recovered robot may take to follow its controller
_TRANSIENT = (Condition.STARTING, Condition.NO_SUBSCRIBER, Condition.RECOVERING)
_REST_TIMEOUT = 5.0  # s
_REST_PERIOD = 0.02  # s between two checks for rest


class FrankaSupervisor:
    """Keeps the robot ready: automatically where no person is needed, otherwise on request through `recover`.

    Controllers of others are never stopped, since their motion may not tolerate it: their owner is asked to. Our own is
    stopped only at rest, for settings that the robot accepts only without a controller.
    """

    def __init__(self, interface: FrankaInterface, driver: SetPointDriver, config: FrankaConfig) -> None:
        self._interface = interface
        self._driver = driver
        self._config = config
        self._lock = threading.Lock()  # held by the thread that makes the robot do something
        self._controllers_at = -CONTROLLERS_PERIOD
        WallTimer(PERIOD, self.check)

    def check(self) -> None:
        """Update the controllers periodically; prepare or recover the robot when it is time to."""
        with self._lock:
            if time.monotonic() >= self._controllers_at + CONTROLLERS_PERIOD:
                self.update_controllers()
            with self._driver.readiness() as readiness:
                prepare, recover = readiness.needs_preparation, readiness.needs_recovery
            if prepare:
                self._try_prepare()
            elif recover:
                self._try_recover()

    def recover(self) -> None:
        """Make the robot ready at the request of a person who has checked it; if that fails, hold it.

        Raises:
            ArmNotReadyError: The robot is still not ready, or is being prepared or recovered.
            RobotError: The robot rejected a request.
        """
        with requested_recovery(self._driver, self._lock):
            with self._driver.readiness() as readiness:
                readiness.release()
            self._wait_while_transient()
            prepare = False
            if self._condition() in (Condition.REFLEX, Condition.RECOVERY_REQUIRED):
                prepare = self._clear_errors()
            if prepare or self._condition() is Condition.UNPREPARED:
                self._prepare()  # a restarted franka_control has lost all settings
                self._wait_while_transient()
            if self._condition() is not Condition.READY:
                raise ArmNotReadyError(self._driver.why_not_ready())

    def update_controllers(self) -> None:
        """Pass the list of controllers and the set-points' publishers and subscribers on to the driver."""
        self._controllers_at = time.monotonic()
        try:
            controllers = self._interface.controllers()
        except RobotError as error:
            rospy.logdebug("%s", error)
            controllers = None
        publishers = tuple(self._interface.other_publishers())
        self._driver.update_control(
            controllers=controllers, publishers=publishers, has_subscriber=self._interface.has_subscriber
        )

    def _condition(self) -> Condition:
        with self._driver.readiness() as readiness:
            return readiness.condition

    def _has_error(self) -> bool:
        with self._driver.readiness() as readiness:
            return readiness.has_error

    def _wait_while_transient(self) -> None:
        """Update the controllers, and wait for transient conditions to pass, such as a controller that just started."""
        deadline = time.monotonic() + _READY_TIMEOUT
        self.update_controllers()
        while self._condition() in _TRANSIENT and time.monotonic() < deadline:
            self._driver.wait_until_ready(PERIOD)
            self.update_controllers()

    def _clear_errors(self) -> bool:
        """Recover the robot from its errors; return whether it has to be prepared again. Raises RobotError.

        franka_control from 0.10.2 on recovers only from errors that have ended a motion of its own. It ignores one from
        before its start until a controller is started and its motion is rejected.
        """
        self._require_no_others()
        self._recover_on_request()
        if not self._has_error():
            return False
        self._require_no_others()
        rospy.logwarn("the robot still reports its error: starting %s so that franka_control notices it", CONTROLLER)
        ours = self._interface.controllers().get(CONTROLLER)
        self._reject_commands()
        if ours is None:
            self._interface.load()
        if ours is None or not ours.is_active:
            self._interface.start()
        self._recover_on_request()
        if self._has_error():
            with self._driver.readiness() as readiness:
                errors = readiness.report.error_names
            raise RobotError(
                f"the robot still reports {errors} after the recovery: press and release the user stop, or lock and "
                f"unlock the joints in Desk, then call {rospy.resolve_name(names.ARM_RECOVER)}"
            )
        return True

    def _require_no_others(self) -> None:
        """Raise RobotError if others may move the robot, as last updated: a recovery would restart their motion."""
        with self._driver.readiness() as readiness:
            others = readiness.report.others
        if others:
            raise RobotError(
                f"{', '.join(others)} may move the robot: stop that controller or node, then call "
                f"{rospy.resolve_name(names.ARM_RECOVER)}"
            )

    def _recover_on_request(self) -> None:
        self._recover()
        self._forget_reflexes()
        self._wait_while_transient()
        self._forget_reflexes()

    def _forget_reflexes(self) -> None:
        with self._driver.readiness() as readiness:
            readiness.forget_reflexes()

    def _try_prepare(self) -> None:
        try:
            self._prepare()
        except RobotError as error:
            rospy.logerr("%s", error)
            with self._driver.readiness() as readiness:
                readiness.set_unprepared(str(error))

    def _prepare(self) -> None:
        """Set collision behaviour, load and stiffness, and start the controller. Raises RobotError."""
        self._reject_commands()
        ours = self._interface.controllers().get(CONTROLLER)
        if ours is not None and ours.is_active:
            self._wait_for_rest()
            self._interface.stop()
        self._wait_for_end_of_motion()
        self._interface.set_collision_behaviour(self._config)
        self._interface.set_load(self._config)
        if ours is None:
            self._interface.load()
        self._interface.set_stiffness(self._config)
        self._interface.start()
        self.update_controllers()  # before it: a controller that is not known to run was stopped by another node
        with self._driver.readiness() as readiness:
            readiness.set_prepared()
        rospy.loginfo(
            "robot prepared: stiffness %g N/m and %g Nm/rad, collision limits %s Nm and %s N, Nm, load %g kg",
            self._config.stiffness,
            self._config.turn_stiffness,
            list(self._config.torque_limits),
            list(self._config.force_limits),
            self._config.load_mass,
        )

    def _reject_commands(self) -> None:
        """Reject commands until the robot is prepared: its controller may run with other settings, and is stopped."""
        with self._driver.readiness() as readiness:
            readiness.set_unprepared("the robot is being prepared", retry=True)

    def _wait_for_rest(self) -> None:
        """Wait until the arm, which another node may have left in motion, is at rest. Raises RobotError."""
        with log_wait(lambda: "the arm to come to rest before its controller is restarted"):
            if not _wait_until(self._driver.is_at_rest):
                raise RobotError(
                    f"{CONTROLLER} moves the arm on behalf of another node: stop that node, then call "
                    f"{rospy.resolve_name(names.ARM_RECOVER)}"
                )

    def _wait_for_end_of_motion(self) -> None:
        """Wait until a robot whose controller was stopped leaves mode Move and accepts settings. Raises RobotError."""
        if not _wait_until(lambda: not self._is_in_motion()):
            raise RobotError(
                "the robot is still in mode Move although no controller moves it: check franka_control, then call "
                f"{rospy.resolve_name(names.ARM_RECOVER)}"
            )

    def _is_in_motion(self) -> bool:
        with self._driver.readiness() as readiness:
            return readiness.is_in_motion

    def _try_recover(self) -> None:
        try:
            self._recover()
        except RobotError as error:
            rospy.logwarn("%s", error)

    def _recover(self) -> None:
        """Recover from errors; the running controllers restart where the arm is. Raises RobotError."""
        with self._driver.readiness() as readiness:
            errors = readiness.report.error_names
            readiness.begin_recovery()
        rospy.logwarn("robot reflex (%s): recovering", errors)
        failure = "aborted"
        try:
            self._interface.recover()
            failure = ""
        except RobotError as error:
            failure = str(error)
            raise
        finally:
            with self._driver.readiness() as readiness:
                readiness.end_recovery(failure)
            self.update_controllers()


def _wait_until(condition: Callable[[], bool]) -> bool:
    """Wait up to _REST_TIMEOUT for a condition; return whether it holds."""
    deadline = time.monotonic() + _REST_TIMEOUT
    while not condition():
        if time.monotonic() >= deadline:
            return False
        time.sleep(_REST_PERIOD)
    return True
