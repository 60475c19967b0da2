#!/usr/bin/env python3
"""The learning pipeline while it runs: services, topics, and the session it leaves behind."""

import copy
import threading
import unittest
from pathlib import Path

import numpy as np
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

import rostest
from embodied_active_learning.ros.conversions import state_arrays
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary

TIMEOUT = 60.0


def service(name, service_class):
    rospy.wait_for_service(name, TIMEOUT)
    return rospy.ServiceProxy(name, service_class)


class LearnTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.status = None
        cls.changed = threading.Condition()
        rospy.Subscriber("training_status", TrainingStatus, cls.on_status)
        cls.first = rospy.wait_for_message("observation", Observation, TIMEOUT)

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

    def test_the_target_and_the_time_average_are_distributions_over_the_samples(self):
        message = rospy.wait_for_message("target_distribution", TargetDistribution, TIMEOUT)
        self.assertEqual(len(message.states), 3 * len(message.target))
        self.assertAlmostEqual(sum(message.target), 1.0, places=6)
        self.assertAlmostEqual(sum(message.time_average), 1.0, places=6)
        self.assertGreater(message.ergodic_measure, 0.0)
        self.assertTrue(0.0 < message.coverage < 1.0)

    def test_rviz_gets_paths_and_clouds(self):
        for topic, message_class in (("travelled_path", PathMessage), ("target_cloud", PointCloud2)):
            message = rospy.wait_for_message(topic, message_class, TIMEOUT)
            self.assertEqual(message.header.frame_id, "panda_link0")

    def test_a_paused_planner_has_given_the_arm_back(self):
        pause, resume = service("planner/pause", Trigger), service("planner/resume", Trigger)
        self.assertEqual(pause().message, "paused")
        state = rospy.wait_for_message("arm/state", PlanarState, TIMEOUT)
        np.testing.assert_allclose(state_arrays(state)[1], 0.0, atol=1e-4)
        answer = service("arm/move", MoveArm)(0.05, 0.0, 0.0, 0.2)
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(service("arm/stop", Trigger)().success)
        self.assertTrue(resume().success)
        rospy.wait_for_message("observation", Observation, TIMEOUT)

    def test_another_node_cannot_drive_the_arm_meanwhile(self):
        answer = service("arm/move", MoveArm)(0.1, 0.0, 0.0, 0.2)
        self.assertFalse(answer.success)
        self.assertIn("/ergodic_planner", answer.message)

    def test_an_observation_handed_over_again_is_not_stored_twice(self):
        observe = service("trainer/observe", Observe)
        before = observe(ObserveRequest(self.first))
        self.assertTrue(before.success, before.message)
        self.assertGreater(before.observations, self.first.index)

    def test_an_observation_that_leaves_a_gap_or_is_not_a_number_is_refused(self):
        observe = service("trainer/observe", Observe)
        gap = Observation(self.first.header, 10**6, self.first.state, self.first.image)
        self.assertFalse(observe(ObserveRequest(gap)).success)
        broken = copy.deepcopy(self.first)
        broken.state.x = float("nan")
        self.assertFalse(observe(ObserveRequest(broken)).success)

    def test_the_trainer_answers_entropy_and_latents_while_it_learns(self):
        self.wait_for_status(lambda status: status.updates > 0)
        states = np.array([[0.4, 0.0, 0.0], [0.5, 0.1, 1.0]])
        entropy = service("trainer/entropy", EvaluateEntropy)(EvaluateEntropyRequest(1, states.ravel().tolist()))
        self.assertTrue(entropy.success and entropy.ready and entropy.learned)
        self.assertEqual(len(entropy.log_std), 2)
        latents = service("trainer/encode", Encode)(EncodeRequest([self.first.state], [self.first.image]))
        self.assertTrue(latents.success, latents.message)
        self.assertEqual(len(latents.means), latents.latent_size)
        self.assertTrue(all(std > 0.0 for std in latents.stds))

    def test_entropy_at_states_that_are_no_numbers_is_refused(self):
        answer = service("trainer/entropy", EvaluateEntropy)(EvaluateEntropyRequest(0, [float("nan")] * 3))
        self.assertFalse(answer.success)

    def test_every_node_reports_its_health(self):
        # One subscription: one for each message may miss a node again and again, whose turn is always just then.
        seen, everyone, complete = set(), {"arm", "trainer", "planner", "fingerprinter", "monitor"}, threading.Event()

        def note(message):
            seen.update(status.name.split(": ")[-1] for status in message.status)
            if seen >= everyone:
                complete.set()

        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, note)
        complete.wait(TIMEOUT)
        subscriber.unregister()
        self.assertLessEqual(everyone, seen)

    def test_latents_at_poses_that_are_no_numbers_are_refused(self):
        broken = copy.deepcopy(self.first.state)
        broken.theta = float("nan")
        self.assertFalse(service("trainer/encode", Encode)(EncodeRequest([broken], [self.first.image])).success)

    def test_z_the_run_ends_with_a_whole_session(self):
        status = self.wait_for_status(lambda status: status.finished)
        path = Path(status.session)
        summary = path / "summary.yaml"
        waiting = threading.Event()
        for _ in range(600):
            if summary.exists():
                break
            waiting.wait(0.2)
        session = Session.open_read_only(path)
        self.assertEqual(len(session.open_observations()), 60)
        self.assertEqual(session.read_table("training")["update"].tolist(), list(range(1, 61)))
        self.assertEqual(session.read_table("exploration")["step"].tolist(), list(range(1, 61)))
        self.assertTrue(read_summary(summary).finished)
        self.assertTrue(session.paths.model.exists())
        for name in ("learning_metrics", "reconstructions", "entropy"):
            self.assertTrue((session.paths.figures / f"{name}.png").exists(), name)
        self.assertTrue(service("trainer/save", Trigger)().success)
        answer = service("planner/pause", Trigger)()
        self.assertEqual((answer.success, answer.message), (False, "exploration is complete"))


if __name__ == "__main__":
    rospy.init_node("check_learn")
    rostest.rosrun("embodied_active_learning", "check_learn", LearnTest)
