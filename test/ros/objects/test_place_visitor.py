"""Visits of decided places with an arm that fails on demand; no ROS master."""

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import (
    ArmFailedError,
    ArmStoppedError,
    CommandError,
    ObservationError,
    TaskCancelledError,
)
from embodied_active_learning.objects.visits import Destination
from embodied_active_learning.ros.conversions import image_message, state_message
from embodied_active_learning.ros.objects import place_visitor
from embodied_active_learning.ros.objects.place_visitor import PlaceVisitor
from embodied_active_learning.ros.runtime.exclusive_task import ExclusiveTask
from embodied_active_learning.ros.runtime.task_server import TaskProgress

CONFIG = Config.from_dict({"camera": {"width": 9, "height": 8}})
PLACES = [
    Destination(
        f"unknown-{index}", np.array([0.4, 0.0]), np.array([0.4, 0.01 * index, 0.0]), np.zeros((4, 4, 3), "u1"), None
    )
    for index in (1, 2, 3)
]


class Arm:
    """Goes where it is told, unless the next of `failures` is an error."""

    def __init__(self):
        self.failures = []

    def go_to(self, pose):
        error = self.failures.pop(0) if self.failures else None
        if error is not None:
            raise error
        return state_message(rospy.Time(1), pose, (0.0, 0.0, 0.0))

    def observe(self, reached):
        return image_message(rospy.Time(1), np.full((8, 9, 3), 7, np.uint8)), reached


@pytest.fixture
def arm(monkeypatch):
    arm = Arm()

    @contextmanager
    def lent(progress):
        progress.check()
        yield arm

    arm.lent = lent
    monkeypatch.setattr(place_visitor, "TaskArm", lambda config: arm)
    return arm


@pytest.fixture
def pictures(monkeypatch):
    pictures = []
    publisher = SimpleNamespace(publish=pictures.append)
    monkeypatch.setattr(place_visitor.rospy, "Publisher", lambda *arguments, **options: publisher)
    return pictures


@pytest.fixture
def log(monkeypatch):
    lines = []
    for level in ("loginfo", "logwarn", "logerr"):
        monkeypatch.setattr(place_visitor.rospy, level, lambda text, *values: lines.append(text % values))
    return lines


def visit(is_cancelled=lambda: False):
    visits = PlaceVisitor(CONFIG).visit(PLACES, TaskProgress(ExclusiveTask("a visit"), is_cancelled))
    return [item.destination.label for item in visits]


def test_every_place_is_visited_and_published(arm, pictures, log):
    assert visit() == ["unknown-1", "unknown-2", "unknown-3"]
    assert len(pictures) == 3
    assert pictures[0].height == 8
    assert log[0].startswith("visited unknown-1 at x 0.400 m, y 0.000 m; camera at x 0.400 m, y 0.010 m")


@pytest.mark.parametrize("error", [ArmFailedError("reflex"), CommandError("rejected"), ObservationError("no image")])
def test_place_that_is_not_reached_is_skipped(arm, pictures, log, error):
    arm.failures = [None, error]
    assert visit() == ["unknown-1", "unknown-3"]
    assert f"unknown-2 not visited: {error}" in log


def test_stopped_arm_ends_the_visits(arm, pictures, log):
    arm.failures = [None, ArmStoppedError("stopped by /operator")]
    assert visit() == ["unknown-1"]
    assert log[-1] == "visits ended: stopped by /operator; not visited: unknown-2, unknown-3"


def test_cancelled_task_is_not_mistaken_for_a_failure(arm, pictures, log):
    arm.failures = [None, ArmFailedError("stopped during the command")]
    with pytest.raises(TaskCancelledError):
        visit(is_cancelled=lambda: len(arm.failures) == 0)
    assert len(pictures) == 1
