#!/usr/bin/env python3
"""The pre-flight check beside a simulated arm, in a namespace where nothing is, and without a master."""

import os
import subprocess
import sys
import unittest
from pathlib import Path

import rospy
from embodied_active_learning.msg import PlanarState

import rostest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from free_port import free_port

TIMEOUT = 60.0
LAB = Path(__file__).with_name("lab.yaml")


def preflight(*arguments, **variables):
    """Run it -> exit status, and the findings by what they are about."""
    command = ["rosrun", "embodied_active_learning", "preflight", *arguments]
    run = subprocess.run(
        command, env={**os.environ, **variables}, check=False, capture_output=True, text=True, timeout=TIMEOUT
    )
    lines = [line for line in run.stdout.splitlines() if line[:8].strip() in ("OK", "WARNING", "MISSING")]
    return run.returncode, {line[8:32].strip(): line[:8].strip() for line in lines}, run.stdout + run.stderr


class PreflightTest(unittest.TestCase):
    def test_beside_a_simulated_arm_all_is_well_and_nothing_has_moved(self):
        rospy.wait_for_service("arm/recover", TIMEOUT)
        before = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        status, findings, output = preflight()
        self.assertEqual(set(findings.values()), {"OK"}, output)
        self.assertEqual(status, 0, output)
        self.assertIn("all is well", output)
        self.assertIn("reach", findings)
        after = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        self.assertEqual(after.header.stamp, before.header.stamp)

    def test_of_a_real_robot_that_is_not_there_each_part_is_named(self):
        status, findings, output = preflight(f"--robot-profile={LAB}", "--seconds=0.5", ROS_NAMESPACE="empty")
        self.assertEqual(status, 1, output)
        gone = {name for name, level in findings.items() if level == "MISSING"}
        wanted = {"configuration", "clock", "robot state", "controllers", "error recovery", "arm state", "services"}
        self.assertLessEqual(wanted | {"camera", "images", "camera matrix", "frames"}, gone, output)
        self.assertEqual(findings["reach"], "OK", output)

    def test_without_a_master_that_is_said_and_the_rest_is_looked_at(self):
        status, findings, output = preflight(
            f"--robot-profile={LAB}", ROS_MASTER_URI=f"http://localhost:{free_port(0)}"
        )
        self.assertEqual(status, 1, output)
        self.assertEqual(findings["master"], "MISSING", output)
        self.assertEqual(findings["disk"], "OK", output)


if __name__ == "__main__":
    rospy.init_node("check_preflight")
    rostest.rosrun("embodied_active_learning", "check_preflight", PreflightTest)
