#!/usr/bin/env python3
"""The learning pipeline during a run: services, topics, and the resulting session."""

import copy
import socket
import threading
import unittest
from pathlib import Path
from urllib.parse import urlparse

import numpy as np
import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from embodied_active_learning.msg import Observation, PlanarState, TargetDistribution, TrainingStatus
from embodied_active_learning.srv import (
    Encode,
    EncodeRequest,
    EvaluateEntropy,
    EvaluateEntropyRequest,
    MoveArm,
    Observe,
    ObserveRequest,
)
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

import rostest
from embodied_active_learning.ros.conversions import state_arrays
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary

TIMEOUT = 60.0
STEPS = 150  # in learn.test


def positions(message):
    return str([pose.pose.position for pose in message.poses]) if message.poses else ""


# Every topic of planner and trainer, with the content that must differ between two messages.
CONTENTS = {
    "observation": (Observation, lambda message: message.image.data),
    "target_distribution": (TargetDistribution, lambda message: tuple(message.time_average)),
    "training_status": (TrainingStatus, lambda message: str(message.observations)),
    "travelled_path": (PathMessage, positions),
    "planned_path": (PathMessage, positions),
    "target_cloud": (PointCloud2, lambda message: message.data),
    "time_average_cloud": (PointCloud2, lambda message: message.data),
    "workspace": (Marker, lambda message: str(message.points)),
}


def service(name, service_class):
    rospy.wait_for_service(name, TIMEOUT)
    return rospy.ServiceProxy(name, service_class)


class LearnTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.status = None
        cls.changed = threading.Condition()
        cls.contents = {topic: set() for topic in CONTENTS}
        rospy.Subscriber("training_status", TrainingStatus, cls.on_status)
        for topic, (message_class, content) in CONTENTS.items():
            rospy.Subscriber(topic, message_class, cls.on_message, (topic, content))
        cls.first = rospy.wait_for_message("observation", Observation, TIMEOUT)

    @classmethod
    def on_message(cls, message, arguments):
        topic, content = arguments
        if len(content(message)):
            with cls.changed:
                cls.contents[topic].add(content(message))
                cls.changed.notify_all()

    @classmethod
    def on_status(cls, message):
        with cls.changed:
            cls.status = message
            cls.changed.notify_all()

    @classmethod
    def wait_for_status(cls, condition):
        with cls.changed:
            assert cls.changed.wait_for(lambda: cls.status is not None and condition(cls.status), 2 * TIMEOUT)
            return cls.status

    def test_target_and_time_average_are_distributions(self):
        message = rospy.wait_for_message("target_distribution", TargetDistribution, TIMEOUT)
        self.assertEqual(len(message.states), 3 * len(message.target))
        self.assertAlmostEqual(sum(message.target), 1.0, places=6)
        self.assertAlmostEqual(sum(message.time_average), 1.0, places=6)
        self.assertGreater(message.ergodic_measure, 0.0)
        self.assertTrue(0.0 < message.coverage < 1.0)

    def test_published_topics_are_neither_empty_nor_constant(self):
        publishers, _, _ = rosgraph.Master(rospy.get_name()).getSystemState()
        topics = {topic for topic, nodes in publishers if {"/ergodic_planner", "/trainer"} & set(nodes)}
        # Clusters are published with stop: stable only.
        others = {"/rosout", "/diagnostics", "/cluster_markers"}
        self.assertEqual(topics - others, {f"/{topic}" for topic in CONTENTS})
        with self.changed:
            self.changed.wait_for(lambda: not self.missing_contents(), TIMEOUT)
        self.assertEqual(self.missing_contents(), [])

    @classmethod
    def missing_contents(cls):
        """Return the topics with less than two different, non-empty contents; the workspace is constant."""
        return [topic for topic in CONTENTS if len(cls.contents[topic]) < (1 if topic == "workspace" else 2)]

    def test_paused_planner_releases_arm(self):
        pause, resume = service("planner/pause", Trigger), service("planner/resume", Trigger)
        self.assertEqual(pause().message, "paused")
        state = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        np.testing.assert_allclose(state_arrays(state)[1], 0.0, atol=1e-4)
        response = service("arm/move", MoveArm)(0.05, 0.0, 0.0, 0.2)
        self.assertTrue(response.success, response.message)
        self.assertTrue(service("arm/stop", Trigger)().success)
        self.assertTrue(resume().success)
        rospy.wait_for_message("observation", Observation, TIMEOUT)

    def test_observation_with_gap_or_nan_rejected(self):
        observe = service("trainer/observe", Observe)
        gap = Observation(self.first.header, 10**6, self.first.state, self.first.image)
        self.assertFalse(observe(ObserveRequest(gap)).success)
        broken = copy.deepcopy(self.first)
        broken.state.x = float("nan")
        self.assertFalse(observe(ObserveRequest(broken)).success)

    def test_random_bytes_leave_services_open(self):
        noise = np.random.default_rng(0)
        for name in ("trainer/observe", "arm/move"):
            uri = urlparse(rospy.get_master().lookupService(rospy.resolve_name(name))[2])
            for size in (0, 3, 4, 40, 300):
                with socket.create_connection((uri.hostname, uri.port), TIMEOUT) as connection:
                    connection.sendall(noise.bytes(size))
        self.assertTrue(service("trainer/observe", Observe)(ObserveRequest(self.first)).success)
        self.assertFalse(service("arm/move", MoveArm)(float("nan"), 0.0, 0.0, 0.2).success)

    def test_entropy_and_latents_available_during_training(self):
        self.wait_for_status(lambda status: status.updates > 0)
        states = np.array([[0.4, 0.0, 0.0], [0.5, 0.1, 1.0]])
        entropy = service("trainer/entropy", EvaluateEntropy)(EvaluateEntropyRequest(1, states.ravel().tolist()))
        self.assertTrue(entropy.success and entropy.ready and entropy.learned)
        self.assertEqual(len(entropy.log_std), 2)
        latents = service("trainer/encode", Encode)(EncodeRequest([self.first.state], [self.first.image]))
        self.assertTrue(latents.success, latents.message)
        self.assertEqual(len(latents.means), latents.latent_size)
        self.assertTrue(all(std > 0.0 for std in latents.stds))

    def test_every_node_publishes_diagnostics(self):
        # One subscription for all messages: a new one for each could miss the same node repeatedly.
        seen, everyone, complete = set(), {"arm", "trainer", "planner", "fingerprinter", "monitor"}, threading.Event()

        def note(message):
            seen.update(status.name.split(": ")[-1] for status in message.status)
            if seen >= everyone:
                complete.set()

        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, note)
        complete.wait(TIMEOUT)
        subscriber.unregister()
        self.assertLessEqual(everyone, seen)

    @classmethod
    def tearDownClass(cls):
        """Check that the run ends with a complete session."""
        status = cls.wait_for_status(lambda status: status.finished)
        path = Path(status.session)
        summary = path / "summary.yaml"
        figures = [path / "figures" / f"{name}.png" for name in ("learning_metrics", "reconstructions", "entropy")]
        waiting = threading.Event()
        for _ in range(600):
            if all(file.exists() for file in (summary, *figures)):
                break
            waiting.wait(0.2)
        session = Session.open_read_only(path)
        assert len(session.open_observations()) == STEPS
        assert session.read_table("training")["update"].tolist() == list(range(1, STEPS + 1))
        assert session.read_table("exploration")["step"].tolist() == list(range(1, STEPS + 1))
        assert read_summary(summary).finished
        assert session.paths.model.exists()
        assert [file.name for file in figures if not file.exists()] == []
        assert service("trainer/save", Trigger)().success
        response = service("planner/pause", Trigger)()
        assert (response.success, response.message) == (False, "exploration is complete")


if __name__ == "__main__":
    rospy.init_node("check_learn")
    rostest.rosrun("embodied_active_learning", "check_learn", LearnTest)
