"""Base class of the nodes that move a real arm: connects the arm's services with its driver and its supervisor."""

from __future__ import annotations

import sys
from abc import abstractmethod
from contextlib import suppress
from typing import Callable, ClassVar, Dict, Optional, Sequence

import rospy

from embodied_active_learning.arm_requests import StopSignal
from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmFailedError, ConfigError
from embodied_active_learning.franka.set_point_driver import Reached, SetPointDriver
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.config_check import ConfigCheck
from embodied_active_learning.ros.arm.rate_loop import RateLoop
from embodied_active_learning.ros.arm.server import ArmServer, MoveOutcome
from embodied_active_learning.ros.conversions import state_message
from embodied_active_learning.ros.runtime import persistent_parameters
from embodied_active_learning.ros.runtime.diagnostics import ERROR, Health
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle
from embodied_active_learning.ros.runtime.node import publish
from embodied_active_learning.ros.runtime.timers import WallTimer

SWITCH_INTERVAL = 0.001
"""s between switches of Python threads: the thread that sends must not wait for a service's thread."""
_LOG_CHECK_PERIOD = 1.0
"""Wall seconds between two checks whether commands are rejected, for the log; shorter interruptions are not logged."""


class DriverArm(ArmServer):
    """Moves the arm through its driver. Subclasses connect the driver with the robot, then call `start`."""

    ROBOT: ClassVar[str]
    """The value of arm/robot that the node is for."""

    def __init__(self, config: Config, driver: SetPointDriver) -> None:
        """Raises ConfigError if the configuration is for another robot."""
        if config.arm.robot != self.ROBOT:
            raise ConfigError(
                f"arm/robot is {config.arm.robot}, but {rospy.get_name()} moves a robot of kind {self.ROBOT}: start it "
                f"with robot:={self.ROBOT}"
            )
        super().__init__(config)
        self._driver = driver
        with driver.readiness() as readiness:
            readiness.recovery_service = rospy.resolve_name(names.ARM_RECOVER)
            readiness.hold(persistent_parameters.load(names.HELD_FOR))
        persistent_parameters.store(names.HELD_FOR, self._held_for)
        self._config_check = ConfigCheck(config)
        self._throttle = LogThrottle()
        self._rate = config.franka.rate
        self._states = rospy.Publisher(names.ARM_STATE, PlanarState, queue_size=10, tcp_nodelay=True)

    def start(self, recover: Callable[[], None]) -> None:
        """Start to send, and offer the services.

        Args:
            recover: makes the robot ready at a person's request; raises EmbodiedActiveLearningError.
        """
        self._recover = recover
        sys.setswitchinterval(SWITCH_INTERVAL)
        rospy.on_shutdown(self.close)  # the robot can still be reached then
        self._loop = RateLoop(self._rate, self.send)
        WallTimer(_LOG_CHECK_PERIOD, self._log_rejection)
        self.advertise_services()

    @abstractmethod
    def send(self) -> None:
        """Send what the driver's next tick requires; called at franka/rate."""

    def send_last(self) -> None:
        """Leave the robot at rest after `send` has failed, on shutdown. One that holds its set-point needs nothing."""

    def spin(self) -> None:
        """Return when the node ends. Raises the error that has ended the calls of `send`, if any."""
        rospy.spin()
        if self._loop.failure is not None:
            raise self._loop.failure

    def close(self) -> None:
        """Bring the arm to rest and leave it there."""
        self.arbiter.close()
        if self._loop.failure is None:
            with suppress(ArmFailedError):  # of a robot that does not respond
                self._driver.stop()
        else:
            self.send_last()
        self._loop.end()

    def update_state(
        self,
        stamp: rospy.Time,
        end_effector: Sequence[float],
        mode: int,
        errors: Optional[Sequence[str]] = None,
        last_errors: Sequence[str] = (),
    ) -> bool:
        """Pass a state of the robot on to the driver and publish the camera's; return whether it is usable.

        Args:
            stamp: Of the state.
            end_effector: O_T_EE, (16,) column by column.
            mode: franka_msgs/FrankaState.robot_mode.
            errors: Names of the present errors; None if the robot does not report them.
            last_errors: Names of the errors that ended the last motion.
        """
        delay = (rospy.Time.now() - stamp).to_sec()
        reached = self._driver.update_state(stamp.to_sec(), delay, end_effector, mode, errors, last_errors)
        if reached is not None:
            publish(self._states, _message(reached))
        return reached is not None

    def move(self, velocity: Sequence[float], duration: float, stop: StopSignal) -> MoveOutcome:
        """See ArmServer."""
        self._config_check.require()
        reached = self._driver.move(velocity, duration, stop)
        return MoveOutcome(_message(reached), reached.limited)

    def go_to(self, pose: Sequence[float], stop: StopSignal) -> PlanarState:
        """See ArmServer."""
        self._config_check.require()
        return _message(self._driver.go_to(pose, stop))

    def stop(self) -> None:
        """See ArmServer."""
        self._driver.stop()

    def recover(self) -> None:
        """See ArmServer."""
        self._recover()

    def arm_health(self) -> Health:
        """See ArmServer."""
        values, rejection = self.values(), self._rejection()
        return Health(ERROR, rejection, values) if rejection else Health(message="ready", values=values)

    def _rejection(self) -> str:
        """Return why commands are rejected; empty if they are not."""
        why = self._driver.why_not_ready() or self._config_check.mismatch
        return f"rejecting commands: {why}" if why else ""

    def _log_rejection(self) -> None:
        rejection = self._rejection()
        if rejection and self._throttle.should_log(rejection):
            rospy.logwarn("%s", rejection)

    def values(self) -> Dict[str, object]:
        """Return the figures for diagnostics."""
        typical, largest = 1e3 * self._loop.lateness(0.99), 1e3 * self._loop.lateness(1.0)
        late = {"set-points late, 99 % and maximum [ms]": f"{typical:.1f}, {largest:.1f}"}
        return {**self._driver.values(), **late}

    def _held_for(self) -> str:
        with self._driver.readiness() as readiness:
            return readiness.held_for


def _message(reached: Reached) -> PlanarState:
    return state_message(rospy.Time.from_sec(reached.stamp), reached.pose, reached.velocity)
