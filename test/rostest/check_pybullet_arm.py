#!/usr/bin/env python3
"""The simulated arm as a node: topics, commands, stops, control and restored states."""

import subprocess
import threading
import unittest

import numpy as np
import rospy
import tf2_ros
from embodied_active_learning.msg import ArmCause, PlanarState
from embodied_active_learning.srv import GoToPose, MoveArm, RestoreArm
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_srvs.srv import Trigger

import rostest
from embodied_active_learning.ros.conversions import image_array, state_arrays
from embodied_active_learning.workspace import Workspace

TIMEOUT = 30.0


class PyBulletArmTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        for name in ("arm/move", "arm/go_to", "arm/heartbeat", "arm/stop", "arm/recover"):
            rospy.wait_for_service(name, TIMEOUT)
        cls.move = rospy.ServiceProxy("arm/move", MoveArm)
        cls.go_to = rospy.ServiceProxy("arm/go_to", GoToPose)
        cls.heartbeat = rospy.ServiceProxy("arm/heartbeat", Trigger)
        cls.stop = rospy.ServiceProxy("arm/stop", Trigger)
        cls.tf = tf2_ros.Buffer()
        cls.tf_listener = tf2_ros.TransformListener(cls.tf)

    def setUp(self):
        answer = self.go_to(0.475, 0.0, 0.0)
        self.assertTrue(answer.success, answer.message)

    def test_move_covers_velocity_times_duration(self):
        start, _ = state_arrays(self.move(0.1, -0.05, 0.5, 0.2).state)  # up to speed
        answer = self.move(0.1, -0.05, 0.5, 0.2)
        state, velocity = state_arrays(answer.state)
        self.assertTrue(answer.success)
        self.assertFalse(answer.limited)
        np.testing.assert_allclose(state - start, [0.02, -0.01, 0.1], atol=2e-3)
        np.testing.assert_allclose(velocity, [0.1, -0.05, 0.5], atol=2e-2)

    def test_image_state_joints_and_clock_share_one_stamp(self):
        stamp = self.move(0.1, 0.0, 0.0, 0.2).state.header.stamp
        for topic, message_class in (
            ("camera/image_raw", Image),
            ("camera/camera_info", CameraInfo),
            ("arm/state", PlanarState),
            ("joint_states", JointState),
        ):
            message = rospy.wait_for_message(topic, message_class, TIMEOUT)
            self.assertEqual(message.header.stamp, stamp, topic)
        self.assertEqual(rospy.wait_for_message("/clock", Clock, TIMEOUT).clock, stamp)

    def test_camera_publishes_calibrated_image(self):
        image = image_array(rospy.wait_for_message("camera/image_raw", Image, TIMEOUT), 180, 180)
        self.assertGreater(image.std(), 1.0)
        info = rospy.wait_for_message("camera/camera_info", CameraInfo, TIMEOUT)
        self.assertAlmostEqual(info.K[0], 90.0 / np.tan(np.radians(15.0)), places=6)
        self.assertEqual((info.width, info.height), (180, 180))

    def test_tf_agrees_with_arm_state(self):
        state = self.move(0.05, 0.1, 0.8, 0.2).state
        arrived = threading.Event()
        for _ in range(200):
            if self.tf.can_transform("panda_link0", "camera_optical_frame", state.header.stamp):
                break
            arrived.wait(0.05)
        transform = self.tf.lookup_transform("panda_link0", "camera_optical_frame", state.header.stamp).transform
        self.assertAlmostEqual(transform.translation.x, state.x, places=4)
        self.assertAlmostEqual(transform.translation.y, state.y, places=4)
        self.assertAlmostEqual(transform.translation.z, 0.3, places=3)

    def test_move_ends_inside_workspace(self):
        for _ in range(12):
            answer = self.move(0.15, 0.15, 1.5, 0.2)
        self.assertTrue(answer.limited)
        self.assertTrue(Workspace().contains(state_arrays(answer.state)[0]))

    def test_non_finite_velocity_is_rejected(self):
        before, _ = state_arrays(self.move(0.0, 0.0, 0.0, 0.2).state)
        answer = self.move(float("nan"), 0.0, 0.0, 0.2)
        self.assertFalse(answer.success)
        self.assertEqual(answer.cause, ArmCause.REFUSED)
        self.assertIn("finite", answer.message)
        after, _ = state_arrays(self.move(0.0, 0.0, 0.0, 0.2).state)
        np.testing.assert_allclose(after, before, atol=1e-4)

    def test_too_long_duration_is_rejected(self):
        self.assertFalse(self.move(0.1, 0.0, 0.0, 60.0).success)

    def test_pose_outside_workspace_is_rejected(self):
        answer = self.go_to(1.5, 0.0, 0.0)
        self.assertFalse(answer.success)
        self.assertEqual(answer.cause, ArmCause.REFUSED)
        self.assertIn("workspace", answer.message)

    def test_stop_by_other_node_lasts_until_recovery(self):
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)
        subprocess.run(["rosservice", "call", "/arm/stop"], check=True, timeout=TIMEOUT, stdout=subprocess.DEVNULL)
        answer = self.move(0.05, 0.0, 0.0, 0.2)
        self.assertFalse(answer.success)
        self.assertEqual(answer.cause, ArmCause.STOPPED)
        self.assertIn("stopped by /rosservice", answer.message)
        self.assertFalse(self.heartbeat().success)
        self.assertTrue(rospy.ServiceProxy("arm/recover", Trigger)().success)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_stop_by_commander_releases_control(self):
        headers = {"callerid": "/another_node"}
        move = rospy.ServiceProxy("arm/move", MoveArm, headers=headers)
        answer = move(0.05, 0.0, 0.0, 0.2)
        self.assertEqual(answer.cause, ArmCause.BUSY)
        self.assertIn("/check_pybullet_arm controls the arm", answer.message)
        self.assertTrue(self.stop().success)
        answer = move(0.05, 0.0, 0.0, 0.2)
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(rospy.ServiceProxy("arm/stop", Trigger, headers=headers)().success)

    def test_heartbeat_of_other_node_is_rejected(self):
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)
        self.assertTrue(self.heartbeat().success)
        answer = rospy.ServiceProxy("arm/heartbeat", Trigger, headers={"callerid": "/another_node"})()
        self.assertFalse(answer.success)
        self.assertIn("/check_pybullet_arm controls the arm, not /another_node", answer.message)

    def test_arm_stops_when_commander_falls_silent(self):
        reached = self.move(0.1, 0.0, 0.0, 0.2).state
        at_rest = threading.Event()

        def look(state):
            if state.header.stamp > reached.header.stamp and np.all(np.abs(state_arrays(state)[1]) < 1e-3):
                at_rest.set()

        subscriber = rospy.Subscriber("arm/state", PlanarState, look)
        self.assertTrue(at_rest.wait(TIMEOUT), "it still moves")
        subscriber.unregister()
        self.assertIn("no node controls the arm", self.heartbeat().message)

    def test_restore_repeats_motion_bit_for_bit(self):
        restore = rospy.ServiceProxy("arm/restore", RestoreArm)
        start = self.move(0.1, -0.05, 0.5, 0.2).state
        expected = self.move(-0.1, 0.1, 0.2, 0.2).state
        self.assertTrue(self.go_to(0.4, 0.1, 1.0).success)
        answer = restore(start.header.stamp)
        self.assertTrue(answer.success, answer.message)
        self.assert_same(answer.state, start)
        self.assert_same(self.move(-0.1, 0.1, 0.2, 0.2).state, expected)

    def assert_same(self, state, expected):
        """Stamp, pose and velocity; the sequence number of the header differs."""
        self.assertEqual(state.header.stamp, expected.header.stamp)
        np.testing.assert_array_equal(state_arrays(state), state_arrays(expected))

    def test_restore_rejects_unknown_stamp(self):
        before = self.move(0.0, 0.0, 0.0, 0.2).state
        answer = rospy.ServiceProxy("arm/restore", RestoreArm)(rospy.Time(10**6))
        self.assertEqual(answer.cause, ArmCause.REFUSED)
        self.assertIn("no saved arm state", answer.message)
        self.assertEqual(rospy.wait_for_message("arm/state", PlanarState, TIMEOUT).header.stamp, before.header.stamp)

    def test_stop_brings_arm_to_rest(self):
        self.move(0.1, 0.0, 0.0, 0.2)
        self.assertTrue(self.stop().success)
        state = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        np.testing.assert_allclose(state_arrays(state)[1], 0.0, atol=1e-4)


if __name__ == "__main__":
    rospy.init_node("check_pybullet_arm")
    rostest.rosrun("embodied_active_learning", "check_pybullet_arm", PyBulletArmTest)
