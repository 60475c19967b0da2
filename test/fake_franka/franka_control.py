"""Services and action of franka_control: the setters of libfranka and the error recovery."""

from __future__ import annotations

import time
from typing import Any, Callable

import actionlib
import rospy
from franka_msgs.msg import ErrorRecoveryAction, ErrorRecoveryResult
from franka_msgs.srv import (
    SetCartesianImpedance,
    SetEEFrame,
    SetForceTorqueCollisionBehavior,
    SetFullCollisionBehavior,
    SetJointImpedance,
    SetKFrame,
    SetLoad,
)

from fake_franka.computer import Computer
from fake_franka.frames import Frames, from_columns, pose_of
from fake_franka.robot import CommandError, FakeRobot

_LOOK_AGAIN = 0.005  # s


class FrankaControl:
    """Offers franka_control/..."""

    def __init__(self, robot: FakeRobot, frames: Frames, computer: Computer) -> None:
        self._robot = robot
        self._frames = frames
        self._computer = computer
        self._recovery_time = float(rospy.get_param("~recovery_time", 0.5))
        # In franka_ros 0.10 setters and recoveries wait while the control loop runs; before, the robot rejected them.
        self._waits_for_motion = bool(rospy.get_param("~waits_for_motion", False))
        collision = "Set Collision Behavior"
        self._offer("set_load", SetLoad, "Set Load", self._set_load)
        self._offer("set_EE_frame", SetEEFrame, "Set NE to EE", self._set_ee_frame)
        self._offer("set_K_frame", SetKFrame, "Set EE to K", self._set_k_frame)
        # Of the internal controllers, which are inactive under torque control.
        self._offer("set_cartesian_impedance", SetCartesianImpedance, "Set Cartesian Impedance", lambda _request: None)
        self._offer("set_joint_impedance", SetJointImpedance, "Set Joint Impedance", lambda _request: None)
        self._offer(
            "set_force_torque_collision_behavior", SetForceTorqueCollisionBehavior, collision, self._set_force_limits
        )
        self._offer("set_full_collision_behavior", SetFullCollisionBehavior, collision, self._set_force_limits)
        self._recovery = actionlib.SimpleActionServer(
            "franka_control/error_recovery", ErrorRecoveryAction, self.recover, auto_start=False
        )
        self._recovery.start()

    def recover(self, _goal: Any) -> None:
        """Action error_recovery."""
        self._computer.wait()
        self._wait_for_motion()
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
            self._wait_for_motion()
            try:
                self._robot.command(command, lambda: apply(request))
            except CommandError as error:
                rospy.logerr("%s", error)
                return kind._response_class(False, str(error))
            return kind._response_class(True, "")

        self._computer.offer(f"franka_control/{name}", kind, set_it)

    def _wait_for_motion(self) -> None:
        while self._waits_for_motion and self._robot.is_driven and not rospy.is_shutdown():
            time.sleep(_LOOK_AGAIN)

    def _set_load(self, request: Any) -> None:
        self._frames.load = (request.mass, list(request.F_x_center_load), list(request.load_inertia))

    def _set_ee_frame(self, request: Any) -> None:
        hand = self._robot.hand
        flange = self._frames.flange(hand.position, hand.orientation)
        self._frames.nominal_to_ee = from_columns(request.NE_T_EE)
        position, hand.orientation = pose_of(flange @ self._frames.flange_to_ee)
        hand.position = list(position)

    def _set_k_frame(self, request: Any) -> None:
        self._frames.ee_to_stiffness = from_columns(request.EE_T_K)

    def _set_force_limits(self, request: Any) -> None:
        self._robot.force_limits = tuple(request.upper_force_thresholds_nominal)
