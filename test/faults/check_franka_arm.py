#!/usr/bin/env python3
"""A Panda's node before the stand-in for franka_ros: what it moves, and every fault of robot, person and computer."""

import json
import os
import sys
import time
import unittest
from pathlib import Path

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from embodied_active_learning.msg import ArmCause, PlanarState
from embodied_active_learning.srv import GoToPose, MoveArm
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import SetBool, Trigger

import rostest
from embodied_active_learning.config import Config
from embodied_active_learning.ros.conversions import state_arrays
from embodied_active_learning.workspace import Workspace
from node_process import NodeProcess

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))

from fake_franka.generate import DEFAULT_FOLDER, generate
from threads import in_a_thread

TIMEOUT = 60.0
CENTRE = Workspace().centre
OURS, OTHER = "cartesian_impedance_example_controller", "position_joint_trajectory_controller"
OPERATOR = {"callerid": "/operator"}


def until(condition):
    """Return as soon as a condition holds; a busy machine may take its time."""
    ends_at = time.monotonic() + TIMEOUT
    while not condition():
        if time.monotonic() > ends_at:
            raise AssertionError("it has not come about")
        time.sleep(0.01)


class Move:
    """A move in a thread of its own, and its answer."""

    def __init__(self, service, velocity=(0.05, 0.0, 0.0), duration=1.0):
        self.answer = None
        self._thread = in_a_thread(self._run, service, (*velocity, duration))

    def _run(self, service, arguments):
        self.answer = service(*arguments)

    def answered(self):
        self._thread.join(TIMEOUT)
        return self.answer


class FrankaArmTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        generate(DEFAULT_FOLDER)
        sys.path.append(str(DEFAULT_FOLDER))
        os.environ["PYTHONPATH"] = f"{os.environ['PYTHONPATH']}:{DEFAULT_FOLDER}"
        cls.config = Config.from_dict(rospy.get_param("/config"))
        cls.states, cls.health = [], {}
        rospy.Subscriber("arm/state", PlanarState, cls.states.append)
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics)
        cls.move = rospy.ServiceProxy("arm/move", MoveArm)
        cls.go_to = rospy.ServiceProxy("arm/go_to", GoToPose)
        cls.stop = rospy.ServiceProxy("arm/stop", Trigger)
        cls.operator_stops = rospy.ServiceProxy("arm/stop", Trigger, headers=OPERATOR)
        cls.recover = rospy.ServiceProxy("arm/recover", Trigger)
        rospy.wait_for_service("fake_franka/truth", TIMEOUT)
        cls.arm = NodeProcess("franka_arm")
        rospy.wait_for_service("arm/recover", TIMEOUT)

    @classmethod
    def tearDownClass(cls):
        cls.arm.end()

    @classmethod
    def on_diagnostics(cls, message):
        cls.health.update({status.name: status for status in message.status})

    def setUp(self):
        for switch in ("user_stop", "silence_states", "silence_everything"):
            self.switch(switch, False)
        self.is_recovered()
        until(lambda: self.states)
        if abs(self.states[-1].x - CENTRE[0]) > 0.04:
            answer = self.go_to(*CENTRE)
            self.assertTrue(answer.success, answer.message)
        self.truth()

    def tearDown(self):
        truth = self.truth()
        arm = self.config.arm
        self.assertLessEqual(truth["max_speed"], 1.05 * np.hypot(arm.max_speed, arm.max_speed))
        self.assertLessEqual(truth["max_turn_rate"], 1.05 * arm.max_turn_rate)
        self.assertLessEqual(truth["max_outside"], 0.005)
        self.assertEqual(truth["refused_commands"], [])

    def truth(self):
        """What the arm truly did since this was asked last."""
        return json.loads(rospy.ServiceProxy("fake_franka/truth", Trigger)().message)

    def trigger(self, fault):
        self.assertTrue(rospy.ServiceProxy(f"fake_franka/{fault}", Trigger)().success)

    def switch(self, fault, on):
        self.assertTrue(rospy.ServiceProxy(f"fake_franka/{fault}", SetBool)(on).success)

    def controllers(self, service, *arguments):
        from controller_manager_msgs import srv  # noqa: PLC0415  made by setUpClass

        kind = {
            "load": srv.LoadController,
            "unload": srv.UnloadController,
            "switch": srv.SwitchController,
        }[service]
        return rospy.ServiceProxy(f"controller_manager/{service}_controller", kind)(*arguments).ok

    def is_recovered(self):
        """Until the arm takes commands, by a person's word where need be."""
        answers = []
        until(lambda: answers.append(self.recover()) or answers[-1].success)

    def moving(self, duration=1.0, **headers):
        """A move under way, with the arm in motion."""
        service = rospy.ServiceProxy("arm/move", MoveArm, headers=headers) if headers else self.move
        move = Move(service, duration=duration)
        until(lambda: self.states and self.states[-1].vx > 0.02)
        return move

    def takes_commands(self):
        """Until the arm moves again when it is told to, as a planner tries it again and again."""
        answers = []
        until(lambda: answers.append(self.move(0.0, 0.0, 0.0, 0.1)) or answers[-1].success)
        return answers

    def stands_still(self):
        """Until the arm truly does -> what it did until then."""
        told = [self.truth()]
        until(lambda: told[-1]["speed"] < 1e-3 or told.append(self.truth()))
        return {**told[-1], "travelled": sum(each["travelled"] for each in told)}

    def test_moves_join_and_are_answered_with_what_was_measured(self):
        for _ in range(4):
            answer = self.move(0.05, -0.03, 0.2, 0.2)
            self.assertTrue(answer.success, answer.message)
        state, velocity = state_arrays(answer.state)
        self.assertGreater(velocity[0], 0.02)
        self.assertGreater(state[0], CENTRE[0] + 0.01)
        self.assertIn(answer.state.header.stamp, [each.header.stamp for each in self.states[-20:]])
        self.stands_still()

    def test_the_arm_goes_to_a_pose_and_stops_there(self):
        target = np.add(CENTRE, (-0.04, 0.04, 0.5))
        answer = self.go_to(*target)
        self.assertTrue(answer.success, answer.message)
        state, velocity = state_arrays(answer.state)
        np.testing.assert_allclose(state[:2], target[:2], atol=self.config.franka.tolerance)
        np.testing.assert_allclose(velocity, 0.0, atol=0.04)
        np.testing.assert_allclose(self.truth()["pose"], state, atol=5e-3)

    def test_a_velocity_that_leads_out_of_the_workspace_ends_inside_it(self):
        corner = Workspace().upper
        self.assertTrue(self.go_to(corner[0] - 0.02, corner[1] - 0.02, 0.0).success)
        for _ in range(5):
            answer = self.move(0.15, 0.15, 0.0, 0.2)
        self.assertTrue(answer.limited)
        self.stands_still()

    def test_a_command_that_is_no_number_is_refused(self):
        answer = self.move(float("nan"), 0.0, 0.0, 0.2)
        self.assertEqual(answer.cause, ArmCause.REFUSED)
        self.assertFalse(self.go_to(1.5, 0.0, 0.0).success)

    def test_a_stop_ends_the_move_under_way_and_lasts_until_the_arm_is_recovered(self):
        move = self.moving()
        answer = self.operator_stops()
        self.assertTrue(answer.success, answer.message)
        self.assertLess(self.truth()["speed"], 0.02)
        self.assertEqual(move.answered().cause, ArmCause.STOPPED)
        self.assertIn("stopped by /operator", move.answer.message)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.STOPPED)
        self.is_recovered()
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_a_reflex_ends_the_move_by_its_name_and_the_arm_recovers_by_itself(self):
        move = self.moving()
        self.trigger("reflex")
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertIn("cartesian_reflex", move.answer.message)
        answers = self.takes_commands()
        self.assertEqual({answer.cause for answer in answers[:-1]}, {ArmCause.BUSY})
        truth = self.truth()
        self.assertEqual(truth["recoveries"], 1)
        self.assertEqual(truth["reflexes"], 1, "the arm was drawn back by a set-point of before")

    def test_recoveries_that_fail_need_a_person_in_the_end(self):
        self.trigger("fail_next_recovery")
        move = self.moving()
        self.trigger("reflex")
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        until(lambda: self.move(0.0, 0.0, 0.0, 0.1).cause == ArmCause.STOPPED)
        answer = self.move(0.0, 0.0, 0.0, 0.1)
        self.assertIn("after 1 recoveries in a row", answer.message)
        self.assertIn("manual error recovery required", answer.message)
        self.assertEqual(self.truth()["recoveries"], 0)
        self.assertTrue(self.recover().success)

    def test_a_user_stop_is_never_recovered_from_but_by_a_person(self):
        move = self.moving()
        self.switch("user_stop", True)
        self.assertEqual(move.answered().cause, ArmCause.STOPPED)
        self.assertIn("user stop is pressed", move.answer.message)
        self.assertIn("release it", self.recover().message)
        until(lambda: "user stop is pressed" in self.health["franka_arm: arm"].message)
        self.switch("user_stop", False)
        until(lambda: "user stop was pressed, and is released" in self.move(0.0, 0.0, 0.0, 0.1).message)
        truth = self.truth()
        self.assertEqual((truth["recoveries"], truth["speed"]), (0, 0.0))
        answer = self.recover()
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_a_silence_holds_the_arm_until_states_come_again(self):
        move = self.moving(duration=1.0)
        self.switch("silence_states", True)
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertIn("no new state of the robot", move.answer.message)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.BUSY)
        self.assertFalse(self.operator_stops().success, "nobody knows whether it stands still")
        self.stands_still()
        before = self.truth()["pose"]
        self.switch("silence_states", False)
        self.is_recovered()
        self.takes_commands()
        self.stands_still()
        np.testing.assert_allclose(self.truth()["pose"], before, atol=5e-3)

    def test_after_the_computer_of_the_robot_was_away_the_arm_goes_on_by_itself(self):
        move = self.moving()
        self.switch("silence_everything", True)
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.BUSY)
        self.switch("silence_everything", False)
        self.takes_commands()
        self.assertEqual(self.truth()["recoveries"], 1)

    def test_another_controller_is_named_and_never_stopped(self):
        self.controllers("load", OTHER)
        self.assertTrue(self.controllers("switch", [OTHER], [OURS], 2, False, 0.0))
        until(lambda: OTHER in self.move(0.0, 0.0, 0.0, 0.1).message)
        answer = self.recover()
        self.assertFalse(answer.success)
        self.assertIn(f"{OTHER} moves the robot", answer.message)
        self.assertTrue(self.controllers("switch", [], [OTHER], 2, False, 0.0), "it was stopped by somebody else")
        until(lambda: "was stopped, not by this node" in self.move(0.0, 0.0, 0.0, 0.1).message)
        self.assertTrue(self.recover().success)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_a_franka_control_that_was_started_anew_is_prepared_when_a_person_says_so(self):
        self.assertTrue(self.controllers("switch", [], [OURS], 2, False, 0.0))
        self.assertTrue(self.controllers("unload", OURS))
        until(lambda: "was stopped, not by this node" in self.move(0.0, 0.0, 0.0, 0.1).message)
        answer = self.recover()
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_another_node_that_sends_set_points_is_named(self):
        rival = rospy.Publisher(f"{OURS}/equilibrium_pose", PoseStamped, queue_size=1)
        until(lambda: "/check_franka_arm sends set-points" in self.move(0.0, 0.0, 0.0, 0.1).message)
        rival.unregister()
        self.takes_commands()

    def test_the_arm_comes_to_rest_when_the_node_that_drives_it_is_dead_and_is_free_then(self):
        dead = rospy.ServiceProxy("arm/move", MoveArm, headers={"callerid": "/dead"})
        self.assertTrue(self.stop().success)
        self.assertTrue(dead(0.1, 0.0, 0.0, 0.2).success)
        self.assertLess(self.stands_still()["travelled"], 0.1)
        self.takes_commands()

    def test_a_killed_node_leaves_the_arm_at_rest_and_is_ready_again_when_it_is_started_anew(self):
        self.operator_stops()
        self.is_recovered()
        self.moving(duration=1.0, callerid="/somebody")
        self.arm.kill()
        self.stands_still()
        self.assertEqual(self.truth()["reflexes"], 0)
        type(self).arm = NodeProcess("franka_arm")
        self.takes_commands_anew()
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def takes_commands_anew(self):
        def tried():
            try:
                return self.move(0.0, 0.0, 0.0, 0.1).success
            except rospy.ServiceException:
                return False

        until(tried)

    def test_the_pose_that_jumps_ends_the_move_and_the_arm_stays_where_it_is_now(self):
        """One of the last: afterwards the stand-in tells poses that are beside the truth."""
        move = self.moving()
        self.trigger("pose_jump")
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertIn("the robot's pose jumped", move.answer.message)
        self.takes_commands()
        self.stands_still()

    def test_when_it_is_asked_to_end_in_a_move_the_node_brakes_and_ends_well(self):
        """The last one: the node is gone afterwards."""
        self.moving(duration=1.0)
        self.assertEqual(self.arm.end(), 0)
        self.assertLess(self.truth()["speed"], 0.02)


if __name__ == "__main__":
    rospy.init_node("check_franka_arm")
    rostest.rosrun("embodied_active_learning", "check_franka_arm", FrankaArmTest)
