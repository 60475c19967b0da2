"""What velocity_service_arm sends, to an interface that records it; no ROS master."""

import runpy
from types import SimpleNamespace

import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ServiceError
from embodied_active_learning.franka.velocity_tracking import REST, velocity_driver
from embodied_active_learning.ros.runtime.log_throttle import LogThrottle
from launching import ROOT

CONFIG = Config.from_dict({"arm": {"robot": "velocity_service"}})


class Interface:
    """Records the velocities; without response if it is silent."""

    def __init__(self):
        self.sent = []
        self.is_silent = False

    def send(self, twist):
        if self.is_silent:
            raise ServiceError("no response from /klerg_cmd")
        self.sent.append(twist)
        return True


@pytest.fixture(scope="module")
def node():
    """The node's class."""
    return runpy.run_path(str(ROOT / "nodes" / "velocity_service_arm"))["VelocityServiceArm"]


@pytest.fixture
def arm(node, monkeypatch):
    """An arm that was not connected to ROS."""
    monkeypatch.setattr(rospy, "logerr", lambda *arguments: None)
    arm = node.__new__(node)
    arm._interface, arm._throttle, arm._sent_at = Interface(), LogThrottle(), 0.0
    arm._tracker = SimpleNamespace(reset=lambda: None, twist=lambda tracking, period: "a velocity")
    arm._supervisor = SimpleNamespace(started_at=0.0)
    arm._is_moving = False
    arm._driver = velocity_driver(CONFIG, lambda: 0.0)
    arm._driver.tick, arm._driver.tracking = lambda: "a set-point", lambda: "a pose"
    return arm


def test_zero_velocity_is_sent_once_when_robot_is_not_ready(arm):
    arm.send()
    arm._driver.tick = lambda: None
    arm.send()
    arm.send()
    assert arm._interface.sent == ["a velocity", REST]


def test_lost_service_requires_start_of_controller(arm):
    arm._interface.is_silent = True
    arm.send()
    with arm._driver.readiness() as readiness:
        assert readiness.preparation_error == "no response from /klerg_cmd"
    arm._driver.tick = lambda: None
    arm._interface.is_silent = False
    arm.send()
    assert arm._interface.sent == []


def test_zero_velocity_is_sent_after_failed_loop(arm):
    arm.send_last()
    assert arm._interface.sent == [REST]


def test_shutdown_with_silent_service_is_logged(arm, monkeypatch):
    lines = []
    monkeypatch.setattr(rospy, "logerr", lambda text, *values: lines.append(text % values))
    arm._interface.is_silent = True
    arm.send_last()
    assert lines == ["the arm was not stopped: no response from /klerg_cmd"]
