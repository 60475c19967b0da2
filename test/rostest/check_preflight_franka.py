#!/usr/bin/env python3
"""Preflight with a fake Panda, in good order and with faults."""

import unittest

import rospy
import search_path  # noqa: F401  for the helpers below
from embodied_active_learning.srv import MoveArm
from preflight_run import TIMEOUT, PreflightRun
from std_srvs.srv import SetBool, Trigger

import rostest
from embodied_active_learning.config import merge
from threads import wait_for

ROBOT = {"robot state", "robot mode", "controllers", "error recovery", "camera", "frames", "camera pose", "reach"}


class PreflightFrankaTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.wait_for_service("arm/move", TIMEOUT)
        rospy.wait_for_message("camera/image_raw", rospy.AnyMsg, TIMEOUT)
        move = rospy.ServiceProxy("arm/move", MoveArm)
        wait_for(lambda: move(0.0, 0.0, 0.0, 0.05).success, 0.1, TIMEOUT)  # until the robot is ready

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

    def test_user_stop_silent_camera_and_hang_are_errors(self):
        self.addCleanup(wait_for, self.recovers, 0.1, TIMEOUT)
        for fault in ("user_stop", "silence_camera", "hang_controller_manager"):
            switch = rospy.ServiceProxy(f"fake_franka/{fault}", SetBool)
            self.addCleanup(switch, False)
            switch(True)
        run = PreflightRun()
        errors = {"robot mode", "camera", "images", "camera matrix", "controllers"}
        self.assertEqual(run.names("ERROR"), errors, run.output)
        self.assertEqual(run.status, 1, run.output)
        self.assertIn("no response from /controller_manager/list_controllers: none within", run.output)
        self.assertIn("release the user stop", run.output)

    @staticmethod
    def recovers():
        return rospy.ServiceProxy("arm/recover", Trigger)().success


if __name__ == "__main__":
    rospy.init_node("check_preflight_franka")
    rostest.rosrun("embodied_active_learning", "check_preflight_franka", PreflightFrankaTest)
