"""The robot's condition by its reports, its explanation, and automatic recoveries."""

import re

import pytest

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.franka.explanation import why_not_ready
from embodied_active_learning.franka.readiness import GRACE, RESET_AFTER, Readiness
from embodied_active_learning.franka.report import CONTROLLER, Condition, Controller, Report, RobotMode

RUNNING = {CONTROLLER: Controller("running", True), "franka_state_controller": Controller("running", False)}
GOOD = Report(age=0.01, mode=RobotMode.MOVE, controllers=RUNNING)
REFLEX = GOOD._replace(mode=RobotMode.REFLEX, errors=("cartesian_reflex",))


class Robot:
    """Feeds reports to Readiness at times of its own."""

    def __init__(self, recoveries=2, ready=True):
        self.now = 100.0
        self._config = FrankaConfig(recoveries=recoveries)
        self.readiness = Readiness(self._config, lambda: self.now)
        if ready:
            self.readiness.set_prepared()
            assert self.reports(GOOD) is Condition.READY

    def reports(self, report=GOOD, after=0.0, **fields):
        self.now += after
        return self.readiness.update(report._replace(**fields))

    def recovers(self, error=""):
        self.readiness.begin_recovery()
        assert self.reports(REFLEX) is Condition.RECOVERING
        self.readiness.end_recovery(error)
        assert error or self.reports(REFLEX) is Condition.STARTING, "an older state is no new reflex"

    @property
    def explanation(self):
        return why_not_ready(self.readiness, self._config)


@pytest.mark.parametrize("controllers", [{}, {**RUNNING, "pose": Controller("running", True)}])
def test_controller_that_was_stopped_needs_person(controllers):
    """Also if another node has started it again, because it has lost its settings if franka_control was restarted."""
    robot = Robot()
    robot.reports(controllers=controllers)
    assert robot.reports() is Condition.UNPREPARED
    assert "call /arm/recover" in robot.explanation
    assert not robot.readiness.needs_preparation
    robot.readiness.release()
    assert robot.readiness.needs_preparation


def test_stop_of_controller_during_user_stop_is_noticed():
    robot = Robot()
    robot.reports(mode=RobotMode.USER_STOPPED, controllers={})
    robot.readiness.release()
    assert robot.reports() is Condition.UNPREPARED


def test_restarted_franka_control_is_prepared_again():
    robot = Robot()
    robot.reports(controllers=None, age=1.0)
    assert robot.reports() is Condition.UNPREPARED
    assert robot.readiness.needs_preparation


def test_silent_controller_manager_keeps_preparation():
    robot = Robot()
    robot.reports(controllers=None)
    assert robot.reports() is Condition.READY


def test_robot_under_our_controller_alone_is_ready():
    robot = Robot()
    assert robot.readiness.is_ready
    assert robot.explanation == ""


@pytest.mark.parametrize(
    ("fields", "condition", "words"),
    [
        ({"age": None}, Condition.NO_STATE, "no robot state received yet"),
        ({"age": 0.21}, Condition.STALE, "no new robot state for 0.21 s"),
        ({"delay": 0.5}, Condition.STALE, "0.50 s off this computer's clock"),
        ({"delay": -0.5}, Condition.STALE, "synchronise the clocks"),
        ({"problem": "it is NaN"}, Condition.UNUSABLE, "unusable robot state: it is NaN"),
        ({"mode": RobotMode.USER_STOPPED}, Condition.USER_STOPPED, "release it, then call /arm/recover"),
        ({"mode": RobotMode.GUIDING}, Condition.GUIDED, "let go of it"),
        ({"mode": RobotMode.AUTOMATIC_ERROR_RECOVERY}, Condition.RECOVERING, "recovering"),
        ({"mode": RobotMode.REFLEX, "errors": ("joint_reflex",)}, Condition.REFLEX, "robot reflex .joint_reflex."),
        ({"errors": ("power_limit_violation",)}, Condition.REFLEX, "power_limit_violation"),
        ({"controllers": None}, Condition.NO_CONTROLLER_MANAGER, "no response from controller_manager"),
        (
            {"controllers": {**RUNNING, "pose": Controller("running", True)}},
            Condition.OTHER_CONTROLLER,
            "moves the robot: pose",
        ),
        ({"publishers": ("/marker",)}, Condition.OTHER_PUBLISHER, "publishes set-points to .*: /marker"),
        (
            {"controllers": {CONTROLLER: Controller("stopped", True)}},
            Condition.UNPREPARED,
            "was stopped by another node",
        ),
        ({"controllers": {}}, Condition.UNPREPARED, "call /arm/recover to start it again"),
        ({"has_subscriber": False}, Condition.NO_SUBSCRIBER, "does not subscribe"),
        ({"mode": RobotMode.IDLE}, Condition.STARTING, "does not follow it yet"),
        ({"control_age": 3.1}, Condition.OUTDATED_CONTROL, "unknown for 3.1 s"),
        ({"control_age": 3.1, "controllers": None}, Condition.NO_CONTROLLER_MANAGER, "no response"),
        ({"tick_age": 0.6}, Condition.NO_SET_POINTS, "no set-point was sent for 0.6 s"),
    ],
)
def test_condition_and_explanation_of_each_problem(fields, condition, words):
    robot = Robot()
    assert robot.reports(**fields) is condition
    assert not robot.readiness.is_ready
    assert re.search(words, robot.explanation)


