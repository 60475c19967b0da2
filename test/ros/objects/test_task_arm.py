"""Lending the arm to a task, without a ROS master."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import CommandError, TaskCancelledError
from embodied_active_learning.ros.objects import task_arm
from embodied_active_learning.ros.objects.task_arm import TaskArm
from embodied_active_learning.ros.runtime.exclusive_task import ExclusiveTask
from embodied_active_learning.ros.runtime.task_server import TaskProgress


class WaitingArm:
    """An arm that never becomes ready."""

    def __init__(self, config, timeout):
        pass

    def wait(self, check):
        while True:
            check()


@pytest.fixture
def arm(monkeypatch):
    monkeypatch.setattr(task_arm, "RetryingArm", WaitingArm)
    monkeypatch.setattr(task_arm, "PlannerPause", SimpleNamespace)
    monkeypatch.setattr(task_arm, "TIMEOUT", 0.0)
    return TaskArm(Config())


@pytest.mark.parametrize(
    ("has_arm", "expected"), [(False, "no arm: .*arm/move"), (True, "arm or camera not ready: .*arm/move .*image_raw")]
)
def test_missing_arm_or_camera_fails_after_a_timeout(arm, monkeypatch, has_arm, expected):
    monkeypatch.setattr(task_arm, "is_advertised", lambda name: has_arm)
    with pytest.raises(CommandError, match=expected), arm.lent(TaskProgress(ExclusiveTask("fingerprinting"))):
        pass


def test_wait_for_the_arm_can_be_cancelled(arm):
    cancelled = iter([False, True])
    progress = TaskProgress(ExclusiveTask("fingerprinting"), lambda: next(cancelled))
    with pytest.raises(TaskCancelledError), arm.lent(progress):
        pass
