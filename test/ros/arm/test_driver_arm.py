"""What the nodes of real arms share, with a driver and a loop that record their calls; no ROS master."""

from contextlib import contextmanager
from types import SimpleNamespace

import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmFailedError, CommandError, ConfigError, RobotError
from embodied_active_learning.franka.report import RobotMode
from embodied_active_learning.franka.set_point_driver import Reached, SetPointDriver
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm import driver_arm, server
from embodied_active_learning.ros.arm.driver_arm import DriverArm
from embodied_active_learning.ros.runtime.diagnostics import ERROR, OK

CONFIG = Config.from_dict({"arm": {"robot": "franka"}})
REACHED = Reached(12.5, (0.5, 0.1, 0.2), (0.01, 0.02, 0.03), True)


class Driver:
    """Records its calls; a test may set an error that they raise."""

    def __init__(self):
        self.calls = []
        self.why = ""
        self.error = None

    @contextmanager
    def readiness(self):
        yield SimpleNamespace(hold=lambda reason: None)

    def move(self, *arguments):
        return self._call("move", *arguments)

    def go_to(self, *arguments):
        return self._call("go_to", *arguments)

    def stop(self):
        return self._call("stop")

    def update_state(self, *arguments):
        self._call("update_state", *arguments)
        return None if self.why else REACHED

    def why_not_ready(self):
        return self.why

    def values(self):
        return {"robot": "a recording"}

    def _call(self, *call):
        self.calls.append(call)
        if self.error is not None:
            raise self.error
        return REACHED


class Arm(DriverArm):
    ROBOT = "franka"
    sent_last = False

    def send(self):
        pass

    def send_last(self):
        self.sent_last = True


@pytest.fixture
def check(monkeypatch):
    """The config check of the arms that are built."""
    check = SimpleNamespace(mismatch="", error=None)

    def require():
        if check.mismatch:
            raise CommandError(check.mismatch)

    check.require = require
    monkeypatch.setattr(driver_arm, "ConfigCheck", lambda config: check)
    return check


@pytest.fixture
def make(monkeypatch, check):
    """Builds and starts an arm."""
    monkeypatch.setattr(server.persistent_parameters, "load", lambda name: "")
    monkeypatch.setattr(server.persistent_parameters, "store", lambda name, text: lambda: None)
    loop = SimpleNamespace(failure=None, end=lambda: None, lateness=lambda fraction: 0.0)
    monkeypatch.setattr(driver_arm, "RateLoop", lambda rate, function: loop)
    monkeypatch.setattr(driver_arm.sys, "setswitchinterval", lambda seconds: None)
    published = []
    publisher = SimpleNamespace(publish=published.append)
    monkeypatch.setattr(rospy, "Publisher", lambda *arguments, **options: publisher)
    monkeypatch.setattr(rospy, "on_shutdown", lambda function: None)
    monkeypatch.setattr(rospy, "spin", lambda: None)
    monkeypatch.setattr(Arm, "advertise_services", lambda arm: None)

    def build(recover=lambda: None):
        arm = Arm(CONFIG, Driver())
        arm.start(recover)
        arm.loop, arm.driver, arm.published = loop, arm._driver, published
        return arm

    return build


@pytest.mark.parametrize("robot", ["pybullet", "velocity_service", "recording"])
def test_configuration_for_another_robot_is_rejected(check, robot):
    config = Config.from_dict({"arm": {"robot": robot}})
    with pytest.raises(ConfigError, match=f"arm/robot is {robot}, but .* franka: start it with robot:=franka"):
        Arm(config, Driver())


def test_move_returns_state_of_driver(make):
    arm = make()
    state, limited = arm.move((0.1, 0.2, 0.3), 0.4, "stop")
    assert arm.driver.calls == [("move", (0.1, 0.2, 0.3), 0.4, "stop")]
    assert (state.header.stamp.to_sec(), state.x, state.y, state.theta, limited) == (12.5, 0.5, 0.1, 0.2, True)


def test_mismatching_configuration_rejects_motions_but_not_stop(make, check):
    arm = make()
    check.mismatch = "configuration mismatch: arm/max_speed"
    with pytest.raises(CommandError, match="max_speed"):
        arm.move((0.1, 0.0, 0.0), 0.2, "stop")
    with pytest.raises(CommandError, match="max_speed"):
        arm.go_to((0.5, 0.0, 0.0), "stop")
    assert arm.driver.calls == []
    assert arm.arm_health().level == ERROR
    arm.stop()
    assert arm.driver.calls == [("stop",)]


def test_health_reports_why_commands_are_rejected(make):
    arm = make()
    assert (arm.arm_health().level, arm.arm_health().message) == (OK, "ready")
    arm.driver.why = "reflex"
    assert (arm.arm_health().level, arm.arm_health().message) == (ERROR, "rejecting commands: reflex")


def test_usable_states_are_published(make, monkeypatch):
    arm, stamp = make(), rospy.Time(12, 0)
    monkeypatch.setattr(rospy.Time, "now", lambda: stamp)
    assert arm.update_state(stamp, (0.0,) * 16, 2, ())
    arm.driver.why = "unusable"
    assert not arm.update_state(stamp, (0.0,) * 16, 2, ())
    assert [state.x for state in arm.published] == [0.5]


def test_recover_calls_supervisor(make):
    def fail():
        raise RobotError("no robot")

    with pytest.raises(RobotError, match="no robot"):
        make(fail).recover()


def test_shutdown_brakes_arm_and_ignores_silent_robot(make):
    arm = make()
    arm.driver.error = ArmFailedError("it is unknown whether the arm is at rest")
    arm.close()
    assert arm.driver.calls == [("stop",)]
    assert not arm.sent_last


def test_shutdown_after_failed_loop_leaves_robot_at_rest(make):
    arm = make()
    arm.loop.failure = ValueError("no set-point")
    arm.close()
    assert arm.sent_last
    assert arm.driver.calls == [], "without ticks the driver cannot brake"
    with pytest.raises(ValueError, match="no set-point"):
        arm.spin()


def test_rejection_names_recovery_service_in_namespace(make, monkeypatch):
    monkeypatch.setattr(rospy, "resolve_name", lambda name: f"/lab/{name}")
    driver = SetPointDriver(CONFIG)
    Arm(CONFIG, driver)
    driver.update_state(1.0, 0.0, (0.0,) * 16, RobotMode.USER_STOPPED, (), ())
    assert driver.why_not_ready() == "the user stop is pressed: release it, then call /lab/arm/recover"


def test_hold_survives_restart_of_node(make, monkeypatch):
    """After a user stop, a person is needed also if the node is restarted meanwhile."""
    stored = {}
    monkeypatch.setattr(server.persistent_parameters, "load", lambda name: stored[name]() if name in stored else "")
    monkeypatch.setattr(server.persistent_parameters, "store", stored.__setitem__)
    driver = SetPointDriver(CONFIG)
    Arm(CONFIG, driver)
    assert stored[names.HELD_FOR]() == ""
    driver.update_state(1.0, 0.0, (0.0,) * 16, RobotMode.USER_STOPPED, (), ())
    restarted = SetPointDriver(CONFIG)
    Arm(CONFIG, restarted)
    with restarted.readiness() as readiness:
        assert readiness.held_for == "the user stop was pressed and has been released"
        readiness.release()
    assert stored[names.HELD_FOR]() == ""
