#!/usr/bin/env python3
"""The pre-flight check beside a stand-in for a real Panda: what it finds in order, and what it finds when it is not."""

import sys
import time
import unittest
from pathlib import Path

import rospy
from embodied_active_learning.srv import MoveArm
from std_srvs.srv import SetBool

import rostest
from embodied_active_learning.config import merge

sys.path.insert(0, str(Path(__file__).resolve().parent))

from preflight_run import TIMEOUT, PreflightRun

ROBOT = {"robot state", "robot mode", "controllers", "error recovery", "camera", "frames", "camera's place", "reach"}


class PreflightFrankaTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.wait_for_service("arm/move", TIMEOUT)
        rospy.wait_for_message("camera/image_raw", rospy.AnyMsg, TIMEOUT)
        move, give_up_at = rospy.ServiceProxy("arm/move", MoveArm), time.monotonic() + TIMEOUT
        while not move(0.0, 0.0, 0.0, 0.05).success:  # the robot is still being prepared
            assert time.monotonic() < give_up_at
            time.sleep(0.1)

    def test_robot_and_camera_are_in_order(self):
        run = PreflightRun()
        # The stand-in's camera has no noise, so that an arm that stands still gives the same image again and again.
        self.assertEqual(set(run.findings) - run.about("OK"), {"picture"}, run.output)
        self.assertLessEqual(ROBOT, run.about("OK"), run.output)
        self.assertEqual(run.status, 2, run.output)

    def test_the_arm_is_looked_at_with_its_own_configuration_and_a_system_that_disagrees_is_named(self):
        own = rospy.get_param("/franka_arm/config")
        for system, level in ((own, "OK"), (merge(own, {"arm": {"robot": "pybullet"}}), "MISSING")):
            rospy.set_param("/config", system)
            run = PreflightRun()
            rospy.delete_param("/config")
            self.assertEqual(run.findings["agreement"], level, run.output)
            self.assertLessEqual(ROBOT, run.about("OK"), run.output)
            self.assertIn("parameter /franka_arm/config, arm/robot franka", run.output)
        self.assertIn("arm/robot is 'pybullet' in the system's configuration, and 'franka' in the arm's", run.output)

    def test_a_user_stop_and_a_silent_camera_are_both_named(self):
        for fault in ("user_stop", "silence_camera"):
            rospy.ServiceProxy(f"fake_franka/{fault}", SetBool)(True)
        run = PreflightRun()
        for fault in ("user_stop", "silence_camera"):
            rospy.ServiceProxy(f"fake_franka/{fault}", SetBool)(False)
        self.assertEqual(run.about("MISSING"), {"robot mode", "camera", "images", "camera matrix"}, run.output)
        self.assertEqual(run.status, 1, run.output)
        self.assertIn("release the user stop", run.output)


if __name__ == "__main__":
    rospy.init_node("check_preflight_franka")
    rostest.rosrun("embodied_active_learning", "check_preflight_franka", PreflightFrankaTest)