def test_inactive_controllers_are_ignored():
    idle = {**RUNNING, "joint_state_controller": Controller("running", False), "pose": Controller("stopped", True)}
    assert Robot().reports(controllers=idle) is Condition.READY


@pytest.mark.parametrize("mode", [RobotMode.USER_STOPPED, RobotMode.GUIDING])
def test_robot_is_held_after_user_stop_or_guiding_until_release(mode):
    robot = Robot()
    robot.reports(mode=mode)
    assert robot.reports(mode=RobotMode.IDLE, after=60.0) is Condition.RECOVERY_REQUIRED
    assert robot.reports() is Condition.RECOVERY_REQUIRED
    assert not robot.readiness.needs_recovery
    assert "call /arm/recover" in robot.explanation
    robot.readiness.release()
    assert robot.reports() is Condition.READY


def test_release_during_user_stop_has_no_effect():
    robot = Robot()
    robot.reports(mode=RobotMode.USER_STOPPED)
    robot.readiness.release()
    assert robot.reports(mode=RobotMode.USER_STOPPED) is Condition.USER_STOPPED
    assert robot.reports(mode=RobotMode.IDLE) is Condition.RECOVERY_REQUIRED


def test_user_stop_during_reflex_prevents_recovery():
    robot = Robot()
    robot.reports(REFLEX)
    robot.reports(mode=RobotMode.USER_STOPPED)
    assert robot.reports(REFLEX, after=60.0) is Condition.RECOVERY_REQUIRED
    assert not robot.readiness.needs_recovery


def test_recovery_pauses_double_until_robot_is_held():
    robot = Robot(recoveries=2)
    for pause in (1.0, 2.0):
        assert robot.reports(REFLEX) is Condition.REFLEX
        assert not robot.readiness.needs_recovery
        robot.reports(REFLEX, after=pause - 0.01)
        assert not robot.readiness.needs_recovery
        robot.reports(REFLEX, after=0.02)
        assert robot.readiness.needs_recovery
        robot.recovers()
        assert robot.reports() is Condition.READY
    assert robot.reports(REFLEX, after=1.0) is Condition.RECOVERY_REQUIRED
    assert "after 2 consecutive recoveries" in robot.explanation
    assert not robot.readiness.needs_recovery
    assert robot.reports() is Condition.RECOVERY_REQUIRED, "only a person can release it"
    robot.readiness.release()
    assert robot.reports() is Condition.READY
    assert robot.readiness.recoveries == 2
    assert robot.readiness.consecutive_recoveries == 0


def test_reflex_persisting_after_recovery_counts_again():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers()
    assert robot.reports(REFLEX, after=GRACE + 0.1) is Condition.REFLEX
    assert robot.readiness.consecutive_recoveries == 1


def test_first_reflex_holds_robot_without_recoveries():
    assert Robot(recoveries=0).reports(REFLEX) is Condition.RECOVERY_REQUIRED


