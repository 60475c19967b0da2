#!/usr/bin/env python3
"""The node velocity_service_arm against the stand-in for the paper's velocity service."""

import json
import os
import signal
import unittest

import numpy as np
import rospy
import search_path  # noqa: F401  for the helpers below
from embodied_active_learning.msg import ArmCause, PlanarState
from embodied_active_learning.srv import GoToPose, MoveArm
from std_srvs.srv import SetBool, Trigger

import rostest
from embodied_active_learning.ros.conversions import state_arrays
from embodied_active_learning.workspace import Workspace
from threads import in_a_thread, wait_for

TIMEOUT = 60.0
CENTRE = Workspace().centre


class VelocityServiceTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states = []
        rospy.Subscriber("arm/state", PlanarState, cls.states.append)
        cls.move = rospy.ServiceProxy("arm/move", MoveArm)
        cls.go_to = rospy.ServiceProxy("arm/go_to", GoToPose)
        cls.recover = rospy.ServiceProxy("arm/recover", Trigger)
        rospy.wait_for_service("arm/recover", TIMEOUT)
        rospy.wait_for_service("fake_velocity_service/truth", TIMEOUT)
        cls.until(lambda: cls.states)

    def setUp(self):
        self.switch("stop_robot", False)
        self.switch("hang", False)
        self.until(lambda: self.recover().success)
        self.until(lambda: self.go_to(*CENTRE).success)

    def tearDown(self):
        self.assertEqual(self.truth()["starts_in_motion"], 0)

    @staticmethod
    def until(condition):
        """Wait for a condition."""
        wait_for(condition, 0.02, TIMEOUT)

    def truth(self):
        return json.loads(rospy.ServiceProxy("fake_velocity_service/truth", Trigger)().message)

    def switch(self, fault, on):
        self.assertTrue(rospy.ServiceProxy(f"fake_velocity_service/{fault}", SetBool)(on).success)

    def start_moving(self):
        """Start a move that lasts longer than it takes a busy machine to cause a fault."""
        responses = []
        thread = in_a_thread(lambda: responses.append(self.move(0.02, 0.0, 0.0, 5.0)))
        self.until(lambda: self.truth()["speed"] > 0.01)
        return thread, responses

    def is_at_rest(self):
        return self.truth()["speed"] < 5e-3

    def test_go_to_arrives(self):
        target = np.add(CENTRE, (0.03, -0.03, 0.3))
        responses = []
        self.until(lambda: responses.append(self.go_to(*target)) or responses[-1].success)
        response = responses[-1]
        np.testing.assert_allclose(state_arrays(response.state)[0], self.truth()["camera"], atol=0.01)
        np.testing.assert_allclose(state_arrays(response.state)[0], target, atol=0.1)

    def test_robot_that_stops_is_held_until_recover(self):
        thread, responses = self.start_moving()
        self.switch("stop_robot", True)
        thread.join(TIMEOUT)
        self.assertEqual(responses[0].cause, ArmCause.STOPPED)
        self.assertFalse(self.recover().success)
        self.switch("stop_robot", False)
        self.assertFalse(self.move(0.01, 0.0, 0.0, 0.1).success)
        self.until(lambda: self.recover().success)
        self.until(lambda: self.move(0.01, 0.0, 0.0, 0.1).success)

    def test_hanging_service_ends_move_and_is_named(self):
        thread, responses = self.start_moving()
        self.switch("hang", True)
        thread.join(TIMEOUT)
        self.assertIn("no response from /klerg_cmd: none within 0.4 s", responses[0].message)
        self.until(lambda: "/klerg_cmd" in self.recover().message)  # once the arm is known to be at rest
        requests = self.truth()["requests"]
        self.switch("hang", False)
        # The request that was hanging moves the robot once more.
        self.until(lambda: self.truth()["requests"] > requests and self.is_at_rest())
        self.assertFalse(self.move(0.01, 0.0, 0.0, 0.1).success)
        self.until(lambda: self.recover().success)
        self.until(lambda: self.move(0.01, 0.0, 0.0, 0.1).success)

    def test_restarted_service_is_used_without_recover(self):
        before = self.truth()["process"]
        os.kill(before, signal.SIGKILL)
        self.until(lambda: self.process() not in (None, before))
        self.until(lambda: self.move(0.01, 0.0, 0.0, 0.1).success)
        self.assertIn(self.truth()["starts"], range(1, 4))  # more than one after a response that was late

    def process(self):
        """Return the process of the service; None while it is restarting."""
        try:
            return self.truth()["process"]
        except rospy.ServiceException:
            return None


if __name__ == "__main__":
    rospy.init_node("check_velocity_service")
    rostest.rosrun("embodied_active_learning", "check_velocity_service", VelocityServiceTest)
