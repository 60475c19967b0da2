#!/usr/bin/env python3
"""The planner when arm or camera fail: it holds the arm still, says why, stores nothing wrong, and goes on."""

import os
import signal
import threading
import time
import unittest
from contextlib import contextmanager
from xmlrpc.client import ServerProxy

import numpy as np
import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from embodied_active_learning.msg import Observation, PlanarState
from embodied_active_learning.srv import GetTrajectory, GoToPose, MoveArm, MoveArmResponse
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger, TriggerResponse

import rostest
from embodied_active_learning.ros.conversions import image_message, state_arrays, state_message

TIMEOUT = 60.0


class FaultyArm:
    """An arm that moves exactly as told, with a camera; `fault` names what is broken now."""

    def __init__(self):
        self.state = np.array([0.475, 0.0, 0.0])
        self.fault = ""
        self.commands = []
        self.last_call = ""
        self.released = threading.Event()
        self._images = rospy.Publisher("camera/image_raw", Image, queue_size=1)
        self._states = rospy.Publisher("arm/state", PlanarState, queue_size=1)
        rospy.Service("arm/move", MoveArm, self.move)
        rospy.Service("arm/go_to", GoToPose, lambda request: None)
        rospy.Service("arm/stop", Trigger, self.stop)

    def move(self, request):
        velocity = np.array([request.vx, request.vy, request.omega])
        self.commands.append(velocity)
        self.last_call = "move"
        if self.fault == "slow":
            threading.Event().wait(1.0)
        if self.fault == "frozen":
            self.released.wait(TIMEOUT)
        if self.fault == "reflex":
            return MoveArmResponse(False, "the robot is in reflex mode", PlanarState(), False)
        self.state = self.state + request.duration * velocity
        message = state_message(rospy.Time.now(), self.state, velocity)
        reported = state_message(message.header.stamp, self.state, velocity)
        if self.fault == "pose is not a number":
            reported.x = float("nan")
        self._states.publish(reported)
        if self.fault != "camera is silent":
            self._images.publish(self.image(message.header.stamp))
        return MoveArmResponse(True, "", message, False)

    def stop(self, _request):
        self.last_call = "stop"
        return TriggerResponse(True, "")

    def image(self, stamp):
        if self.fault == "image of another size":
            return image_message(stamp, np.zeros((48, 64, 3), np.uint8))
        picture = image_message(stamp, np.full((180, 180, 3), len(self.commands) % 250, np.uint8))
        if self.fault == "image of another encoding":
            picture.encoding = "16UC3"
        return picture


class PlannerFaultsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.health = {}
        cls.last = Observation(index=0)
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics)
        rospy.Subscriber("observation", Observation, cls.on_observation)
        cls.arm = FaultyArm()

    @classmethod
    def on_diagnostics(cls, message):
        cls.health.update({status.name.split(": ")[-1]: status for status in message.status})

    @classmethod
    def on_observation(cls, message):
        cls.last = message

    def setUp(self):
        self.arm.fault = ""
        self.wait_for_progress()

    def tearDown(self):
        self.arm.fault = ""
        self.arm.released.set()
        self.call("planner/resume")

    def wait_for(self, condition, what):
        waiting, ends_at = threading.Event(), time.monotonic() + TIMEOUT
        while not condition():
            self.assertLess(time.monotonic(), ends_at, what)
            waiting.wait(0.02)

    def wait_for_progress(self):
        before = self.last.index
        self.wait_for(lambda: self.last.index > before + 2, "exploration did not go on")

    def check_that_it_holds_still_and_recovers(self, fault, words):
        self.arm.fault = fault
        self.wait_for(lambda: words in self.health["planner"].message, f"{words!r} was not said")
        self.assertGreater(self.health["planner"].level, 0)
        stored, first = self.last.index, len(self.arm.commands)
        self.wait_for(lambda: len(self.arm.commands) > first + 2, "the arm was not told to hold still")
        self.assertEqual(self.last.index, stored)
        np.testing.assert_array_equal(np.abs(self.arm.commands[first:]).max(), 0.0)
        self.arm.fault = ""
        self.wait_for_progress()
        self.wait_for(lambda: self.health["planner"].level == 0, "the trouble was not taken back")

    def test_a_silent_camera(self):
        self.check_that_it_holds_still_and_recovers("camera is silent", "no new image on /camera/image_raw")

    def test_images_of_another_size(self):
        self.check_that_it_holds_still_and_recovers("image of another size", "image is 64 x 48 pixels")

    def test_images_of_another_encoding(self):
        self.check_that_it_holds_still_and_recovers("image of another encoding", "encoding is '16UC3'")

    def test_a_pose_that_is_not_a_number(self):
        self.check_that_it_holds_still_and_recovers("pose is not a number", "not finite")

    def test_an_arm_that_refuses(self):
        self.check_that_it_holds_still_and_recovers("reflex", "reflex mode")

    def call(self, name):
        return rospy.ServiceProxy(name, Trigger)()

    def check_that_it_pauses(self, message="paused"):
        answer = self.call("planner/pause")
        self.assertEqual((answer.success, answer.message), (True, message))
        self.assertEqual(self.arm.last_call, "stop")
        commands = len(self.arm.commands)
        self.wait_for(lambda: self.health["planner"].message == "paused", "it did not pause")
        threading.Event().wait(1.0)
        self.assertEqual((len(self.arm.commands), self.arm.last_call), (commands, "stop"))

    def check_that_it_resumes(self):
        resumed_at = len(self.arm.commands)
        answer = self.call("planner/resume")
        self.assertEqual((answer.success, answer.message), (True, "exploring"))
        self.wait_for_progress()
        np.testing.assert_array_equal(self.arm.commands[resumed_at], 0.0, "it has to look first")

    def test_a_paused_planner_moves_nothing_until_it_is_resumed(self):
        self.check_that_it_pauses()
        self.check_that_it_resumes()

    def test_a_pause_is_answered_after_the_step_under_way(self):
        self.arm.fault = "slow"
        count = len(self.arm.commands)
        self.wait_for(lambda: len(self.arm.commands) > count, "no step began")
        self.check_that_it_pauses()
        self.arm.fault = ""
        self.check_that_it_resumes()

    def test_a_pause_and_a_resume_tell_whether_they_changed_anything(self):
        answer = self.call("planner/resume")
        self.assertEqual((answer.success, answer.message), (False, "was not paused"))
        self.check_that_it_pauses()
        answer = self.call("planner/pause")
        self.assertEqual((answer.success, answer.message), (False, "paused already"))
        self.check_that_it_resumes()

    def test_a_planner_in_trouble_can_be_paused(self):
        self.arm.fault = "camera is silent"
        self.wait_for(lambda: self.health["planner"].level > 0, "the trouble was not said")
        self.check_that_it_pauses()
        self.arm.fault = ""
        self.check_that_it_resumes()

    def test_a_planner_that_waits_for_the_trainer_can_be_paused(self):
        with self.frozen("/trainer"):
            threading.Event().wait(1.0)
            self.check_that_it_pauses()
        self.check_that_it_resumes()

    def test_a_pause_that_the_arm_does_not_confirm_says_so_and_stops_the_arm_later(self):
        self.arm.released.clear()
        self.arm.fault = "frozen"
        count = len(self.arm.commands)
        self.wait_for(lambda: len(self.arm.commands) > count, "no step began")
        answer = self.call("planner/pause")
        self.assertTrue(answer.success)
        self.assertIn("it is not certain that the arm stands still: the arm has not answered", answer.message)
        self.arm.fault = ""
        self.arm.released.set()
        self.wait_for(lambda: self.arm.last_call == "stop", "the arm was not stopped")
        self.check_that_it_resumes()

    @contextmanager
    def frozen(self, node):
        """A node that does not answer while the block lasts."""
        api = rosgraph.Master("/check_planner_faults").lookupNode(node)
        _, _, pid = ServerProxy(api).getPid("/check_planner_faults")
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(pid, signal.SIGCONT)

    def test_z_everything_stored_is_where_the_arm_was(self):
        states = np.array(rospy.ServiceProxy("trainer/trajectory", GetTrajectory)().states).reshape(-1, 3)
        self.assertTrue(np.all(np.isfinite(states)))
        self.assertGreater(len(states), 10)
        observed, _ = state_arrays(self.last.state)
        self.assertTrue(np.any(np.all(np.isclose(states, observed), axis=1)))


if __name__ == "__main__":
    rospy.init_node("check_planner_faults")
    rostest.rosrun("embodied_active_learning", "check_planner_faults", PlannerFaultsTest)
