#!/usr/bin/env python3
"""Preflight with a fake Panda, in good order and with faults."""

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

ROBOT = {"robot state", "robot mode", "controllers", "error recovery", "camera", "frames", "camera pose", "reach"}


class PreflightFrankaTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.wait_for_service("arm/move", TIMEOUT)
        rospy.wait_for_message("camera/image_raw", rospy.AnyMsg, TIMEOUT)
        move, give_up_at = rospy.ServiceProxy("arm/move", MoveArm), time.monotonic() + TIMEOUT
        while not move(0.0, 0.0, 0.0, 0.05).success:  # the robot is not ready yet
            assert time.monotonic() < give_up_at
            time.sleep(0.1)

    def test_robot_and_camera_pass(self):
        run = PreflightRun()
        # The fake camera has no noise, so a resting arm gives identical images.
        self.assertEqual(set(run.levels) - run.names("OK"), {"image content"}, run.output)
        self.assertLessEqual(ROBOT, run.names("OK"), run.output)
        self.assertEqual(run.status, 2, run.output)

    def test_config_mismatch_of_arm_and_system_is_an_error(self):
        own = rospy.get_param("/franka_arm/config")
        for system, level in ((own, "OK"), (merge(own, {"arm": {"robot": "pybullet"}}), "ERROR")):
            rospy.set_param("/config", system)
            run = PreflightRun()
            rospy.delete_param("/config")
            self.assertEqual(run.levels["config check"], level, run.output)
            self.assertLessEqual(ROBOT, run.names("OK"), run.output)
            self.assertIn("parameter /franka_arm/config, arm/robot franka", run.output)
        self.assertIn("arm/robot is 'pybullet' in the system and 'franka' in the arm's node", run.output)

    def test_hanging_controller_manager_is_an_error(self):
        hang = rospy.ServiceProxy("fake_franka/hang_controller_manager", SetBool)
        self.addCleanup(hang, False)
        hang(True)
        run = PreflightRun()
        self.assertEqual(run.levels["controllers"], "ERROR", run.output)
        self.assertIn("no response from /controller_manager/list_controllers: none within", run.output)

    def test_user_stop_and_silent_camera_are_errors(self):
        for fault in ("user_stop", "silence_camera"):
            rospy.ServiceProxy(f"fake_franka/{fault}", SetBool)(True)
        run = PreflightRun()
        for fault in ("user_stop", "silence_camera"):
            rospy.ServiceProxy(f"fake_franka/{fault}", SetBool)(False)
        self.assertEqual(run.names("ERROR"), {"robot mode", "camera", "images", "camera matrix"}, run.output)
        self.assertEqual(run.status, 1, run.output)
        self.assertIn("release the user stop", run.output)


if __name__ == "__main__":
    rospy.init_node("check_preflight_franka")
    rostest.rosrun("embodied_active_learning", "check_preflight_franka", PreflightFrankaTest)
