#!/usr/bin/env python3
"""The arm stops if its commander dies or hangs, or if an operator stops it."""

import threading
import unittest

import numpy as np
import rospy
import search_path  # noqa: F401  for the helpers below
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from embodied_active_learning.msg import ArmCause, Observation, PlanarState
from embodied_active_learning.srv import MoveArm
from std_srvs.srv import Trigger

import rostest
from embodied_active_learning.config import Config
from embodied_active_learning.ros.conversions import state_arrays
from node_process import NodeProcess, frozen_node
from threads import wait_for

STOPPED = "stopped by /check_dead_planner: call /arm/recover to resume"
TIMEOUT = 60.0
AT_REST = np.array([1e-4, 1e-4, 1e-3])  # m/s, m/s, rad/s
CURRENT_STEPS = 1  # the one in execution
BRAKING = np.array([0.02, 0.02, 0.2])  # m, m, rad


class DeadPlannerTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        config = Config.from_dict(rospy.get_param("/config"))
        speeds = np.array([config.arm.max_speed, config.arm.max_speed, config.arm.max_turn_rate])
        cls.one_step = config.exploration.step_duration * speeds
        cls.lease = config.arm.commander_timeout
        cls.health = {}
        cls.arm_reports = 0
        cls.states = []
        cls.observed = -1
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics)
        rospy.Subscriber("observation", Observation, cls.on_observation)
        rospy.Subscriber("arm/state", PlanarState, cls.on_state)
        cls.move = rospy.ServiceProxy("arm/move", MoveArm)
        cls.stop = rospy.ServiceProxy("arm/stop", Trigger)
        cls.recover = rospy.ServiceProxy("arm/recover", Trigger)
        cls.arm = NodeProcess("pybullet_arm")
        cls.planner = NodeProcess("ergodic_planner")

    @classmethod
    def tearDownClass(cls):
        cls.planner.end()
        cls.arm.end()

    @classmethod
    def on_diagnostics(cls, message):
        received = {status.name.split(": ")[-1]: status for status in message.status}
        cls.health.update(received)
        cls.arm_reports += "arm" in received

    @classmethod
    def on_observation(cls, message):
        cls.observed = message.index

    @classmethod
    def on_state(cls, message):
        cls.states.append(np.stack(state_arrays(message)))

    def setUp(self):
        self.wait_for_progress()

    def wait_for(self, condition, what):
        wait_for(condition, 0.02, TIMEOUT, lambda: what)

    def wait_for_progress(self):
        before = self.observed
        self.wait_for(lambda: self.observed > before + 2, "exploration did not resume")

    def check_another_node_is_rejected(self):
        response = self.move(0.1, 0.0, 0.0, 0.2)
        self.assertFalse(response.success)
        self.assertEqual(response.cause, ArmCause.BUSY)
        self.assertIn("/ergodic_planner", response.message)

    def check_arm_stops(self, since):
        """Check that the arm stops within the distance of the current steps and of braking."""
        self.wait_for_new_arm_report()
        self.wait_for(lambda: self.arm_values().get("commander") == "none", "the arm still has a commander")
        self.wait_for(lambda: np.all(np.abs(self.states[-1][1]) <= AT_REST), "the arm still moves")
        travelled = np.ptp([state for state, _ in self.states[since:]], axis=0)
        self.assertTrue(np.all(travelled <= CURRENT_STEPS * self.one_step + BRAKING), travelled)

    def wait_for_new_arm_report(self):
        """Wait for the second report from now on: the first may have been under way before."""
        before = self.arm_reports
        self.wait_for(lambda: self.arm_reports > before + 1, "the arm reports no status")

    def arm_values(self):
        return {pair.key: pair.value for pair in self.health["arm"].values}

    def wait_for_health(self, node, level, words):
        def is_reported():
            return words in self.health[node].message and self.health[node].level == level

        self.wait_for(is_reported, f"{node} does not report {words!r}")

    def test_arm_stops_if_planner_hangs_and_is_commanded_again(self):
        self.planner.freeze()
        self.addCleanup(self.planner.thaw)
        threading.Event().wait(1.0)  # until the states on their way have arrived
        since = len(self.states) - 1
        self.check_another_node_is_rejected()
        self.check_arm_stops(since)
        self.assertTrue(self.move(0.0, 0.0, 0.0, 0.2).success, "the arm is free")
        self.assertTrue(self.stop().success)
        self.planner.thaw()
        self.wait_for_progress()

    def test_planner_waiting_beyond_timeout_keeps_arm(self):
        with frozen_node("/trainer"):
            threading.Event().wait(1.5 * self.lease)
            self.check_another_node_is_rejected()
        self.wait_for_progress()

    def test_operator_stop_lasts_until_recover(self):
        self.assertIn("commands are rejected until /arm/recover", self.stop().message)
        self.wait_for_health("planner", DiagnosticStatus.ERROR, "arm held still: the arm was stopped by /check_d")
        self.wait_for_health(
            "arm", DiagnosticStatus.WARN, "stopped by /check_dead_planner: call /arm/recover to resume"
        )
        observed, since = self.observed, len(self.states) - 1
        threading.Event().wait(1.5 * self.lease)
        self.assertEqual(self.move(0.1, 0.0, 0.0, 0.2).cause, ArmCause.STOPPED)
        self.assertEqual(self.observed, observed)
        self.assertTrue(np.all(np.abs(self.states[-1][1]) <= AT_REST))
        np.testing.assert_allclose(self.states[-1][0], self.states[since][0], atol=1e-3)
        self.assertTrue(self.recover().success)
        self.wait_for_progress()
        self.wait_for_health("planner", DiagnosticStatus.OK, "exploring")

    def test_stop_and_pause_survive_restart_of_nodes(self):
        pause, resume = (rospy.ServiceProxy(f"planner/{name}", Trigger) for name in ("pause", "resume"))
        self.assertTrue(pause().success)
        self.assertTrue(self.stop().success)
        self.wait_for(lambda: rospy.get_param("/ergodic_planner/paused_by", ""), "the pause was not stored")
        self.wait_for(lambda: rospy.get_param("/arm/stopped_by", ""), "the stop was not stored")
        observed = self.observed
        self.planner.kill()
        self.arm.kill()
        self.health.clear()
        type(self).arm = NodeProcess("pybullet_arm")
        type(self).planner = NodeProcess("ergodic_planner")
        self.wait_for(lambda: {"arm", "planner"} <= set(self.health), "the nodes did not restart")
        self.wait_for_health("planner", DiagnosticStatus.WARN, "paused, waiting for a call of /planner/resume")
        self.wait_for_health(
            "arm", DiagnosticStatus.WARN, "stopped by /check_dead_planner: call /arm/recover to resume"
        )
        self.assertEqual(self.move(0.1, 0.0, 0.0, 0.2).cause, ArmCause.STOPPED)
        self.assertTrue(self.recover().success)
        self.assertTrue(resume().success)
        self.wait_for_progress()
        self.assertGreater(self.observed, observed)


if __name__ == "__main__":
    rospy.init_node("check_dead_planner")
    rostest.rosrun("embodied_active_learning", "check_dead_planner", DeadPlannerTest)
