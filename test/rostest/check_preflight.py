#!/usr/bin/env python3
"""Preflight with a simulated arm, in an empty namespace, and without a ROS master."""

import unittest
from pathlib import Path

import rospy
import search_path  # noqa: F401  for the helpers below
from embodied_active_learning.msg import PlanarState
from preflight_run import ROSRUN, TIMEOUT, PreflightRun

import rostest
from launching import free_port

LAB = Path(__file__).with_name("lab.yaml")


class PreflightTest(unittest.TestCase):
    def test_simulated_arm_passes_and_does_not_move(self):
        rospy.wait_for_service("arm/recover", TIMEOUT)
        before = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        run = PreflightRun(command=ROSRUN)
        self.assertEqual(set(run.levels), run.names("OK"), run.output)
        self.assertEqual(run.status, 0, run.output)
        self.assertIn("ready (", run.output)
        self.assertLessEqual({"arm state", "services", "images", "frames", "reach"}, run.names("OK"))
        after = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        self.assertEqual(after.header.stamp, before.header.stamp)

    def test_absent_real_robot_is_reported_part_by_part(self):
        rospy.set_param("/empty/config", {"arm": {"robot": "recording"}})
        run = PreflightRun(f"--robot-profile={LAB}", "--seconds=0.5", ROS_NAMESPACE="empty")
        self.assertEqual(run.status, 1, run.output)
        wanted = {"configuration", "clock", "robot state", "controllers", "error recovery", "arm state", "services"}
        wanted |= {"camera", "images", "camera matrix", "frames"}
        self.assertLessEqual(wanted, run.names("ERROR"), run.output)
        self.assertEqual(run.levels["reach"], "OK", run.output)
        self.assertIn("/empty/config belongs to a replay", run.output)

    def test_without_master_computer_is_still_checked(self):
        run = PreflightRun(f"--robot-profile={LAB}", ROS_MASTER_URI=f"http://localhost:{free_port(0)}")
        self.assertEqual(run.status, 1, run.output)
        self.assertLessEqual({"master", "configuration"}, run.names("ERROR"), run.output)
        self.assertEqual(run.levels["disk"], "OK", run.output)


if __name__ == "__main__":
    rospy.init_node("check_preflight")
    rostest.rosrun("embodied_active_learning", "check_preflight", PreflightTest)
