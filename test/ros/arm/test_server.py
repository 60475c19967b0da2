"""The services that every arm node offers, with an arm that records its calls; no ROS master."""

from types import SimpleNamespace

import pytest
import rospy
from embodied_active_learning.msg import ArmCause, PlanarState

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmBusyError, ArmFailedError, ArmStoppedError, NoResponseError
from embodied_active_learning.ros.arm import arbiter, server
from embodied_active_learning.ros.arm.server import ArmServer, MoveOutcome
from embodied_active_learning.ros.runtime.diagnostics import WARN, Health

STATE = PlanarState(x=0.5)


def request(caller="/planner", **fields):
    return SimpleNamespace(_connection_header={"callerid": caller}, **fields)


MOVE = request(vx=0.1, vy=0.2, omega=0.3, duration=0.4)


class RecordingArm(ArmServer):
    def __init__(self):
        super().__init__(Config())
        self.calls = []
        self.error = None

    def move(self, velocity, duration, stop):
        self._record("move", velocity, duration, stop.is_set())
        return MoveOutcome(STATE, True)

    def go_to(self, pose, stop):
        self._record("go_to", pose, stop.is_set())
        return STATE

    def stop(self):
        self._record("stop")

    def recover(self):
        self._record("recover")

    def arm_health(self):
        return Health(message="ready")

    def _record(self, *call):
        self.calls.append(call)
        if self.error is not None:
            raise self.error


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now=0.0)
    make = arbiter.ArmArbiter
    monkeypatch.setattr(server, "ArmArbiter", lambda timeout, **more: make(timeout, lambda: clock.now, **more))
    return clock


@pytest.fixture
def stored():
    """The nodes whose stop was stored by a direct call."""
    return []


@pytest.fixture
def arm(monkeypatch, clock, stored):
    monkeypatch.setattr(server.persistent_parameters, "load", lambda name: "")
    monkeypatch.setattr(server.persistent_parameters, "store", lambda name, text: lambda: stored.append(text()))
    return RecordingArm()


def test_move_returns_state_and_limit(arm):
    response = arm.handle_move(MOVE)
    assert arm.calls == [("move", (0.1, 0.2, 0.3), 0.4, False)]
    assert (response.success, response.cause, response.limited, response.state) == (True, ArmCause.NONE, True, STATE)
    assert response.message == server.LIMITED
    assert arm.health().values["velocities limited"] == 1


def test_go_to_returns_state(arm):
    response = arm.handle_go_to(request(x=0.1, y=0.2, theta=0.3))
    assert arm.calls == [("go_to", (0.1, 0.2, 0.3), False)]
    assert (response.success, response.message, response.state) == (True, "", STATE)


def test_failed_move_is_raised_and_arm_stays_controlled(arm):
    arm.error = ArmFailedError("in reflex mode")
    with pytest.raises(ArmFailedError, match="reflex"):
        arm.handle_move(MOVE)
    assert arm.arbiter.commander == "/planner"


def test_other_node_is_rejected_before_arm_moves(arm):
    arm.handle_move(MOVE)
    with pytest.raises(ArmBusyError, match="/planner controls the arm"):
        arm.handle_go_to(request("/other", x=0.1, y=0.2, theta=0.3))
    assert len(arm.calls) == 1


def test_stop_by_other_node_lasts_until_recovered(arm):
    assert arm.handle_stop(request("/operator")).message.endswith("until /arm/recover is called")
    assert arm.calls == [("stop",)]
    with pytest.raises(ArmStoppedError, match="stopped by /operator: call /arm/recover to resume"):
        arm.handle_move(MOVE)
    assert arm.health().level == WARN
    assert arm.handle_recover(request("/operator")).success
    assert arm.handle_move(MOVE).success
    assert [call[0] for call in arm.calls] == ["stop", "recover", "move"]


def test_stop_is_stored_before_response(arm, stored):
    arm.handle_stop(request("/operator"))
    assert stored == ["/operator"]


def test_failed_recovery_leaves_arm_stopped(arm):
    arm.handle_stop(request("/operator"))
    arm.error = NoResponseError("no robot")
    with pytest.raises(NoResponseError):
        arm.handle_recover(request("/operator"))
    assert arm.arbiter.stopped_by == "/operator"


def test_arm_brakes_once_when_commander_is_silent(arm, clock):
    arm.handle_move(MOVE)
    clock.now = 4.0
    arm.handle_heartbeat(request())
    clock.now = 8.0
    arm.brake_if_commander_silent()
    assert len(arm.calls) == 1, "the heartbeat has extended the control"
    clock.now = 9.1
    for _ in range(2):
        arm.brake_if_commander_silent()
    assert arm.calls[1:] == [("stop",)]
    assert arm.arbiter.commander == ""


def test_failed_brake_is_logged(arm, clock, monkeypatch):
    lines = []
    monkeypatch.setattr(rospy, "logerr", lambda text, *values: lines.append(text % values))
    arm.handle_move(MOVE)
    clock.now = 5.1
    arm.error = ArmFailedError("it keeps moving")
    arm.brake_if_commander_silent()
    assert lines == ["it keeps moving"]
