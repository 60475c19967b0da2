#!/usr/bin/env python3
"""The stand-in for franka_ros as a node: topics, services and actions as a client of franka_ros expects them."""

import json
import sys
import threading
import time
import unittest
from pathlib import Path

import actionlib
import rospy
import tf2_ros
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_srvs.srv import SetBool, Trigger

import rostest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fake_franka.generate import use_messages

use_messages()

from controller_manager_msgs.srv import (  # noqa: E402  made just now
    ListControllers,
    LoadController,
    SwitchController,
    SwitchControllerRequest,
)
from dynamic_reconfigure.msg import Config, DoubleParameter  # noqa: E402
from dynamic_reconfigure.srv import Reconfigure  # noqa: E402
from franka_msgs.msg import ErrorRecoveryAction, ErrorRecoveryGoal, FrankaState  # noqa: E402
from franka_msgs.srv import SetEEFrame, SetFullCollisionBehavior, SetLoad  # noqa: E402

TIMEOUT = 30.0
IMPEDANCE = "cartesian_impedance_example_controller"
IDENTITY = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]


class FakeFrankaTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states = []
        cls.changed = threading.Condition()
        rospy.Subscriber("franka_state_controller/franka_states", FrankaState, cls.hear)
        cls.load = cls.service("controller_manager/load_controller", LoadController)
        cls.switch_service = cls.service("controller_manager/switch_controller", SwitchController)
        cls.list = cls.service("controller_manager/list_controllers", ListControllers)
        cls.truth_service = cls.service("fake_franka/truth", Trigger)
        cls.set_points = rospy.Publisher(f"{IMPEDANCE}/equilibrium_pose", PoseStamped, queue_size=1)
        cls.recovery = actionlib.SimpleActionClient("franka_control/error_recovery", ErrorRecoveryAction)
        assert cls.recovery.wait_for_server(rospy.Duration(TIMEOUT))
        assert cls.load(IMPEDANCE).ok

    @classmethod
    def hear(cls, state):
        with cls.changed:
            cls.states = [*cls.states[-9:], state]
            cls.changed.notify_all()

    @staticmethod
    def service(name, kind):
        rospy.wait_for_service(name, TIMEOUT)
        return rospy.ServiceProxy(name, kind)

    def setUp(self):
        self.switch(stop=[IMPEDANCE])
        self.until(lambda state: not any(state.dq), "an arm at rest")
        self.truth()

    def until(self, condition, what):
        """Return the next state that fulfils a condition."""
        with self.changed:
            self.states.clear()
            found = self.changed.wait_for(lambda: self.states and condition(self.states[-1]), TIMEOUT)
            self.assertTrue(found, f"never seen: {what}")
            return self.states[-1]

    def until_mode(self, mode):
        return self.until(lambda state: state.robot_mode == mode, f"robot mode {mode}")

    def switch(self, start=(), stop=(), strictness=SwitchControllerRequest.BEST_EFFORT):
        return self.switch_service(start, stop, strictness, False, 0.0).ok

    def truth(self):
        return json.loads(self.truth_service().message)

    def drive(self):
        self.assertTrue(self.switch(start=[IMPEDANCE], strictness=SwitchControllerRequest.STRICT))
        return self.until_mode(FrankaState.ROBOT_MODE_MOVE)

    def send(self, state, shift):
        """Send a set-point shifted along y from the hand's pose in a state."""
        message = PoseStamped()
        message.pose.position.x, message.pose.position.y, message.pose.position.z = state.O_T_EE[12:15]
        message.pose.position.y += shift
        message.pose.orientation.x = 1.0
        self.set_points.publish(message)

    def recover(self):
        self.recovery.send_goal(ErrorRecoveryGoal())
        self.assertTrue(self.recovery.wait_for_result(rospy.Duration(TIMEOUT)))
        return self.recovery.get_state(), self.recovery.get_goal_status_text()

    def set_fault(self, name, on):
        self.assertTrue(self.service(f"fake_franka/{name}", SetBool)(on).success)

    def test_state_controller_publishes_all_topics(self):
        state = self.until_mode(FrankaState.ROBOT_MODE_IDLE)
        self.assertEqual(list(state.F_T_EE), IDENTITY)
        self.assertAlmostEqual(state.O_T_EE[12], 0.475, places=6)
        self.assertEqual(state.O_T_EE[15], 1.0)
        joints = rospy.wait_for_message("franka_state_controller/joint_states", JointState, TIMEOUT)
        self.assertEqual(joints.name[0], "panda_joint1")
        self.assertLess(abs(state.q[3] + 2.4), 0.3)
        buffer = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(buffer)
        found = buffer.lookup_transform("panda_link0", "panda_EE", rospy.Time(0), rospy.Duration(TIMEOUT))
        listener.unregister()
        self.assertAlmostEqual(found.transform.translation.z, state.O_T_EE[14], places=5)

    def test_started_controller_moves_arm_to_set_point(self):
        at = self.until_mode(FrankaState.ROBOT_MODE_IDLE)
        self.drive()
        running = {one.name: one for one in self.list().controller}
        self.assertEqual(running[IMPEDANCE].state, "running")
        claimed = {one.hardware_interface: one.resources for one in running[IMPEDANCE].claimed_resources}
        self.assertEqual(len(claimed["hardware_interface::EffortJointInterface"]), 7)
        self.send(at, 0.02)
        self.until(lambda state: abs(state.O_T_EE[13] - at.O_T_EE[13] - 0.02) < 1e-3, "the hand at its set-point")
        self.assertGreater(self.truth()["max_speed"], 0.01)

    def test_setters_need_stopped_controllers(self):
        set_load, set_frame = self.service("franka_control/set_load", SetLoad), "franka_control/set_EE_frame"
        self.assertTrue(set_load(0.2, [0.0] * 3, [0.0] * 9).success)
        self.until(lambda state: state.m_load == 0.2, "the load")
        self.drive()
        answer = set_load(0.3, [0.0] * 3, [0.0] * 9)
        self.assertFalse(answer.success)
        self.assertIn("command not possible in the current mode", answer.error)
        self.switch(stop=[IMPEDANCE])
        longer = [*IDENTITY[:14], 0.1, 1.0]
        self.assertTrue(self.service(set_frame, SetEEFrame)(longer).success)
        state = self.until(lambda state: state.F_T_EE[14] == 0.1, "the frame")
        self.assertAlmostEqual(state.O_T_EE[14], 0.2, places=6)
        self.assertTrue(self.service(set_frame, SetEEFrame)(IDENTITY).success)
        self.until(lambda state: state.F_T_EE[14] == 0.0, "the frame as it was")
        limits = [[20.0] * 7] * 4 + [[30.0] * 6] * 4
        self.assertTrue(self.service("franka_control/set_full_collision_behavior", SetFullCollisionBehavior)(*limits))

    def test_reflex_stops_arm_until_recovery(self):
        at = self.drive()
        self.send(at, 0.3)
        self.assertTrue(self.until_mode(FrankaState.ROBOT_MODE_REFLEX).current_errors.cartesian_reflex)
        self.service("fake_franka/fail_next_recovery", Trigger)()
        state, text = self.recover()
        self.assertEqual(state, GoalStatus.ABORTED)
        self.assertIn("manual error recovery required", text)
        self.assertEqual(self.recover()[0], GoalStatus.SUCCEEDED)
        state = self.until_mode(FrankaState.ROBOT_MODE_MOVE)
        self.assertFalse(state.current_errors.cartesian_reflex)
        self.assertTrue(state.last_motion_errors.cartesian_reflex)

    def test_user_stop_holds_arm_and_rejects_recovery(self):
        self.drive()
        self.set_fault("user_stop", True)
        self.until_mode(FrankaState.ROBOT_MODE_USER_STOPPED)
        self.assertEqual(self.recover()[0], GoalStatus.ABORTED)
        self.set_fault("user_stop", False)
        self.until_mode(FrankaState.ROBOT_MODE_IDLE)
        self.assertEqual(self.recover()[0], GoalStatus.SUCCEEDED)
        self.until_mode(FrankaState.ROBOT_MODE_MOVE)

    def test_silent_computer_stops_robot(self):
        self.drive()
        self.set_fault("silence_everything", True)
        with self.changed:
            self.states.clear()
        answers = []
        asking = threading.Thread(target=lambda: answers.append(self.list()), daemon=True)
        asking.start()
        poses = [rospy.wait_for_message("fake_franka/true_pose", PoseStamped, TIMEOUT) for _ in range(3)]
        self.assertEqual(len(poses), 3)
        self.assertEqual(self.states, [])
        self.assertEqual(answers, [])
        self.set_fault("silence_everything", False)
        state = self.until_mode(FrankaState.ROBOT_MODE_REFLEX)
        self.assertTrue(state.current_errors.communication_constraints_violation)
        asking.join(TIMEOUT)
        self.assertEqual(len(answers), 1)
        self.assertEqual(self.recover()[0], GoalStatus.SUCCEEDED)

    def test_stiffness_is_set_through_dynamic_reconfigure(self):
        name = f"{IMPEDANCE}/dynamic_reconfigure_compliance_param_node/set_parameters"
        request = Config(doubles=[DoubleParameter("translational_stiffness", 1000.0)])
        told = {one.name: one.value for one in self.service(name, Reconfigure)(request).config.doubles}
        self.assertEqual(told["translational_stiffness"], 400.0)  # the maximum
        self.assertEqual(told["rotational_stiffness"], 10.0)
        request.doubles[0].value = 200.0
        self.service(name, Reconfigure)(request)

    def test_frozen_camera_repeats_image_with_new_stamps(self):
        image = rospy.wait_for_message("usb_cam/image_raw", Image, TIMEOUT)
        self.assertEqual((image.width, image.height, image.encoding, image.step), (640, 360, "yuv422", 1280))
        self.assertLess(abs(image.header.stamp.to_sec() - time.time()), TIMEOUT)
        info = rospy.wait_for_message("usb_cam/camera_info", CameraInfo, TIMEOUT)
        self.assertEqual((info.width, info.height), (640, 360))
        self.set_fault("freeze_camera", True)
        first = rospy.wait_for_message("usb_cam/image_raw", Image, TIMEOUT)
        self.send(self.drive(), 0.05)
        self.until(lambda state: abs(state.dq[0]) > 1e-3, "motion")
        second = rospy.wait_for_message("usb_cam/image_raw", Image, TIMEOUT)
        self.set_fault("freeze_camera", False)
        self.assertEqual(first.data, second.data)
        self.assertGreater(second.header.stamp, first.header.stamp)


if __name__ == "__main__":
    rospy.init_node("check_fake_franka")
    rostest.rosrun("embodied_active_learning", "check_fake_franka", FakeFrankaTest)
