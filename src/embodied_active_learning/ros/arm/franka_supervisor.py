"""Keeps the robot fit to be moved: prepares it, watches its controllers, and recovers it from reflexes."""

from __future__ import annotations

import threading
import time
from typing import Callable

import rospy

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.errors import ArmNotReadyError, RobotError
from embodied_active_learning.franka.driver import FrankaDriver
from embodied_active_learning.franka.readiness import CONTROLLER, Condition
from embodied_active_learning.ros.arm.franka_interface import FrankaInterface, set_stiffness_parameters
from embodied_active_learning.ros.runtime.timers import WallTimer
from embodied_active_learning.ros.runtime.wait_log import log_wait

PERIOD = 0.1
"""Wall seconds between two looks at what is to be done."""
CONTROLLERS_PERIOD = 1.0
"""Wall seconds between two questions for the controllers."""
_READY_TIMEOUT = 5.0  # s after which a robot that was prepared or recovered is to follow
_PASSING = (Condition.STARTING, Condition.UNHEARD, Condition.RECOVERING)
_REST_TIMEOUT = 5.0  # s
_LOOK = 0.02  # s


class FrankaSupervisor:
    """A thread of its own that does what needs no person, and what a person asks for by recover.

    Another's controller is never stopped, since its motion may not bear being cut off: who started it is asked to stop
    it. Our own is stopped only at rest, in order to set what the robot takes with no controller running.
    """

    def __init__(self, link: FrankaInterface, driver: FrankaDriver, config: FrankaConfig) -> None:
        self._link = link
        self._driver = driver
        self._config = config
        self._hands = threading.Lock()  # held by the thread that has the robot do something
        self._asked_at = -CONTROLLERS_PERIOD
        WallTimer(PERIOD, self.look)
        threading.Thread(target=self._say_what_is_awaited, daemon=True).start()

    def look(self) -> None:
        """Ask for the controllers now and then; prepare the robot, or recover it, when it is time to."""
        with self._hands:
            if time.monotonic() >= self._asked_at + CONTROLLERS_PERIOD:
                self.see_controllers()
            with self._driver.lock:
                prepare, recover = self._driver.readiness.needs_preparation, self._driver.readiness.needs_recovery
            if prepare:
                self._prepare()
            elif recover:
                self._recover()

    def recover(self) -> None:
        """A person has looked at the robot, and has it go on.

        Raises ArmNotReadyError where it still cannot, and RobotError where it refuses.
        """
        with self._hands:
            with self._driver.lock:
                self._driver.readiness.release()
            self._settle()
            if self._condition() is Condition.REFLEX:
                self._recover_now()
                self._settle()
            if self._condition() in (Condition.UNPREPARED, Condition.STOPPED):
                self._prepare_now()  # a franka_control that was started anew knows nothing of before
            self._settle()
            if self._condition() is not Condition.READY:
                raise ArmNotReadyError(self._driver.why_not_ready())

    def see_controllers(self) -> None:
        """Tell the driver which controllers there are, and who else sends set-points."""
        self._asked_at = time.monotonic()
        try:
            controllers = self._link.controllers()
        except RobotError as error:
            rospy.logdebug("%s", error)
            controllers = None
        self._driver.update_control(
            controllers=controllers, rivals=tuple(self._link.rivals()), heard=self._link.is_heard
        )

    def _condition(self) -> Condition:
        self._driver.why_not_ready()  # by what is known now
        with self._driver.lock:
            return self._driver.readiness.condition

    def _settle(self) -> None:
        """Let pass what passes by itself: a controller that was just started, a connection that was just made."""
        ends_at = time.monotonic() + _READY_TIMEOUT
        self.see_controllers()
        while self._condition() in _PASSING and time.monotonic() < ends_at:
            self._driver.wait_until_ready(PERIOD)
            self.see_controllers()

    def _prepare(self) -> None:
        try:
            self._prepare_now()
        except RobotError as error:
            rospy.logerr("%s", error)
            with self._driver.lock:
                self._driver.readiness.not_prepared(str(error))

    def _prepare_now(self) -> None:
        """Set collision behaviour, load and stiffness, and start the controller. Raises RobotError."""
        ours = self._link.controllers().get(CONTROLLER)
        if ours is not None and ours.drives:
            self._wait_for_rest()
            self._link.stop()
        self._wait_for_end_of_motion()
        self._link.set_collision_behaviour(self._config)
        if self._config.load_mass > 0.0:
            self._link.set_load(self._config)
        if set_stiffness_parameters(self._config) and ours is not None:
            self._link.unload()
            ours = None
        if ours is None:
            self._link.load()
        self._link.start()
        with self._driver.lock:
            self._driver.readiness.prepared()
        self.see_controllers()
        rospy.loginfo(
            "the robot is prepared: %g N/m, %g Nm/rad; collision limits %s Nm, %s N and Nm",
            self._config.stiffness,
            self._config.turn_stiffness,
            list(self._config.torque_limits),
            list(self._config.force_limits),
        )

    def _wait_for_rest(self) -> None:
        """An arm that another node has left in motion, until it stands still. Raises RobotError."""
        with log_wait(lambda: "the arm to come to rest, before its controller is started anew"):
            if not _comes_about(self._driver.is_at_rest):
                raise RobotError(
                    f"{CONTROLLER} moves the arm, and not for this node: end whatever drives it, then call /arm/recover"
                )

    def _wait_for_end_of_motion(self) -> None:
        """A robot whose controller was stopped, until it takes settings: it is a while in Move. Raises RobotError."""
        if not _comes_about(lambda: not self._is_in_motion()):
            raise RobotError(
                "the robot is still in mode Move, although no controller moves it: look at franka_control, then call "
                "/arm/recover"
            )

    def _is_in_motion(self) -> bool:
        with self._driver.lock:
            return self._driver.readiness.is_in_motion

    def _recover(self) -> None:
        try:
            self._recover_now()
        except RobotError as error:
            rospy.logwarn("%s", error)

    def _recover_now(self) -> None:
        """Have the robot recover from its errors; its controllers begin anew where the arm is. Raises RobotError."""
        with self._driver.lock:
            readiness = self._driver.readiness
            errors = readiness.errors_in_words
            readiness.begin_recovery()
        rospy.logwarn("the robot is in a reflex (%s) and is recovered from it now", errors)
        refusal = "it was broken off"
        try:
            self._link.recover()
            refusal = ""
        except RobotError as error:
            refusal = str(error)
            raise
        finally:
            self.see_controllers()
            with self._driver.lock:
                readiness.end_recovery(refusal)

    def _say_what_is_awaited(self) -> None:
        """Name what the robot lacks as long as it lacks something."""
        while not rospy.is_shutdown():
            time.sleep(PERIOD)
            if not self._driver.why_not_ready():
                continue
            with log_wait(lambda: f"the robot: {self._driver.why_not_ready() or 'ready now'}", delay=1.0):
                while self._driver.why_not_ready() and not rospy.is_shutdown():
                    time.sleep(PERIOD)


def _comes_about(condition: Callable[[], bool]) -> bool:
    """Whether a condition holds before _REST_TIMEOUT has passed."""
    ends_at = time.monotonic() + _REST_TIMEOUT
    while not condition():
        if time.monotonic() >= ends_at:
            return False
        time.sleep(_LOOK)
    return True
