"""What the robot is in by its reports, what is said about it, and who has to do something."""

import re

import pytest

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.franka.readiness import (
    CONTROLLER,
    GOOD_STRETCH,
    GRACE,
    Condition,
    Controller,
    Readiness,
    Report,
    RobotMode,
)

RUNNING = {CONTROLLER: Controller("running", True), "franka_state_controller": Controller("running", False)}
GOOD = Report(age=0.01, mode=RobotMode.MOVE, controllers=RUNNING)
REFLEX = GOOD._replace(mode=RobotMode.REFLEX, errors=("cartesian_reflex",))


class Robot:
    """A robot whose reports a test makes up, and the clock of who follows them."""

    def __init__(self, recoveries=2, ready=True):
        self.now = 100.0
        self.readiness = Readiness(FrankaConfig(recoveries=recoveries), lambda: self.now)
        if ready:
            self.readiness.prepared()
            assert self.reports(GOOD) is Condition.READY

    def reports(self, report=GOOD, after=0.0, **fields):
        self.now += after
        return self.readiness.update(report._replace(**fields))

    def recovers(self, refusal=""):
        self.readiness.begin_recovery()
        assert self.reports(REFLEX) is Condition.RECOVERING
        self.readiness.end_recovery(refusal)
        assert refusal or self.reports(REFLEX) is Condition.STARTING, "a state of before is no new reflex"

    @property
    def sentence(self):
        return self.readiness.why_not_ready


def test_a_robot_in_motion_with_our_controller_alone_is_ready():
    robot = Robot()
    assert robot.readiness.is_ready
    assert robot.sentence == ""


@pytest.mark.parametrize(
    ("fields", "condition", "sentence"),
    [
        ({"age": None}, Condition.AWAITED, "no state of the robot has come yet"),
        ({"age": 0.21}, Condition.SILENT, "no new state of the robot has come for 0.21 s"),
        ({"delay": 0.5}, Condition.SILENT, "0.50 s off this computer's clock"),
        ({"delay": -0.5}, Condition.SILENT, "set the clocks"),
        ({"trouble": "it is NaN"}, Condition.UNUSABLE, "cannot be used: it is NaN"),
        ({"mode": RobotMode.USER_STOPPED}, Condition.USER_STOPPED, "release it, then call /arm/recover"),
        ({"mode": RobotMode.GUIDING}, Condition.GUIDED, "let go of it"),
        ({"mode": RobotMode.AUTOMATIC_ERROR_RECOVERY}, Condition.RECOVERING, "recovering"),
        ({"mode": RobotMode.REFLEX, "errors": ("joint_reflex",)}, Condition.REFLEX, "in a reflex .joint_reflex."),
        ({"errors": ("power_limit_violation",)}, Condition.REFLEX, "power_limit_violation"),
        ({"controllers": None}, Condition.NO_CONTROLLER_MANAGER, "controller_manager has not answered"),
        ({"controllers": {**RUNNING, "pose": Controller("running", True)}}, Condition.OTHER_CONTROLLER, "pose moves"),
        ({"rivals": ("/marker",)}, Condition.RIVAL, "/marker sends set-points"),
        ({"controllers": {CONTROLLER: Controller("stopped", True)}}, Condition.STOPPED, "was stopped, not by this"),
        ({"controllers": {}}, Condition.STOPPED, "call /arm/recover to start it again"),
        ({"heard": False}, Condition.UNHEARD, "does not listen"),
        ({"mode": RobotMode.IDLE}, Condition.STARTING, "does not follow it yet"),
    ],
)
def test_whatever_is_wrong_the_robot_is_not_moved_and_it_is_said_why(fields, condition, sentence):
    robot = Robot()
    assert robot.reports(**fields) is condition
    assert not robot.readiness.is_ready
    assert re.search(sentence, robot.sentence)


def test_a_controller_that_moves_nothing_is_no_rival():
    idle = {**RUNNING, "joint_state_controller": Controller("running", False), "pose": Controller("stopped", True)}
    assert Robot().reports(controllers=idle) is Condition.READY


@pytest.mark.parametrize("mode", [RobotMode.USER_STOPPED, RobotMode.GUIDING])
def test_what_a_person_did_to_the_robot_a_person_has_to_undo(mode):
    robot = Robot()
    robot.reports(mode=mode)
    assert robot.reports(mode=RobotMode.IDLE, after=60.0) is Condition.HELD
    assert robot.reports() is Condition.HELD
    assert not robot.readiness.needs_recovery
    assert "call /arm/recover" in robot.sentence
    robot.readiness.release()
    assert robot.reports() is Condition.READY


