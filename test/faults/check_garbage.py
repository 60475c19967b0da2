#!/usr/bin/env python3
"""Malformed requests: each gets a response, none moves the arm beyond its limits, and all nodes keep responding."""

import socket
import unittest
from pathlib import Path
from urllib.parse import urlparse

import numpy as np
import rospy
from embodied_active_learning.msg import Observation, PlanarState
from embodied_active_learning.srv import (
    CollectFingerprints,
    Encode,
    EvaluateEntropy,
    GetTrajectory,
    GoToPose,
    Identify,
    MoveArm,
    Observe,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import Image
from std_msgs.msg import Header

import rostest
from embodied_active_learning.config import Config
from embodied_active_learning.ros.conversions import image_message, state_arrays, state_message

TIMEOUT = 60.0
REASONABLE = settings(
    max_examples=60, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
UINT32 = st.integers(0, 2**32 - 1)
NUMBERS = st.floats(width=64) | st.sampled_from([0.0, -0.0, 1e-300, 1e308, -1e308, 0.1, -0.1, 0.2, 0.5])
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=200)
TIMES = st.builds(rospy.Time, st.integers(0, 2**32 - 1), st.integers(0, 999999999))
HEADERS = st.builds(Header, st.just(0), TIMES, TEXTS)
STATES = st.builds(PlanarState, HEADERS, *[NUMBERS] * 6)
IMAGES = st.builds(
    Image,
    HEADERS,
    UINT32 | st.just(60),
    UINT32 | st.just(60),
    TEXTS | st.sampled_from(["rgb8", "bgr8"]),
    st.integers(0, 255),
    UINT32 | st.just(180),
    st.binary(max_size=64) | st.sampled_from([bytes(10800), bytes(10801), bytes(10799)]),
)
OBSERVATIONS = st.builds(Observation, HEADERS, UINT32 | st.integers(0, 3), STATES, IMAGES)
NAMES = TEXTS | st.sampled_from(
    ["", ".", "..", "../garbage", "/etc", "~", "a/b", "-x", "x" * 10000, "con\x00", "garbage/..", "%s", "{}"]
)


class GarbageTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.box = Config.from_dict(rospy.get_param("config")).workspace.box()
        cls.limits = Config.from_dict(rospy.get_param("config")).arm
        cls.seen = []
        rospy.Subscriber("arm/state", PlanarState, cls.seen.append, queue_size=1000)
        cls.move = cls.service("arm/move", MoveArm)
        cls.go_to = cls.service("arm/go_to", GoToPose)
        cls.observe = cls.service("trainer/observe", Observe)
        cls.entropy = cls.service("trainer/entropy", EvaluateEntropy)
        cls.encode = cls.service("trainer/encode", Encode)
        cls.trajectory = cls.service("trainer/trajectory", GetTrajectory)
        cls.identify = cls.service("identify", Identify)
        cls.fingerprint = cls.service("fingerprint", CollectFingerprints)

    @staticmethod
    def service(name, service_class):
        rospy.wait_for_service(name, TIMEOUT)
        return rospy.ServiceProxy(name, service_class)

    def check_refused(self, response):
        self.assertFalse(response.success)
        self.assertGreater(len(response.message), 10)
        self.assertLess(len(response.message), 2000)
        self.assertNotIn("Traceback", response.message)

    @settings(REASONABLE, max_examples=150)
    @given(*[NUMBERS] * 4)
    def test_any_velocity_stays_within_workspace_and_limits(self, vx, vy, omega, duration):
        response = self.move(vx, vy, omega, duration)
        if response.success:
            self.check_within_limits(response.state)
        else:
            self.check_refused(response)

    @given(*[NUMBERS] * 3)
    @REASONABLE
    def test_any_pose_stays_within_workspace(self, x, y, theta):
        response = self.go_to(x, y, theta)
        if response.success:
            self.check_within_limits(response.state)
        else:
            self.check_refused(response)

    def check_within_limits(self, message):
        state, velocity = state_arrays(message)
        self.assertTrue(self.box.contains(state), state)
        fastest = np.array([self.limits.max_speed, self.limits.max_speed, self.limits.max_turn_rate])
        self.assertTrue(np.all(np.abs(velocity) <= 1.02 * fastest), velocity)

    @given(OBSERVATIONS)
    @REASONABLE
    def test_malformed_observation_not_stored(self, observation):
        before = len(self.trajectory().states)
        response = self.observe(observation)
        if response.success:
            state, _ = state_arrays(observation.state)
            self.assertTrue(np.all(np.isfinite(state)))
            self.assertEqual(len(observation.image.data), 10800)
        else:
            self.check_refused(response)
            self.assertEqual(len(self.trajectory().states), before)

    @given(st.lists(NUMBERS, max_size=40))
    @REASONABLE
    def test_entropy_of_malformed_states_rejected(self, states):
        response = self.entropy(0, states)
        if len(states) % 3 or not np.all(np.isfinite(states)):
            self.check_refused(response)
        else:
            self.assertTrue(response.success, response.message)

    def test_too_many_states_rejected(self):
        self.check_refused(self.entropy(0, [0.0] * 300003))

    def test_entropy_of_impossible_update_returns_not_ready(self):
        response = self.entropy(2**32 - 1, [0.475, 0.0, 0.0])
        self.assertFalse(response.ready)

    @given(st.lists(STATES, max_size=3), st.lists(IMAGES, max_size=3))
    @REASONABLE
    def test_malformed_images_not_encoded(self, states, images):
        response = self.encode(states, images)
        if response.success:
            self.assertTrue(np.all(np.isfinite(response.means)))
            self.assertEqual(len(states), len(images))
        else:
            self.check_refused(response)

    @given(NAMES, st.lists(NAMES, max_size=3), UINT32, NAMES)
    @REASONABLE
    def test_invalid_names_create_no_files(self, name, sessions, images, replay):
        before = self.files_outside_the_session()
        self.check_refused(self.identify(name, sessions, images, replay, False))
        self.assertEqual(self.files_outside_the_session(), before)

    @staticmethod
    def files_outside_the_session():
        """List what lies beside and above the running session, whose own files change meanwhile."""
        root = Path(rospy.get_param("config")["session"]["root"])
        session = root / "garbage"
        return sorted(str(path) for path in root.parent.rglob("*") if session not in path.parents)

    @given(st.binary(max_size=300))
    @REASONABLE
    def test_random_bytes_leave_port_open(self, noise):
        for name in ("trainer/observe", "arm/move"):
            uri = urlparse(rospy.get_master().lookupService(rospy.resolve_name(name))[2])
            with socket.create_connection((uri.hostname, uri.port), TIMEOUT) as connection:
                connection.sendall(noise)

    def tearDown(self):
        """Check that every node still responds, and that the arm has always been within its limits."""
        state = np.array([0.475, 0.0, 0.0])
        response = self.go_to(*state)
        self.assertTrue(response.success, response.message)
        count = len(self.trajectory().states) // 3
        stamp = rospy.Time(count)
        picture = image_message(stamp, np.full((60, 60, 3), count % 250, np.uint8))
        good = Observation(Header(stamp=stamp), count, state_message(stamp, state, np.zeros(3)), picture)
        response = self.observe(good)
        self.assertTrue(response.success, response.message)
        self.assertEqual(response.observations, count + 1)
        self.assertTrue(self.encode([good.state], [picture]).success)
        self.assertGreater(len(self.fingerprint().message), 10)
        for message in list(self.seen):
            self.check_within_limits(message)


if __name__ == "__main__":
    rospy.init_node("check_garbage")
    rostest.rosrun("embodied_active_learning", "check_garbage", GarbageTest)
