"""What is sent to an arm with velocity service, by an interface that records it; no ROS master."""

import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ServiceError
from embodied_active_learning.franka.mount import CameraPose
from embodied_active_learning.franka.set_points import Tracking
from embodied_active_learning.franka.velocity_readiness import STOPPED_ERROR
from embodied_active_learning.franka.velocity_tracking import REST, velocity_driver
from embodied_active_learning.ros.arm.velocity_sender import VelocitySender

CONFIG = Config.from_dict({"arm": {"robot": "velocity_service"}})
HERE = CameraPose((0.4, 0.0, 0.0), 0.0, (0.0, 0.0))


class Interface:
    """Records the velocities; without response if it is silent."""

    def __init__(self):
        self.sent = []
        self.is_silent = False
        self.follows = True

    def send(self, twist):
        if self.is_silent:
            raise ServiceError("no response from /klerg_cmd")
        self.sent.append(twist)
        return self.follows


@pytest.fixture
def log(monkeypatch):
    lines = []
    monkeypatch.setattr(rospy, "logerr", lambda text, *values: lines.append(text % values))
    return lines


@pytest.fixture
def driver():
    """A driver that has a set-point to follow until `tick` is replaced."""
    driver = velocity_driver(CONFIG, lambda: 0.0)
    driver.tick = lambda: HERE
    driver.tracking = lambda: Tracking(HERE, (0.01, 0.0, 0.0), HERE)
    return driver


@pytest.fixture
def interface():
    return Interface()


@pytest.fixture
def sender(interface, driver, log):
    return VelocitySender(interface, driver, CONFIG, lambda: 0.0)


def errors(driver):
    with driver.readiness() as readiness:
        return readiness.report.errors


def test_zero_velocity_is_sent_once_when_robot_is_not_ready(sender, driver, interface):
    sender.send()
    driver.tick = lambda: None
    sender.send()
    sender.send()
    assert [twist == REST for twist in interface.sent] == [False, True]


def test_lost_service_requires_start_of_controller(sender, driver, interface, log):
    interface.is_silent = True
    sender.send()
    sender.send()
    assert log == ["no response from /klerg_cmd"]
    with driver.readiness() as readiness:
        assert readiness.preparation_error == "no response from /klerg_cmd"
    driver.tick = lambda: None
    interface.is_silent = False
    sender.send()
    assert interface.sent == []


def test_robot_that_does_not_follow_has_an_error(sender, driver, interface):
    sender.send()
    assert errors(driver) == ()
    interface.follows = False
    sender.send()
    assert errors(driver) == (STOPPED_ERROR,)


def test_robot_at_rest_need_not_follow(sender, driver, interface):
    sender.send()
    driver.tick, interface.follows = lambda: None, False
    sender.send()
    assert (interface.sent[-1], errors(driver)) == (REST, ())


def test_zero_velocity_is_sent_on_request(sender, interface):
    sender.send_rest()
    assert interface.sent == [REST]


def test_rest_that_silent_service_prevents_is_logged(sender, interface, log):
    interface.is_silent = True
    sender.send_rest()
    assert log == ["the arm was not stopped: no response from /klerg_cmd"]
