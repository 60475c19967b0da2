#!/usr/bin/env python3
"""The pre-flight check beside a simulated arm, in a namespace where nothing is, and without a master."""

import sys
import unittest
from pathlib import Path

import rospy
from embodied_active_learning.msg import PlanarState

import rostest

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE), str(HERE.parents[1] / "tools")]

from preflight_run import AS_A_USER, TIMEOUT, PreflightRun  # noqa: E402  lies beside this file

from free_port import free_port  # noqa: E402  lies in tools/, which is no package

LAB = HERE / "lab.yaml"


class PreflightTest(unittest.TestCase):
    def test_beside_a_simulated_arm_all_is_well_and_nothing_has_moved(self):
        rospy.wait_for_service("arm/recover", TIMEOUT)
        before = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        run = PreflightRun(command=AS_A_USER)
        self.assertEqual(set(run.findings), run.about("OK"), run.output)
        self.assertEqual(run.status, 0, run.output)
        self.assertIn("all is well", run.output)
        self.assertLessEqual({"arm state", "services", "images", "frames", "reach"}, run.about("OK"))
        after = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        self.assertEqual(after.header.stamp, before.header.stamp)

    def test_of_a_real_robot_that_is_not_there_each_part_is_named_whatever_a_replay_has_left(self):
        rospy.set_param("/empty/config", {"arm": {"robot": "recording"}})
        run = PreflightRun(f"--robot-profile={LAB}", "--seconds=0.5", ROS_NAMESPACE="empty")
        self.assertEqual(run.status, 1, run.output)
        wanted = {"configuration", "clock", "robot state", "controllers", "error recovery", "arm state", "services"}
        wanted |= {"camera", "images", "camera matrix", "frames"}
        self.assertLessEqual(wanted, run.about("MISSING"), run.output)
        self.assertEqual(run.findings["reach"], "OK", run.output)
        self.assertIn("/empty/config is that of a replay", run.output)

    def test_without_a_master_that_is_said_and_the_rest_is_looked_at(self):
        run = PreflightRun(f"--robot-profile={LAB}", ROS_MASTER_URI=f"http://localhost:{free_port(0)}")
        self.assertEqual(run.status, 1, run.output)
        self.assertLessEqual({"master", "configuration"}, run.about("MISSING"), run.output)
        self.assertEqual(run.findings["disk"], "OK", run.output)


if __name__ == "__main__":
    rospy.init_node("check_preflight")
    rostest.rosrun("embodied_active_learning", "check_preflight", PreflightTest)
