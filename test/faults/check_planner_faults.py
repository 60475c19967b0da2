#!/usr/bin/env python3
"""The planner when arm or camera fail: it holds the arm still, says why, stores nothing wrong, and goes on."""

import threading
import time
import unittest

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from embodied_active_learning.msg import ArmCause, Observation, PlanarState
from embodied_active_learning.srv import GetTrajectory, GoToPose, GoToPoseResponse, MoveArm, MoveArmResponse
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger, TriggerResponse

import rostest
from embodied_active_learning.ros.conversions import image_array, image_message, state_arrays, state_message
from node_process import NodeProcess, frozen

TIMEOUT = 60.0
PAUSED = "paused, waiting for a call of /planner/resume"
PERIOD = 0.02
SHAPE = (180, 180, 3)
START = np.array([0.475, 0.0, 0.0])
SPEEDS = np.array([0.15, 0.15, 1.5])


class FaultyArm:
    """An arm that moves as told, in real time, with a camera that sees the pose; `fault` names what is broken now."""

    def __init__(self):
        self.fault = ""
        self.failures = 0  # commands from now on that end in a reflex
        self.commands = []
        self.last_call = ""
        self.released = threading.Event()
        self._state, self._velocity = START, np.zeros(3)
        self._reached_at = rospy.Time.now()
        self._lock = threading.Lock()
        self._ticks = 0
        self._last_image = None
        self._images = rospy.Publisher("camera/image_raw", Image, queue_size=1)
        self._states = rospy.Publisher("arm/state", PlanarState, queue_size=1)
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
            self._ticks += 1
            with self._lock:
                state = self._advance()
            self.publish_state(state_message(state.header.stamp, *state_arrays(state)))
            self.publish_image(self.image(state))

    def publish_state(self, state):
        if self.fault == "pose is silent":
            return
        if self.fault == "pose is not a number":
            state.x = float("nan")
        if self.fault == "pose jumps":
            state.x += 0.1 * (self._ticks % 2)
        self._states.publish(state)

    def publish_image(self, image):
        if self.fault == "camera is silent":
            return
        if self.fault == "one stamp":
            image.header.stamp = self._last_image.header.stamp
        if self.fault == "frozen picture":
            image.data = self._last_image.data
        if self.fault == "images from the future":
            image.header.stamp += rospy.Duration(10.0)
        if self.fault == "image of one colour":
            image.data = bytes(len(image.data))
        if not self.fault:
            self._last_image = image
        self._images.publish(image)

    def image(self, state):
        """What the camera sees: its own pose."""
        if self.fault == "image of another size":
            return image_message(state.header.stamp, np.zeros((48, 64, 3), np.uint8))
        picture = np.zeros(SHAPE, np.uint8)
        seen = state_arrays(state)[0].tobytes()
        picture.reshape(-1)[: len(seen)] = np.frombuffer(seen, np.uint8)
        return image_message(state.header.stamp, picture)

    def _drive(self, velocity):
        """From now on at a velocity -> the state that it begins in."""
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
    """The pose that an image of the faulty arm's camera shows, (3,)."""
    return np.frombuffer(image_array(image, *SHAPE[:2]).reshape(-1)[:24].tobytes())


class PlannerFaultsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.health = {}
        cls.last = Observation(index=0)
        cls.residual = 0.0
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics)
        rospy.Subscriber("observation", Observation, cls.on_observation)
        cls.arm = FaultyArm()
        cls.planner = NodeProcess("ergodic_planner")

    @classmethod
    def tearDownClass(cls):
        cls.planner.end()

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
        waiting, ends_at = threading.Event(), time.monotonic() + TIMEOUT
        while not condition():
            self.assertLess(time.monotonic(), ends_at, what)
            waiting.wait(0.02)

    def wait_for_progress(self):
        before = self.last.index
        self.wait_for(lambda: self.last.index > before + 2, "exploration did not go on")

    def check_that_it_holds_still_and_recovers(self, fault, words, tries=1):
        self.arm.fault = fault
        self.wait_for_words(words)
        stored, first = self.last.index, len(self.arm.commands)
        self.wait_for(lambda: len(self.arm.commands) >= first + tries, "the arm was not told to hold still")
        self.assertEqual(self.last.index, stored)
        np.testing.assert_array_equal(np.abs(self.arm.commands[first:]).max(), 0.0)
        self.arm.fault = ""
        self.wait_for_progress()

    def wait_for_words(self, words):
        self.wait_for(lambda: words in self.health["planner"].message, f"{words!r} was not said")
        self.assertEqual(self.health["planner"].level, DiagnosticStatus.ERROR)

    def test_a_silent_camera(self):
        self.check_that_it_holds_still_and_recovers("camera is silent", "no new image on /camera/image_raw")
        self.wait_for(lambda: self.health["planner"].level == 0, "the trouble was not taken back")

    def test_a_camera_that_keeps_sending_one_stamp(self):
        self.check_that_it_holds_still_and_recovers("one stamp", "images on /camera/image_raw keep coming with one")

    def test_a_camera_that_keeps_sending_one_picture(self):
        self.check_that_it_holds_still_and_recovers("frozen picture", "although it moved: the camera is frozen")

    def test_images_of_one_colour(self):
        self.check_that_it_holds_still_and_recovers("image of one colour", "is of one single colour, [0, 0, 0]")

    def test_images_from_the_future(self):
        words = "s in the future: synchronise the computers' clocks"
        self.check_that_it_holds_still_and_recovers("images from the future", words)

    def test_images_of_another_size(self):
        self.check_that_it_holds_still_and_recovers("image of another size", "image is 64 x 48 pixels")

    def test_a_silent_pose(self):
        self.check_that_it_holds_still_and_recovers("pose is silent", "no state on /arm/state around the image's stamp")

    def test_a_pose_that_jumps(self):
        self.check_that_it_holds_still_and_recovers("pose jumps", "the pose on /arm/state jumped by 0.1")

    def test_a_pose_that_is_not_a_number(self):
        self.check_that_it_holds_still_and_recovers("pose is not a number", "not finite")

    def test_an_arm_that_an_operator_stopped_is_waited_for_longer_than_its_tries_last(self):
        self.check_that_it_holds_still_and_recovers("stopped", "the arm was stopped by /operator", tries=6)

    def test_an_arm_that_fails_is_tried_again(self):
        self.arm.failures = 3
        first = len(self.arm.commands)
        self.wait_for_words("the robot is in reflex mode (attempt ")
        self.wait_for_progress()
        self.assertEqual(self.arm.failures, 0)
        np.testing.assert_array_equal(self.arm.commands[first + 2], 0.0, "the arm was not told to hold still")

    def test_an_arm_that_goes_on_failing_is_given_up_with_the_reason(self):
        self.arm.failures = 10**6
        self.assertEqual(self.planner.process.wait(TIMEOUT), 2)
        self.arm.failures = 0
        self.assertEqual(self.arm.last_call, "stop")
        self.assertIn("the robot is in reflex mode (gave up after 4 attempts)", self.planner.last_line)
        type(self).planner = NodeProcess("ergodic_planner")
        self.wait_for_progress()

    def call(self, name):
        return rospy.ServiceProxy(name, Trigger)()

    def check_that_it_pauses(self, message="paused"):
        answer = self.call("planner/pause")
        self.assertEqual((answer.success, answer.message), (True, message))
        self.assertEqual(self.arm.last_call, "stop")
        commands = len(self.arm.commands)
        self.wait_for(lambda: self.health["planner"].message == PAUSED, "it did not pause")
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
        self.assertEqual((answer.success, answer.message), (False, "not paused"))
        self.check_that_it_pauses()
        answer = self.call("planner/pause")
        self.assertEqual((answer.success, answer.message), (False, "already paused"))
        self.check_that_it_resumes()

    def test_a_planner_in_trouble_can_be_paused(self):
        self.arm.fault = "camera is silent"
        self.wait_for(lambda: self.health["planner"].level > 0, "the trouble was not said")
        self.check_that_it_pauses()
        self.arm.fault = ""
        self.check_that_it_resumes()

    def test_a_planner_that_waits_for_the_trainer_can_be_paused(self):
        with frozen("/trainer"):
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
        self.assertIn("but the arm may still move: the arm has not responded", answer.message)
        self.arm.fault = ""
        self.arm.released.set()
        self.wait_for(lambda: self.arm.last_call == "stop", "the arm was not stopped")
        self.check_that_it_resumes()

    def test_z_everything_stored_is_where_the_arm_was(self):
        states = np.array(rospy.ServiceProxy("trainer/trajectory", GetTrajectory)().states).reshape(-1, 3)
        self.assertTrue(np.all(np.isfinite(states)))
        self.assertGreater(len(states), 10)
        self.assertLess(self.residual, 1e-6, "an image was taken for a view from elsewhere")
        observed, _ = state_arrays(self.last.state)
        self.assertTrue(np.any(np.all(np.isclose(states, observed), axis=1)))


if __name__ == "__main__":
    rospy.init_node("check_planner_faults")
    rostest.rosrun("embodied_active_learning", "check_planner_faults", PlannerFaultsTest)