def test_failed_recovery_counts_and_is_explained():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers("command rejected")
    assert robot.reports(REFLEX) is Condition.REFLEX
    assert "last recovery: command rejected" in robot.explanation
    robot.recovers("command rejected")
    assert robot.reports(REFLEX) is Condition.RECOVERY_REQUIRED
    assert "last recovery: command rejected" in robot.explanation


def test_ready_time_resets_consecutive_recoveries():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers()
    robot.reports()
    robot.reports(after=RESET_AFTER - 0.1)
    assert robot.readiness.consecutive_recoveries == 1
    robot.reports(after=0.2)
    assert robot.readiness.consecutive_recoveries == 0


def test_stale_state_restarts_ready_time():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers()
    robot.reports()
    robot.reports(age=1.0, after=RESET_AFTER / 2.0)
    robot.reports(after=RESET_AFTER / 2.0)
    robot.reports(after=RESET_AFTER / 2.0)
    assert robot.readiness.consecutive_recoveries == 1


def test_ended_control_loop_is_treated_as_reflex():
    robot = Robot()
    fields = {"mode": RobotMode.IDLE, "last_errors": ("communication_constraints_violation",)}
    assert robot.reports(**fields) is Condition.STARTING
    assert robot.reports(**fields, after=GRACE + 0.1) is Condition.REFLEX
    assert "communication_constraints_violation" in robot.explanation


def test_reflex_before_first_ready_holds_robot():
    robot = Robot(ready=False)
    assert robot.reports(REFLEX) is Condition.RECOVERY_REQUIRED
    assert "in a reflex (cartesian_reflex) before this node moved it" in robot.explanation


@pytest.mark.parametrize(
    "others", [{"controllers": {"pose": Controller("running", True)}}, {"publishers": ("/marker",)}]
)
def test_reflex_while_others_moved_holds_robot(others):
    """A recovery would restart the motion of the others."""
    robot = Robot()
    assert robot.reports(REFLEX, **others) is Condition.RECOVERY_REQUIRED
    assert robot.reports(REFLEX, after=60.0, **others) is Condition.RECOVERY_REQUIRED
    assert "moved it" in robot.explanation


def test_no_preparation_while_another_controller_is_active():
    robot = Robot(ready=False)
    assert robot.reports(controllers={"pose": Controller("running", True)}) is Condition.OTHER_CONTROLLER
    assert not robot.readiness.needs_preparation
    assert robot.reports(controllers={}, mode=RobotMode.IDLE) is Condition.UNPREPARED
    assert robot.readiness.needs_preparation


def test_failed_preparation_is_retried_after_release():
    robot = Robot(ready=False)
    robot.reports(controllers={}, mode=RobotMode.IDLE)
    robot.readiness.set_unprepared("set_load rejected")
    assert robot.explanation == "set_load rejected"
    assert not robot.readiness.needs_preparation
    robot.readiness.release()
    assert robot.readiness.needs_preparation


def test_failed_preparation_may_be_retried_automatically():
    robot = Robot(ready=False)
    robot.reports(controllers={}, mode=RobotMode.IDLE)
    robot.readiness.set_unprepared("no response", retry=True)
    assert robot.explanation == "no response"
    assert robot.readiness.needs_preparation


def test_user_stop_holds_robot_but_requested_recovery_does_not():
    robot = Robot(recoveries=1)
    robot.reports(REFLEX)
    robot.recovers()
    assert robot.reports(REFLEX, after=GRACE + 0.1) is Condition.RECOVERY_REQUIRED
    robot.readiness.forget_reflexes()
    assert robot.reports() is Condition.READY
    robot.reports(mode=RobotMode.USER_STOPPED)
    robot.readiness.forget_reflexes()
    assert robot.reports() is Condition.RECOVERY_REQUIRED


def test_restarted_controller_has_full_grace_period():
    robot = Robot()
    stopped = {CONTROLLER: Controller("stopped", True)}
    assert robot.reports(mode=RobotMode.IDLE) is Condition.STARTING
    assert robot.reports(mode=RobotMode.IDLE, controllers=stopped, after=0.9 * GRACE) is Condition.UNPREPARED
    robot.readiness.set_prepared()
    assert robot.reports(mode=RobotMode.IDLE, after=0.2 * GRACE) is Condition.STARTING
    assert robot.reports() is Condition.READY
