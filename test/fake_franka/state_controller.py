"""franka_state_controller: the robot's published states."""

from __future__ import annotations

import numpy as np
import rospy
from franka_msgs.msg import Errors, FrankaState
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from fake_franka.controllers import JOINTS
from fake_franka.frames import Frames, matrix_of, transform_message
from fake_franka.joints import JointTracker
from fake_franka.robot import FakeRobot


class StateController:
    """Publishes on franka_state_controller/..., joint_states and /tf."""

    def __init__(self, robot: FakeRobot, frames: Frames) -> None:
        self._robot = robot
        self._frames = frames
        self._joints = JointTracker(matrix_of(robot.hand.position, robot.hand.orientation))
        space = "franka_state_controller/"
        self._states = rospy.Publisher(space + "franka_states", FrankaState, queue_size=1)
        self._joint_states = [
            rospy.Publisher(name, JointState, queue_size=1) for name in (space + "joint_states", "joint_states")
        ]
        self._transforms = rospy.Publisher("/tf", TFMessage, queue_size=1)

    def publish(self) -> None:
        """Publish all topics for this instant."""
        with self._robot.lock:
            self._robot.advance()
            stamp = rospy.Time.now()
            state = self._state(stamp)
            flange = matrix_of(self._robot.hand.position, self._robot.hand.orientation)
        self._states.publish(state)
        joints = JointState(state.header, list(JOINTS), state.q, state.dq, state.tau_J)
        for publisher in self._joint_states:
            publisher.publish(joints)
        frames = (("link0", "link8", flange), ("link8", "NE", np.eye(4)), ("NE", "EE", np.eye(4)))
        self._transforms.publish(TFMessage([transform_message(stamp, *frame) for frame in frames]))

    def _state(self, stamp: rospy.Time) -> FrankaState:
        robot, hand, frames = self._robot, self._robot.hand, self._frames
        state = FrankaState()
        state.header.stamp = stamp
        ee = matrix_of(hand.position, hand.orientation)
        twist = np.array([*hand.velocity, *hand.turning])
        state.q, state.dq = self._joints.follow(ee, twist)
        state.q_d = state.theta = state.q
        state.dq_d = state.dtheta = state.dq
        # Under torque control libfranka's desired and commanded poses are not those of the controller.
        state.O_T_EE = state.O_T_EE_d = state.O_T_EE_c = ee.T.ravel()
        state.F_T_EE = state.F_T_NE = state.NE_T_EE = state.EE_T_K = np.eye(4).ravel()
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
