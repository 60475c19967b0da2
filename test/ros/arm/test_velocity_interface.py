"""Requests to the velocity service, answered by clients of the test; without a master."""

from types import SimpleNamespace

import pytest
import rospy

from embodied_active_learning.errors import RobotError, ServiceError
from embodied_active_learning.franka.velocity_tracking import REST
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm import velocity_interface
from embodied_active_learning.ros.arm.velocity_interface import VelocityInterface
from embodied_active_learning.ros.runtime import timed_service
from embodied_active_learning.ros.runtime.timed_service import TimedService

TWIST = ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))


class Robot:
    """The services: whether they respond, and whether the robot follows."""

    def __init__(self):
        self.step = 0.2  # s
        self.connections = 0
        self.requests = []
        self.silent = ()  # names of services without response
        self.follows = True

    def connect(self, service):
        self.connections += 1
        service._proxy = _Proxy(lambda request: self.respond(service, request))

    def respond(self, service, request):
        if service._name.strip("/") in self.silent:
            raise rospy.ServiceException("connection lost")
        self.requests.append((service._name, request))
        return SimpleNamespace(success=self.follows)


class _Proxy:
    def __init__(self, respond):
        self._respond = respond
        self.close = lambda: None

    def __call__(self, request):
        return self._respond(request)


@pytest.fixture
def robot(monkeypatch):
    robot = Robot()

    def connect(service):
        robot.connect(service)

    monkeypatch.setattr(timed_service, "WallTimer", lambda period, function: None)
    monkeypatch.setattr(timed_service, "_timers", [])
    monkeypatch.setattr(TimedService, "_connect", connect)
    monkeypatch.setattr(rospy, "wait_for_service", lambda name, timeout: None)
    monkeypatch.setattr(rospy, "Subscriber", lambda *arguments, **options: None)
    master = SimpleNamespace(getParam=lambda caller, name: (1, "", robot.step))
    monkeypatch.setattr(velocity_interface, "master_proxy", lambda: master)
    monkeypatch.setattr(velocity_interface, "_START_TIMEOUT", 0.0)
    return robot


def test_velocity_is_sent_without_brightness(robot):
    assert VelocityInterface(None).send(TWIST)
    (name, request), velocity = robot.requests[0], robot.requests[0][1].desired_vel
    assert name == rospy.resolve_name(names.VELOCITY_COMMAND)
    assert (velocity.linear.x, velocity.linear.y, velocity.linear.z) == TWIST[0]
    assert (velocity.angular.x, velocity.angular.y, velocity.angular.z) == TWIST[1]
    assert request.desired_brightness == -1.0


def test_robot_that_does_not_follow_is_returned(robot):
    robot.follows = False
    assert not VelocityInterface(None).send(TWIST)


def test_robot_is_assumed_to_follow_just_after_a_start(robot, monkeypatch):
    interface = VelocityInterface(None)
    interface.start(100.0)
    robot.follows = False
    assert interface.send(TWIST)
    monkeypatch.setattr(velocity_interface, "GRACE", -1.0)
    assert not interface.send(TWIST)


def test_velocities_share_one_connection_until_it_is_lost(robot):
    interface = VelocityInterface(None)
    interface.send(TWIST)
    interface.send(TWIST)
    assert robot.connections == 1
    robot.silent = (names.VELOCITY_COMMAND,)
    with pytest.raises(ServiceError, match="no response from /klerg_cmd: connection lost; is the robot's node running"):
        interface.send(TWIST)
    robot.silent = ()
    assert interface.send(TWIST)
    assert robot.connections == 2


def test_start_sends_zero_velocity(robot):
    VelocityInterface(None).start(100.0)
    (start, _), (command, request) = robot.requests
    assert (start, command) == ("/klerg_start_pose", "/klerg_cmd")
    assert request.desired_vel == velocity_interface._request(REST).desired_vel


@pytest.mark.parametrize("service", [names.VELOCITY_START, names.VELOCITY_COMMAND])
def test_start_fails_if_a_service_does_not_respond(robot, service):
    robot.silent = (service,)
    with pytest.raises(ServiceError, match=f"no response from /{service}"):
        VelocityInterface(None).start(100.0)


def test_start_of_robot_that_does_not_follow_fails(robot):
    robot.follows = False
    with pytest.raises(RobotError, match="release the user stop or clear its reflex"):
        VelocityInterface(None).start(100.0)


@pytest.mark.parametrize(("step", "timeout"), [(0.2, 0.4), (0.05, 0.3)])
def test_timeout_is_two_steps_of_the_controller(robot, step, timeout):
    robot.step, interface = step, VelocityInterface(None)
    interface.start(100.0)
    assert interface._command.timeout == pytest.approx(timeout)
