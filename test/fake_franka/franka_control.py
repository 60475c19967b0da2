"""Services and action of franka_control: the setters of libfranka and the error recovery."""

from __future__ import annotations

import time
from typing import Any, Callable

import actionlib
import rospy
from franka_msgs.msg import ErrorRecoveryAction, ErrorRecoveryResult
from franka_msgs.srv import SetFullCollisionBehavior, SetLoad

from fake_franka.computer import Computer
from fake_franka.frames import Frames
from fake_franka.robot import CommandError, FakeRobot


class FrankaControl:
    """Offers franka_control/..."""

    def __init__(self, robot: FakeRobot, frames: Frames, computer: Computer) -> None:
        self._robot = robot
        self._frames = frames
        self._computer = computer
        self._recovery_time = float(rospy.get_param("~recovery_time", 0.5))
        self._offer("set_load", SetLoad, "Set Load", self._set_load)
        self._offer(
            "set_full_collision_behavior", SetFullCollisionBehavior, "Set Collision Behavior", self._set_force_limits
        )
        self._recovery = actionlib.SimpleActionServer(
            "franka_control/error_recovery", ErrorRecoveryAction, self.recover, auto_start=False
        )
        self._recovery.start()

    def recover(self, _goal: Any) -> None:
        """Action error_recovery."""
        self._computer.wait()
        try:
            self._robot.begin_recovery()
            time.sleep(self._recovery_time)
            self._computer.wait()
            self._robot.end_recovery()
        except CommandError as error:
            self._recovery.set_aborted(ErrorRecoveryResult(), str(error))
            return
        rospy.loginfo("Recovered from error")
        self._recovery.set_succeeded()

    def _offer(self, name: str, kind: Any, command: str, apply: Callable[[Any], None]) -> None:
        def set_it(request: Any) -> Any:
            try:
                self._robot.command(command, lambda: apply(request))
            except CommandError as error:
                rospy.logerr("%s", error)
                return kind._response_class(False, str(error))
            return kind._response_class(True, "")

        self._computer.offer(f"franka_control/{name}", kind, set_it)

    def _set_load(self, request: Any) -> None:
        self._frames.load = (request.mass, list(request.F_x_center_load), list(request.load_inertia))

    def _set_force_limits(self, request: Any) -> None:
        self._robot.force_limits = tuple(request.upper_force_thresholds_nominal)
