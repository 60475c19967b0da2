"""franka_state_controller: the robot's published states."""

from __future__ import annotations

import numpy as np
import rospy
from franka_msgs.msg import Errors, FrankaState
from geometry_msgs.msg import Vector3, WrenchStamped
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from fake_franka.controllers import JOINTS
from fake_franka.frames import ARM, Frames, matrix_of, transform_message
from fake_franka.joints import JointTracker
from fake_franka.robot import FakeRobot


class StateController:
    """Publishes on franka_state_controller/..., joint_states and /tf."""

    def __init__(self, robot: FakeRobot, frames: Frames) -> None:
        self._robot = robot
        self._frames = frames
        self._joints = JointTracker(frames.flange(robot.hand.position, robot.hand.orientation))
        space = "franka_state_controller/"
        self._states = rospy.Publisher(space + "franka_states", FrankaState, queue_size=1)
        self._joint_states = [
            rospy.Publisher(name, JointState, queue_size=1)
            for name in (space + "joint_states", space + "joint_states_desired", "joint_states")
        ]
        self._wrenches = rospy.Publisher(space + "F_ext", WrenchStamped, queue_size=1)
        self._transforms = rospy.Publisher("/tf", TFMessage, queue_size=1)
        # False if robot_state_publisher publishes the arm's links: a frame has one parent.
        self._places_flange = bool(rospy.get_param("~places_flange", True))

    def publish(self) -> None:
        """Publish all topics for this instant."""
        with self._robot.lock:
            self._robot.advance()
            stamp = rospy.Time.now()
            state = self._state(stamp)
            flange = self._frames.flange(self._robot.hand.position, self._robot.hand.orientation)
        self._states.publish(state)
        joints = JointState(state.header, list(JOINTS), state.q, state.dq, state.tau_J)
        for publisher in self._joint_states:
            publisher.publish(joints)
        wrench = WrenchStamped(header=state.header)
        wrench.header.frame_id = f"{ARM}_K"
        wrench.wrench.force, wrench.wrench.torque = Vector3(*state.K_F_ext_hat_K[:3]), Vector3(*state.K_F_ext_hat_K[3:])
        self._wrenches.publish(wrench)
        self._publish_transforms(stamp, flange)

    def _publish_transforms(self, stamp: rospy.Time, flange: np.ndarray) -> None:
        frames = self._frames
        transforms = [
            transform_message(stamp, "link8", "NE", frames.flange_to_nominal),
            transform_message(stamp, "NE", "EE", frames.nominal_to_ee),
            transform_message(stamp, "EE", "K", frames.ee_to_stiffness),
        ]
        if self._places_flange:
            transforms.append(transform_message(stamp, "link0", "link8", flange))
        self._transforms.publish(TFMessage(transforms))

    def _state(self, stamp: rospy.Time) -> FrankaState:
        robot, hand, frames = self._robot, self._robot.hand, self._frames
        state = FrankaState()
        state.header.stamp = stamp
        ee = matrix_of(hand.position, hand.orientation)
        twist = np.array([*hand.velocity, *hand.turning])
        state.q, state.dq = self._joints.follow(ee @ np.linalg.inv(frames.flange_to_ee), twist)
        state.q_d = state.theta = state.q
        state.dq_d = state.dtheta = state.dq
        # Under torque control libfranka's desired and commanded poses are not those of the controller.
        state.O_T_EE = state.O_T_EE_d = state.O_T_EE_c = ee.T.ravel()
        state.F_T_EE = frames.flange_to_ee.T.ravel()
        state.F_T_NE = frames.flange_to_nominal.T.ravel()
        state.NE_T_EE = frames.nominal_to_ee.T.ravel()
        state.EE_T_K = frames.ee_to_stiffness.T.ravel()
        state.m_load, state.F_x_Cload, state.I_load = frames.load
        state.m_total, state.F_x_Ctotal, state.I_total = frames.load
        state.O_ddP_O = [0.0, 0.0, -9.81]
        state.O_F_ext_hat_K = state.K_F_ext_hat_K = list(robot.felt)
        state.time = robot.time
        state.robot_mode = robot.mode
        state.control_command_success_rate = 1.0 if state.robot_mode == FrankaState.ROBOT_MODE_MOVE else 0.0
        state.current_errors = Errors(**dict.fromkeys(robot.errors, True))
        state.last_motion_errors = Errors(**dict.fromkeys(robot.last_motion_errors, True))
        return state
