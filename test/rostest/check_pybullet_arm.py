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

TIMEOUT = 120.0


class PyBulletArmTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        for name in ("arm/move", "arm/go_to", "arm/heartbeat", "arm/stop", "arm/recover"):
            rospy.wait_for_service(name, TIMEOUT)
        cls.move = rospy.ServiceProxy("arm/move", MoveArm)
        cls.go_to = rospy.ServiceProxy("arm/go_to", GoToPose)
        cls.heartbeat = rospy.ServiceProxy("arm/heartbeat", Trigger)
        cls.tf = tf2_ros.Buffer()
        cls.tf_listener = tf2_ros.TransformListener(cls.tf)

    def setUp(self):
        response = self.go_to(0.475, 0.0, 0.0)
        self.assertTrue(response.success, response.message)

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

    def test_non_finite_velocity_is_rejected(self):
        before, _ = state_arrays(self.move(0.0, 0.0, 0.0, 0.2).state)
        response = self.move(float("nan"), 0.0, 0.0, 0.2)
        self.assertFalse(response.success)
        self.assertEqual(response.cause, ArmCause.REFUSED)
        self.assertIn("finite", response.message)
        after, _ = state_arrays(self.move(0.0, 0.0, 0.0, 0.2).state)
        np.testing.assert_allclose(after, before, atol=1e-4)

    def test_stop_by_other_node_lasts_until_recovery(self):
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)
        subprocess.run(["rosservice", "call", "/arm/stop"], check=True, timeout=TIMEOUT, stdout=subprocess.DEVNULL)
        response = self.move(0.05, 0.0, 0.0, 0.2)
        self.assertFalse(response.success)
        self.assertEqual(response.cause, ArmCause.STOPPED)
        self.assertIn("stopped by /rosservice", response.message)
        self.assertFalse(self.heartbeat().success)
        self.assertTrue(rospy.ServiceProxy("arm/recover", Trigger)().success)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_arm_stops_when_commander_falls_silent(self):
        reached = self.move(0.1, 0.0, 0.0, 0.2).state
        at_rest = threading.Event()

        def on_state(state):
            if state.header.stamp > reached.header.stamp and np.all(np.abs(state_arrays(state)[1]) < 1e-3):
                at_rest.set()

        subscriber = rospy.Subscriber("arm/state", PlanarState, on_state)
        self.assertTrue(at_rest.wait(TIMEOUT), "it still moves")
        subscriber.unregister()
        self.assertIn("no node controls the arm", self.heartbeat().message)

    def test_restore_repeats_motion_bit_for_bit(self):
        restore = rospy.ServiceProxy("arm/restore", RestoreArm)
        start = self.move(0.1, -0.05, 0.5, 0.2).state
        expected = self.move(-0.1, 0.1, 0.2, 0.2).state
        self.assertTrue(self.go_to(0.4, 0.1, 1.0).success)
        response = restore(start.header.stamp)
        self.assertTrue(response.success, response.message)
        self.assert_same(response.state, start)
        self.assert_same(self.move(-0.1, 0.1, 0.2, 0.2).state, expected)

    def assert_same(self, state, expected):
        """Stamp, pose and velocity; the sequence number of the header differs."""
        self.assertEqual(state.header.stamp, expected.header.stamp)
        np.testing.assert_array_equal(state_arrays(state), state_arrays(expected))


if __name__ == "__main__":
    rospy.init_node("check_pybullet_arm")
    rostest.rosrun("embodied_active_learning", "check_pybullet_arm", PyBulletArmTest)
