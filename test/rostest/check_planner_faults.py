#!/usr/bin/env python3
"""The planner with a faulty arm or camera: it holds the arm still, reports why, stores nothing wrong, and resumes."""

import threading
import unittest
from collections import defaultdict

import numpy as np
import rospy
import search_path  # noqa: F401  for the helpers below
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from embodied_active_learning.msg import ArmCause, Observation, PlanarState
from embodied_active_learning.srv import GoToPose, GoToPoseResponse, MoveArm, MoveArmResponse
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger, TriggerResponse

import rostest
from embodied_active_learning.ros.conversions import image_array, image_message, state_arrays, state_message
from node_process import NodeProcess
from threads import wait_for

TIMEOUT = 60.0
PAUSED = "paused, waiting for a call of /planner/resume"
PERIOD = 0.02
SHAPE = (60, 60, 3)
START = np.array([0.475, 0.0, 0.0])
SPEEDS = np.array([0.15, 0.15, 1.5])


class FaultyArm:
    """An arm with an exact real-time motion and a camera that encodes the pose; `fault` names the present fault."""

    def __init__(self):
        self.fault = ""
        self.failures = 0  # number of next commands that end in a reflex
        self.commands = []
        self.last_call = ""
        self.released = threading.Event()
        self._state, self._velocity = START, np.zeros(3)
        self._reached_at = rospy.Time.now()
        self._lock = threading.Lock()
        self._images = rospy.Publisher("camera/image_raw", Image, queue_size=1)
        self._states = rospy.Publisher("arm/state", PlanarState, queue_size=100)
        rospy.Service("arm/move", MoveArm, self.move)
        rospy.Service("arm/go_to", GoToPose, self.go_to)
        rospy.Service("arm/heartbeat", Trigger, lambda _request: TriggerResponse(True, ""))
        rospy.Service("arm/stop", Trigger, self.stop)
        threading.Thread(target=self.run, daemon=True).start()

    def move(self, request):
        velocity = np.array([request.vx, request.vy, request.omega])
        self.commands.append(velocity)
        self.last_call = "move"
        if self.fault == "slow":
            threading.Event().wait(1.0)
        if self.fault == "frozen":
            self.released.wait(TIMEOUT)
        if self.failures:
            self.failures -= 1
            words = "the robot is in reflex mode"
            return MoveArmResponse(False, words, ArmCause.FAILED, PlanarState(), False)
        if self.fault == "stopped":
            words = "the arm was stopped by /operator"
            return MoveArmResponse(False, words, ArmCause.STOPPED, PlanarState(), False)
        self._drive(velocity)
        threading.Event().wait(request.duration)
        return MoveArmResponse(True, "", ArmCause.NONE, self._drive(np.zeros(3)), False)

    def go_to(self, request):
        way = np.array([request.x, request.y, request.theta]) - state_arrays(self._drive(np.zeros(3)))[0]
        duration = PERIOD + np.max(np.abs(way) / SPEEDS)
        self._drive(way / duration)
        threading.Event().wait(duration)
        return GoToPoseResponse(True, "", ArmCause.NONE, self._drive(np.zeros(3)))

    def stop(self, _request):
        self.last_call = "stop"
        return TriggerResponse(True, "")

    def run(self):
        while not rospy.is_shutdown():
            threading.Event().wait(PERIOD)
            with self._lock:
                state = self._advance()
            self._states.publish(state)
            if self.fault != "camera is silent":
                self._images.publish(self.image(state))

    @staticmethod
    def image(state):
        """Return the camera's image: an encoding of its pose."""
        picture = np.zeros(SHAPE, np.uint8)
        seen = state_arrays(state)[0].tobytes()
        picture.reshape(-1)[: len(seen)] = np.frombuffer(seen, np.uint8)
        return image_message(state.header.stamp, picture)

    def _drive(self, velocity):
        """Set the velocity; return the present state."""
        with self._lock:
            reached = self._advance()
            self._velocity = velocity
            return reached

    def _advance(self):
        now = rospy.Time.now()
        self._state = self._state + (now - self._reached_at).to_sec() * self._velocity
        self._reached_at = now
        return state_message(now, self._state, self._velocity)


def pose_seen(image):
    """Return the pose (3,) encoded in an image."""
    return np.frombuffer(image_array(image, *SHAPE[:2]).reshape(-1)[:24].tobytes())


class PlannerFaultsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.health = defaultdict(DiagnosticStatus)  # of no report before the first
        cls.last = Observation(index=0)
        cls.residual = 0.0
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics)
        rospy.Subscriber("observation", Observation, cls.on_observation)
        cls.arm = FaultyArm()
        cls.planner = NodeProcess("ergodic_planner")

    @classmethod
    def tearDownClass(cls):
        cls.planner.end()
        assert cls.residual < 1e-6, "an image was paired with the state of another"

    @classmethod
    def on_diagnostics(cls, message):
        cls.health.update({status.name.split(": ")[-1]: status for status in message.status})

    @classmethod
    def on_observation(cls, message):
        cls.last = message
        difference = pose_seen(message.image) - state_arrays(message.state)[0]
        cls.residual = max(cls.residual, float(np.max(np.abs(difference))))

    def setUp(self):
        self.arm.fault = ""
        self.wait_for_progress()

    def tearDown(self):
        self.arm.fault = ""
        self.arm.released.set()
        self.call("planner/resume")

    def wait_for(self, condition, what):
        wait_for(condition, 0.02, TIMEOUT, lambda: what)

    def wait_for_progress(self):
        before = self.last.index
        self.wait_for(lambda: self.last.index > before + 2, "exploration did not resume")

    def check_fault(self, fault, words, commands=1):
        self.arm.fault = fault
        self.wait_for_words(words)
        stored, first = self.last.index, len(self.arm.commands)
        self.wait_for(lambda: len(self.arm.commands) >= first + commands, "the arm was not held still")
        self.assertEqual(self.last.index, stored)
        np.testing.assert_array_equal(np.abs(self.arm.commands[first:]).max(), 0.0)
        self.arm.fault = ""
        self.wait_for_progress()

    def wait_for_words(self, words):
        def is_reported():
            status = self.health["planner"]
            return words in status.message and status.level == DiagnosticStatus.ERROR

        self.wait_for(is_reported, f"{words!r} was not reported")

    def test_silent_camera(self):
        self.check_fault("camera is silent", "camera timeout: no new image on /camera/image_raw")
        self.wait_for(lambda: self.health["planner"].level == 0, "the error was not cleared")

    def test_stopped_arm_awaited_beyond_retries(self):
        self.check_fault("stopped", "the arm was stopped by /operator", commands=6)

    def test_failed_command_retried(self):
        self.arm.failures = 3
        first = len(self.arm.commands)
        self.wait_for_words("the robot is in reflex mode (attempt ")
        self.wait_for_progress()
        self.assertEqual(self.arm.failures, 0)
        np.testing.assert_array_equal(self.arm.commands[first + 2], 0.0, "the arm was not held still")

    def test_planner_gives_up_after_retries_with_reason(self):
        self.arm.failures = 10**6
        self.assertEqual(self.planner.process.wait(TIMEOUT), 2)
        self.arm.failures = 0
        self.assertEqual(self.arm.last_call, "stop")
        self.assertIn("the robot is in reflex mode (gave up after 4 attempts)", self.planner.last_line)
        type(self).planner = NodeProcess("ergodic_planner")
        self.wait_for_progress()

    def call(self, name):
        return rospy.ServiceProxy(name, Trigger)()

    def check_pause(self):
        response = self.call("planner/pause")
        self.assertEqual((response.success, response.message), (True, "paused"))
        self.assertEqual(self.arm.last_call, "stop")
        commands = len(self.arm.commands)
        self.wait_for(lambda: self.health["planner"].message.startswith(PAUSED), "the planner did not pause")
        threading.Event().wait(1.0)
        self.assertEqual((len(self.arm.commands), self.arm.last_call), (commands, "stop"))

    def check_resume(self):
        resumed_at = len(self.arm.commands)
        response = self.call("planner/resume")
        self.assertEqual((response.success, response.message), (True, "exploring"))
        self.wait_for_progress()
        np.testing.assert_array_equal(self.arm.commands[resumed_at], 0.0, "the arm must hold still first")

    def test_pause_responds_after_current_step(self):
        self.arm.fault = "slow"
        count = len(self.arm.commands)
        self.wait_for(lambda: len(self.arm.commands) > count, "no step began")
        self.check_pause()
        self.arm.fault = ""
        self.check_resume()

    def test_pause_unconfirmed_by_arm_reported_and_done_later(self):
        self.arm.released.clear()
        self.arm.fault = "frozen"
        count = len(self.arm.commands)
        self.wait_for(lambda: len(self.arm.commands) > count, "no step began")
        response = self.call("planner/pause")
        self.assertTrue(response.success)
        self.assertIn("but the arm may still move: the arm has not responded", response.message)
        self.arm.fault = ""
        self.arm.released.set()
        self.wait_for(lambda: self.arm.last_call == "stop", "the arm was not stopped")
        self.check_resume()


if __name__ == "__main__":
    rospy.init_node("check_planner_faults")
    rostest.rosrun("embodied_active_learning", "check_planner_faults", PlannerFaultsTest)