def test_a_release_while_the_user_stop_is_pressed_releases_nothing():
    robot = Robot()
    robot.reports(mode=RobotMode.USER_STOPPED)
    robot.readiness.release()
    assert robot.reports(mode=RobotMode.USER_STOPPED) is Condition.USER_STOPPED
    assert robot.reports(mode=RobotMode.IDLE) is Condition.HELD


def test_a_user_stop_during_a_reflex_is_not_recovered_from():
    robot = Robot()
    robot.reports(REFLEX)
    robot.reports(mode=RobotMode.USER_STOPPED)
    assert robot.reports(REFLEX, after=60.0) is Condition.HELD
    assert not robot.readiness.needs_recovery


def test_recoveries_come_by_themselves_with_growing_pauses_until_a_person_is_needed():
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
    assert robot.reports(REFLEX, after=1.0) is Condition.HELD
    assert "again after 2 recoveries in a row" in robot.sentence
    assert not robot.readiness.needs_recovery
    assert robot.reports() is Condition.HELD, "only a person lets it go on"
    robot.readiness.release()
    assert robot.reports() is Condition.READY
    assert robot.readiness.recoveries == 2
    assert robot.readiness.recoveries_in_a_row == 0


def test_a_reflex_that_a_recovery_does_not_end_is_the_next_one():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers()
    assert robot.reports(REFLEX, after=GRACE + 0.1) is Condition.REFLEX
    assert robot.readiness.recoveries_in_a_row == 1


def test_without_recoveries_the_first_reflex_needs_a_person():
    assert Robot(recoveries=0).reports(REFLEX) is Condition.HELD


def test_a_recovery_that_the_robot_refuses_counts_and_is_told():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers("command rejected")
    assert robot.reports(REFLEX) is Condition.REFLEX
    assert "last time: command rejected" in robot.sentence
    robot.recovers("command rejected")
    assert robot.reports(REFLEX) is Condition.HELD
    assert "last time: command rejected" in robot.sentence


def test_after_a_good_stretch_reflexes_of_before_count_no_more():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers()
    robot.reports()
    robot.reports(after=GOOD_STRETCH - 0.1)
    assert robot.readiness.recoveries_in_a_row == 1
    robot.reports(after=0.2)
    assert robot.readiness.recoveries_in_a_row == 0


def test_a_stretch_with_a_silence_in_it_is_no_good_one():
    robot = Robot(recoveries=2)
    robot.reports(REFLEX)
    robot.recovers()
    robot.reports()
    robot.reports(age=1.0, after=GOOD_STRETCH / 2.0)
    robot.reports(after=GOOD_STRETCH / 2.0)
    robot.reports(after=GOOD_STRETCH / 2.0)
    assert robot.readiness.recoveries_in_a_row == 1


def test_a_control_loop_that_has_ended_without_a_reflex_is_recovered_like_one():
    robot = Robot()
    fields = {"mode": RobotMode.IDLE, "last_errors": ("communication_constraints_violation",)}
    assert robot.reports(**fields) is Condition.STARTING
    assert robot.reports(**fields, after=GRACE + 0.1) is Condition.REFLEX
    assert "communication_constraints_violation" in robot.sentence


def test_a_reflex_from_before_the_robot_was_ever_ready_needs_a_person():
    robot = Robot(ready=False)
    assert robot.reports(REFLEX) is Condition.HELD
    assert "in a reflex (cartesian_reflex) before it was moved" in robot.sentence


def test_nothing_is_set_on_the_robot_while_another_controller_moves_it():
    robot = Robot(ready=False)
    assert robot.reports(controllers={"pose": Controller("running", True)}) is Condition.OTHER_CONTROLLER
    assert not robot.readiness.needs_preparation
    assert robot.reports(controllers={}, mode=RobotMode.IDLE) is Condition.UNPREPARED
    assert robot.readiness.needs_preparation


def test_a_preparation_that_was_refused_is_tried_again_when_a_person_asks():
    robot = Robot(ready=False)
    robot.reports(controllers={}, mode=RobotMode.IDLE)
    robot.readiness.not_prepared("set_load was refused")
    assert robot.sentence == "set_load was refused"
    assert not robot.readiness.needs_preparation
    robot.readiness.release()
    assert robot.readiness.needs_preparation
