#!/usr/bin/env python3
"""The Panda's node against the stand-in for franka_ros: commands, and faults of robot, person and computer."""

import json
import os
import unittest

import numpy as np
import rospy
import search_path  # noqa: F401  for the helpers below
from diagnostic_msgs.msg import DiagnosticArray
from embodied_active_learning.msg import ArmCause, PlanarState
from embodied_active_learning.srv import GoToPose, MoveArm
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import SetBool, Trigger

import rostest
from embodied_active_learning.config import Config
from embodied_active_learning.workspace import Workspace
from fake_franka.generate import DEFAULT_FOLDER, use_messages
from node_process import NodeProcess
from threads import in_a_thread, wait_for

TIMEOUT = 60.0
CENTRE = Workspace().centre
OURS, OTHER = "cartesian_impedance_example_controller", "position_joint_trajectory_controller"
IDLE = 1  # robot_mode
OPERATOR = {"callerid": "/operator"}


class Move:
    """A move in a thread, and its response. It lasts longer than it takes a busy machine to cause a fault."""

    def __init__(self, service, velocity=(0.03, 0.0, 0.0), duration=5.0):
        self.response = None
        self._thread = in_a_thread(self._run, service, (*velocity, duration))

    def _run(self, service, arguments):
        self.response = service(*arguments)

    def wait(self):
        self._thread.join(TIMEOUT)
        return self.response


class FrankaArmTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        use_messages()
        os.environ["PYTHONPATH"] = f"{os.environ['PYTHONPATH']}:{DEFAULT_FOLDER}"
        cls.config = Config.from_dict(rospy.get_param("/config"))
        cls.states, cls.health = [], {}
        rospy.Subscriber("arm/state", PlanarState, cls.states.append)
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics)
        cls.move = rospy.ServiceProxy("arm/move", MoveArm)
        cls.go_to = rospy.ServiceProxy("arm/go_to", GoToPose)
        cls.operator_stops = rospy.ServiceProxy("arm/stop", Trigger, headers=OPERATOR)
        cls.recover = rospy.ServiceProxy("arm/recover", Trigger)
        rospy.wait_for_service("fake_franka/truth", TIMEOUT)
        cls.arm = NodeProcess("franka_arm")
        rospy.wait_for_service("arm/recover", TIMEOUT)

    @classmethod
    def tearDownClass(cls):
        """Check that the node brakes the arm when it is shut down during a move."""
        Move(cls.move)
        wait_for(lambda: cls.states[-1].vx > 0.015, 0.01, TIMEOUT)
        assert cls.arm.end() == 0
        assert cls.truth()["speed"] < 0.012

    @classmethod
    def on_diagnostics(cls, message):
        cls.health.update({status.name: status for status in message.status})

    def setUp(self):
        for switch in ("user_stop", "silence_states", "silence_everything", "hang_controller_manager"):
            self.switch(switch, False)
        self.is_recovered()
        self.until(lambda: self.states and abs(self.states[-1].vx) < 5e-3)
        if abs(self.states[-1].x - CENTRE[0]) > 0.04:
            response = self.go_to(*CENTRE)
            self.assertTrue(response.success, response.message)
        self.truth()

    def tearDown(self):
        truth = self.truth()
        arm = self.config.arm
        self.assertLessEqual(truth["max_speed"], 1.05 * np.hypot(arm.max_speed, arm.max_speed))
        self.assertLessEqual(truth["max_turn_rate"], 1.05 * arm.max_turn_rate)
        self.assertLessEqual(truth["max_outside"], 0.005)
        self.assertEqual(truth["refused_commands"], [])

    @staticmethod
    def until(condition):
        """Wait for a condition."""
        wait_for(condition, 0.01, TIMEOUT)

    @staticmethod
    def truth():
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
        responses = []
        self.until(lambda: responses.append(self.recover()) or responses[-1].success)

    def moving(self, **headers):
        """Start a move and wait until the arm moves."""
        service = rospy.ServiceProxy("arm/move", MoveArm, headers=headers) if headers else self.move
        move = Move(service)
        self.until(lambda: self.states and self.states[-1].vx > 0.015)
        return move

    def takes_commands(self):
        """Retry a move until the arm accepts it -> all responses."""
        responses = []
        self.until(lambda: responses.append(self.move(0.0, 0.0, 0.0, 0.1)) or responses[-1].success)
        return responses

    def stands_still(self):
        """Wait until the arm is at rest -> its true motion until then."""
        truths = [self.truth()]
        self.until(lambda: truths[-1]["speed"] < 1e-3 or truths.append(self.truth()))
        return {**truths[-1], "travelled": sum(each["travelled"] for each in truths)}

    def test_stop_aborts_move_and_lasts_until_recovery(self):
        move = self.moving()
        response = self.operator_stops()
        self.assertTrue(response.success, response.message)
        self.assertLess(self.truth()["speed"], 0.012)
        self.assertEqual(move.wait().cause, ArmCause.STOPPED)
        self.assertIn("stopped by /operator", move.response.message)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.STOPPED)
        self.is_recovered()
        self.takes_commands()

    def test_reflex_aborts_move_and_arm_recovers_automatically(self):
        move = self.moving()
        self.trigger("reflex")
        self.assertEqual(move.wait().cause, ArmCause.FAILED)
        self.assertIn("cartesian_reflex", move.response.message)
        responses = self.takes_commands()
        self.assertLessEqual({response.cause for response in responses[:-1]}, {ArmCause.BUSY, ArmCause.FAILED})
        truth = self.truth()
        self.assertEqual(truth["recoveries"], 1)
        self.assertEqual(truth["reflexes"], 1, "an earlier set-point has moved the arm")

    def test_failed_recovery_holds_robot(self):
        self.trigger("fail_next_recovery")
        move = self.moving()
        self.trigger("reflex")
        self.assertEqual(move.wait().cause, ArmCause.FAILED)
        self.until(lambda: self.move(0.0, 0.0, 0.0, 0.1).cause == ArmCause.STOPPED)
        response = self.move(0.0, 0.0, 0.0, 0.1)
        self.assertIn("after 1 consecutive recoveries", response.message)
        self.assertIn("manual error recovery required", response.message)
        self.assertEqual(self.truth()["recoveries"], 0)
        self.is_recovered()

    def test_user_stop_needs_recovery_by_a_person(self):
        move = self.moving()
        self.switch("user_stop", True)
        self.assertEqual(move.wait().cause, ArmCause.STOPPED)
        self.assertIn("user stop is pressed", move.response.message)
        self.assertIn("release it", self.recover().message)
        self.until(lambda: "user stop is pressed" in self.health["franka_arm: arm"].message)
        self.switch("user_stop", False)
        self.until(lambda: "user stop was pressed and has been released" in self.move(0.0, 0.0, 0.0, 0.1).message)
        truth = self.truth()
        self.assertEqual((truth["recoveries"], truth["speed"]), (0, 0.0))
        self.is_recovered()
        self.takes_commands()

    def test_stale_states_hold_arm_until_they_return(self):
        move = self.moving()
        self.switch("silence_states", True)
        self.assertEqual(move.wait().cause, ArmCause.FAILED)
        self.assertIn("no new robot state", move.response.message)
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
        self.assertEqual(move.wait().cause, ArmCause.FAILED)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).cause, ArmCause.BUSY)
        self.switch("silence_everything", False)
        self.takes_commands()
        self.assertEqual(self.truth()["recoveries"], 1)

    def test_other_controller_is_reported_and_not_stopped(self):
        self.controllers("load", OTHER)
        self.assertTrue(self.controllers("switch", [OTHER], [OURS], 2, False, 0.0))
        self.until(lambda: OTHER in self.move(0.0, 0.0, 0.0, 0.1).message)
        response = self.recover()
        self.assertFalse(response.success)
        self.assertIn(f"another controller moves the robot: {OTHER}", response.message)
        self.assertTrue(self.controllers("switch", [], [OTHER], 2, False, 0.0), "another node has stopped it")
        self.until(lambda: "the requested recovery failed" in self.move(0.0, 0.0, 0.0, 0.1).message)
        self.is_recovered()
        self.takes_commands()

    def test_hanging_controller_manager_holds_arm(self):
        self.switch("hang_controller_manager", True)
        self.until(lambda: "no response from controller_manager" in self.move(0.0, 0.0, 0.0, 0.1).message)
        response = self.recover()
        self.assertFalse(response.success)
        self.assertIn("no response from controller_manager", response.message)
        self.switch("hang_controller_manager", False)
        self.until(lambda: "the requested recovery failed" in self.move(0.0, 0.0, 0.0, 0.1).message)
        self.is_recovered()
        self.takes_commands()

    def test_error_from_before_restart_of_franka_control_is_cleared(self):
        """Recovery succeeds without effect until franka_control itself has seen the error."""
        self.moving()
        self.trigger("restart_franka_control")
        self.until(lambda: self.move(0.0, 0.0, 0.0, 0.1).cause == ArmCause.STOPPED)
        self.is_recovered()
        self.takes_commands()
        self.assertEqual(self.truth()["stiffness"], [200.0, 30.0])

    def reload_controller(self):
        self.assertTrue(self.controllers("switch", [], [OURS], 2, False, 0.0), "not stopped")
        self.assertTrue(self.controllers("unload", OURS), "not unloaded")
        self.until(lambda: "was stopped by another node" in self.move(0.0, 0.0, 0.0, 0.1).message)
        return self.recover()

    def test_stiffness_is_set_under_either_name_of_its_server(self):
        self.assertEqual(self.truth()["stiffness"], [200.0, 30.0])
        rospy.set_param("fake_franka/old_stiffness_name", True)
        try:
            response = self.reload_controller()
        finally:
            rospy.set_param("fake_franka/old_stiffness_name", False)
        self.assertTrue(response.success, response.message)
        self.assertEqual(self.truth()["stiffness"], [200.0, 30.0])
        response = self.reload_controller()
        self.assertTrue(response.success, response.message)

    def test_stiffness_that_is_not_adopted_is_refused(self):
        rospy.set_param("fake_franka/ignore_stiffness", True)
        try:
            response = self.reload_controller()
        finally:
            rospy.set_param("fake_franka/ignore_stiffness", False)
        self.assertFalse(response.success)
        self.assertIn("did not adopt rotational_stiffness 30: it uses 10", response.message)
        self.assertEqual(self.move(0.05, 0.0, 0.0, 0.2).success, False)

    def test_earlier_load_is_cleared(self):
        from franka_msgs.srv import SetLoad  # noqa: PLC0415  made by setUpClass

        self.assertTrue(self.controllers("switch", [], [OURS], 2, False, 0.0))
        self.until(lambda: self.truth()["mode"] == IDLE)
        self.assertTrue(rospy.ServiceProxy("franka_control/set_load", SetLoad)(0.5, [0.0] * 3, [0.0] * 9).success)
        self.assertEqual(self.truth()["load"], 0.5)
        self.until(lambda: "was stopped by another node" in self.move(0.0, 0.0, 0.0, 0.1).message)
        self.is_recovered()
        self.assertEqual(self.truth()["load"], 0.0)

    def test_other_publisher_of_set_points_is_reported(self):
        rival = rospy.Publisher(f"{OURS}/equilibrium_pose", PoseStamped, queue_size=1)
        self.until(lambda: "another node publishes set-points" in self.move(0.0, 0.0, 0.0, 0.1).message)
        rival.unregister()
        self.takes_commands()

    def test_arm_stops_when_commander_falls_silent(self):
        dead = rospy.ServiceProxy("arm/move", MoveArm, headers={"callerid": "/dead"})
        self.assertTrue(self.operator_stops().success, "this node is still in control")
        self.is_recovered()
        self.until(lambda: dead(0.1, 0.0, 0.0, 0.2).success)
        self.assertLess(self.stands_still()["travelled"], 0.1)
        self.takes_commands()

    def test_killed_node_leaves_arm_at_rest_and_restarts(self):
        self.operator_stops()
        self.is_recovered()
        self.moving(callerid="/somebody")
        self.arm.kill()
        self.stands_still()
        self.assertEqual(self.truth()["reflexes"], 0)
        type(self).arm = NodeProcess("franka_arm")
        self.takes_commands_anew()

    def takes_commands_anew(self):
        def tried():
            try:
                return self.move(0.0, 0.0, 0.0, 0.1).success
            except rospy.ServiceException:
                return False

        self.until(tried)


if __name__ == "__main__":
    rospy.init_node("check_franka_arm")
    rostest.rosrun("embodied_active_learning", "check_franka_arm", FrankaArmTest)
