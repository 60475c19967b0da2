#!/usr/bin/env python3
"""The Panda's node against the stand-in for franka_ros: commands, and faults of robot, person and computer."""

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
IDLE = 1  # robot_mode
OPERATOR = {"callerid": "/operator"}


def until(condition):
    """Wait for a condition."""
    ends_at = time.monotonic() + TIMEOUT
    while not condition():
        if time.monotonic() > ends_at:
            raise AssertionError("timeout")
        time.sleep(0.01)


class Move:
    """A move in a thread, and its response."""

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
        for switch in ("user_stop", "silence_states", "silence_everything", "hang_controller_manager"):
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
        """Return the true motion since the last call."""
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
        """Call recover until the arm accepts commands."""
        answers = []
        until(lambda: answers.append(self.recover()) or answers[-1].success)

    def moving(self, duration=1.0, **headers):
        """Start a move and wait until the arm moves."""
        service = rospy.ServiceProxy("arm/move", MoveArm, headers=headers) if headers else self.move
        move = Move(service, duration=duration)
        until(lambda: self.states and self.states[-1].vx > 0.02)
        return move

    def takes_commands(self):
        """Retry a move until the arm accepts it -> all responses."""
        answers = []
        until(lambda: answers.append(self.move(0.0, 0.0, 0.0, 0.1)) or answers[-1].success)
        return answers

    def stands_still(self):
        """Wait until the arm is at rest -> its true motion until then."""
        truths = [self.truth()]
        until(lambda: truths[-1]["speed"] < 1e-3 or truths.append(self.truth()))
        return {**truths[-1], "travelled": sum(each["travelled"] for each in truths)}

    def test_moves_join_and_return_measured_state(self):
        for _ in range(4):
            answer = self.move(0.05, -0.03, 0.2, 0.2)
            self.assertTrue(answer.success, answer.message)
        state, velocity = state_arrays(answer.state)
        self.assertGreater(velocity[0], 0.02)
        self.assertGreater(state[0], CENTRE[0] + 0.01)
        until(lambda: answer.state.header.stamp in [each.header.stamp for each in self.states[-20:]])
        self.stands_still()

    def test_go_to_reaches_pose_and_stops(self):
        target = np.add(CENTRE, (-0.04, 0.04, 0.5))
        answer = self.go_to(*target)
        self.assertTrue(answer.success, answer.message)
        state, velocity = state_arrays(answer.state)
        np.testing.assert_allclose(state[:2], target[:2], atol=self.config.franka.tolerance)
        np.testing.assert_allclose(velocity, 0.0, atol=0.04)
        np.testing.assert_allclose(self.truth()["pose"], state, atol=5e-3)

    def test_move_ends_inside_workspace(self):
        corner = Workspace().upper
        self.assertTrue(self.go_to(corner[0] - 0.02, corner[1] - 0.02, 0.0).success)
        for _ in range(5):
            answer = self.move(0.15, 0.15, 0.0, 0.2)
        self.assertTrue(answer.limited)
        self.stands_still()

    def test_invalid_commands_are_rejected(self):
        answer = self.move(float("nan"), 0.0, 0.0, 0.2)
        self.assertEqual(answer.cause, ArmCause.REFUSED)
        self.assertFalse(self.go_to(1.5, 0.0, 0.0).success)

    def test_stop_aborts_move_and_lasts_until_recovery(self):
        move = self.moving()
        answer = self.operator_stops()
        self.assertTrue(answer.success, answer.message)
        self.assertLess(self.truth()["speed"], 0.02)
        self.assertEqual(move.answered().cause, ArmCause.STOPPED)
        self.assertIn("stopped by /operator", move.answer.message)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.STOPPED)
        self.is_recovered()
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_reflex_aborts_move_and_arm_recovers_automatically(self):
        move = self.moving()
        self.trigger("reflex")
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertIn("cartesian_reflex", move.answer.message)
        answers = self.takes_commands()
        self.assertEqual({answer.cause for answer in answers[:-1]}, {ArmCause.BUSY})
        truth = self.truth()
        self.assertEqual(truth["recoveries"], 1)
        self.assertEqual(truth["reflexes"], 1, "an earlier set-point has moved the arm")

    def test_failed_recovery_holds_robot(self):
        self.trigger("fail_next_recovery")
        move = self.moving()
        self.trigger("reflex")
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        until(lambda: self.move(0.0, 0.0, 0.0, 0.1).cause == ArmCause.STOPPED)
        answer = self.move(0.0, 0.0, 0.0, 0.1)
        self.assertIn("after 1 consecutive recoveries", answer.message)
        self.assertIn("manual error recovery required", answer.message)
        self.assertEqual(self.truth()["recoveries"], 0)
        self.assertTrue(self.recover().success)

    def test_user_stop_needs_recovery_by_a_person(self):
        move = self.moving()
        self.switch("user_stop", True)
        self.assertEqual(move.answered().cause, ArmCause.STOPPED)
        self.assertIn("user stop is pressed", move.answer.message)
        self.assertIn("release it", self.recover().message)
        until(lambda: "user stop is pressed" in self.health["franka_arm: arm"].message)
        self.switch("user_stop", False)
        until(lambda: "user stop was pressed and has been released" in self.move(0.0, 0.0, 0.0, 0.1).message)
        truth = self.truth()
        self.assertEqual((truth["recoveries"], truth["speed"]), (0, 0.0))
        answer = self.recover()
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_stale_states_hold_arm_until_they_return(self):
        move = self.moving(duration=1.0)
        self.switch("silence_states", True)
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertIn("no new robot state", move.answer.message)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.BUSY)
        self.assertFalse(self.operator_stops().success, "it is unknown whether the arm is at rest")
        self.stands_still()
        before = self.truth()["pose"]
        self.switch("silence_states", False)
        self.is_recovered()
        self.takes_commands()
        self.stands_still()
        np.testing.assert_allclose(self.truth()["pose"], before, atol=5e-3)

    def test_arm_recovers_after_loss_of_robot_computer(self):
        move = self.moving()
        self.switch("silence_everything", True)
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.BUSY)
        self.switch("silence_everything", False)
        self.takes_commands()
        self.assertEqual(self.truth()["recoveries"], 1)

    def test_other_controller_is_reported_and_not_stopped(self):
        self.controllers("load", OTHER)
        self.assertTrue(self.controllers("switch", [OTHER], [OURS], 2, False, 0.0))
        until(lambda: OTHER in self.move(0.0, 0.0, 0.0, 0.1).message)
        answer = self.recover()
        self.assertFalse(answer.success)
        self.assertIn(f"another controller moves the robot: {OTHER}", answer.message)
        self.assertTrue(self.controllers("switch", [], [OTHER], 2, False, 0.0), "another node has stopped it")
        until(lambda: "the requested recovery failed" in self.move(0.0, 0.0, 0.0, 0.1).message)
        self.assertTrue(self.recover().success)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_hanging_controller_manager_holds_arm(self):
        self.switch("hang_controller_manager", True)
        until(lambda: "no response from controller_manager" in self.move(0.0, 0.0, 0.0, 0.1).message)
        answer = self.recover()
        self.assertFalse(answer.success)
        self.assertIn("no response from controller_manager", answer.message)
        self.switch("hang_controller_manager", False)
        until(lambda: "the requested recovery failed" in self.move(0.0, 0.0, 0.0, 0.1).message)
        self.is_recovered()
        self.takes_commands()

    def test_unloaded_controller_is_restored_by_recover(self):
        self.assertTrue(self.controllers("switch", [], [OURS], 2, False, 0.0))
        self.assertTrue(self.controllers("unload", OURS))
        until(lambda: "was stopped by another node" in self.move(0.0, 0.0, 0.0, 0.1).message)
        answer = self.recover()
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)

    def test_error_from_before_restart_of_franka_control_is_cleared(self):
        """Recovery succeeds without effect until franka_control itself has seen the error."""
        self.moving()
        self.trigger("restart_franka_control")
        until(lambda: self.move(0.0, 0.0, 0.0, 0.1).cause == ArmCause.STOPPED)
        answer = self.recover()
        self.assertTrue(answer.success, answer.message)
        self.assertTrue(self.move(0.05, 0.0, 0.0, 0.2).success)
        self.assertEqual(self.truth()["stiffness"], [200.0, 30.0])

    def reload_controller(self):
        self.assertTrue(self.controllers("switch", [], [OURS], 2, False, 0.0), "not stopped")
        self.assertTrue(self.controllers("unload", OURS), "not unloaded")
        until(lambda: "was stopped by another node" in self.move(0.0, 0.0, 0.0, 0.1).message)
        return self.recover()

    def test_stiffness_is_set_under_either_name_of_its_server(self):
        self.assertEqual(self.truth()["stiffness"], [200.0, 30.0])
        rospy.set_param("fake_franka/old_stiffness_name", True)
        try:
            answer = self.reload_controller()
        finally:
            rospy.set_param("fake_franka/old_stiffness_name", False)
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(self.truth()["stiffness"], [200.0, 30.0])
        answer = self.reload_controller()
        self.assertTrue(answer.success, answer.message)

    def test_stiffness_that_is_not_adopted_is_refused(self):
        rospy.set_param("fake_franka/ignore_stiffness", True)
        try:
            answer = self.reload_controller()
        finally:
            rospy.set_param("fake_franka/ignore_stiffness", False)
        self.assertFalse(answer.success)
        self.assertIn("did not adopt rotational_stiffness 30: it uses 10", answer.message)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).success, False)

    def test_earlier_load_is_cleared(self):
        from franka_msgs.srv import SetLoad  # noqa: PLC0415  made by setUpClass

        self.assertTrue(self.controllers("switch", [], [OURS], 2, False, 0.0))
        until(lambda: self.truth()["mode"] == IDLE)
        self.assertTrue(rospy.ServiceProxy("franka_control/set_load", SetLoad)(0.5, [0.0] * 3, [0.0] * 9).success)
        self.assertEqual(self.truth()["load"], 0.5)
        until(lambda: "was stopped by another node" in self.move(0.0, 0.0, 0.0, 0.1).message)
        self.assertTrue(self.recover().success)
        self.assertEqual(self.truth()["load"], 0.0)

    def test_other_publisher_of_set_points_is_reported(self):
        rival = rospy.Publisher(f"{OURS}/equilibrium_pose", PoseStamped, queue_size=1)
        until(lambda: "another node publishes set-points" in self.move(0.0, 0.0, 0.0, 0.1).message)
        rival.unregister()
        self.takes_commands()

    def test_arm_stops_when_commander_falls_silent(self):
        dead = rospy.ServiceProxy("arm/move", MoveArm, headers={"callerid": "/dead"})
        self.assertTrue(self.stop().success)
        self.assertTrue(dead(0.1, 0.0, 0.0, 0.2).success)
        self.assertLess(self.stands_still()["travelled"], 0.1)
        self.takes_commands()

    def test_killed_node_leaves_arm_at_rest_and_restarts(self):
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

    def test_z_pose_jump_aborts_move_and_holds_arm(self):
        """One of the last: afterwards the reported poses are wrong."""
        move = self.moving()
        self.trigger("pose_jump")
        self.assertEqual(move.answered().cause, ArmCause.FAILED)
        self.assertIn("the robot's pose jumped", move.answer.message)
        self.takes_commands()
        self.stands_still()

    def test_zz_shutdown_during_move_brakes_arm(self):
        """The last one: the node has ended afterwards."""
        self.moving(duration=1.0)
        self.assertEqual(self.arm.end(), 0)
        self.assertLess(self.truth()["speed"], 0.02)


if __name__ == "__main__":
    rospy.init_node("check_franka_arm")
    rostest.rosrun("embodied_active_learning", "check_franka_arm", FrankaArmTest)
