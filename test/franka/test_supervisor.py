"""The supervisor prepares and recovers the robot: requests to franka_ros, recorded by an interface without ROS."""

import http.client
import threading
from types import SimpleNamespace
from xml.parsers.expat import ExpatError

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmNotReadyError, RobotError
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.report import CONTROLLER, Condition, Controller, RobotMode
from embodied_active_learning.franka.set_point_driver import SetPointDriver
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm import requested_recovery
from fake_franka.generate import use_messages

CONFIG = Config.from_dict({"arm": {"robot": "franka"}})
ERROR = ("communication_constraints_violation",)


class Interface:
    """A robot that starts and stops our controller; `recovers` lists whether each recovery clears the errors."""

    has_subscriber = True

    def __init__(self):
        self.calls = []
        self.running = {}
        self.errors = ()
        self.recovers = []
        self.rejected = ""
        self.has_manager = True
        self.is_user_stopped = False
        self.speed = 0.0  # m/s along x
        self.before_call = lambda: None

    def controllers(self):
        if not self.has_manager:
            raise RobotError("no response from controller_manager")
        return dict(self.running)

    def other_publishers(self):
        return []

    def load(self):
        self._call("load")
        self.running[CONTROLLER] = Controller("initialized", True)

    def start(self):
        self._call("start")
        self.running[CONTROLLER] = Controller("running", True)

    def stop(self):
        self._call("stop")
        self.running[CONTROLLER] = Controller("stopped", True)

    def set_collision_behaviour(self, config):
        self._call("set_collision_behaviour")

    def set_load(self, config):
        self._call("set_load")

    def set_stiffness(self, config):
        self._call("set_stiffness")

    def recover(self):
        self._call("recover")
        if self.recovers.pop(0):
            self.errors = ()

    def _call(self, name):
        self.calls.append(name)
        self.before_call()
        if not self.has_manager or name == self.rejected:
            raise RobotError(f"{name} rejected")

    @property
    def mode(self):
        if self.is_user_stopped:
            return RobotMode.USER_STOPPED
        if self.errors:
            return RobotMode.REFLEX
        ours = self.running.get(CONTROLLER)
        return RobotMode.MOVE if ours is not None and ours.is_active else RobotMode.IDLE


@pytest.fixture
def lab(monkeypatch):
    """A supervisor, its driver and the robot, on a clock that advances with every wait."""
    use_messages()
    from embodied_active_learning.ros.arm import franka_supervisor  # noqa: PLC0415 - needs the messages

    clock = SimpleNamespace(now=10.0)
    driver = SetPointDriver(CONFIG, lambda: clock.now)
    interface = Interface()
    transform = np.eye(4)
    pose = CameraPose(tuple(CONFIG.workspace.box().centre), 0.0, (0.0, 0.0))
    transform[:3, 3], transform[:3, :3] = CameraMount.from_config(CONFIG).end_effector(pose)

    def passes(seconds=0.05):
        for _ in range(max(round(seconds / 0.05), 1)):
            clock.now += 0.05
            transform[0, 3] += 0.05 * interface.speed
            driver.update_state(clock.now, 0.0, transform.T.ravel(), interface.mode, interface.errors, ())
            driver.tick()

    monkeypatch.setattr(franka_supervisor, "WallTimer", lambda period, function: None)
    monkeypatch.setattr(franka_supervisor, "threading", SimpleNamespace(Lock=threading.Lock, Thread=_NoThread))
    monkeypatch.setattr(franka_supervisor, "time", SimpleNamespace(monotonic=lambda: clock.now, sleep=passes))
    monkeypatch.setattr(driver, "wait_until_ready", passes)
    supervisor = franka_supervisor.FrankaSupervisor(interface, driver, CONFIG.franka)
    passes(0.2)
    return SimpleNamespace(supervisor=supervisor, driver=driver, interface=interface, passes=passes)


@pytest.fixture
def requests(monkeypatch):
    """The requests to services of franka_ros: their fields by the service's name."""
    use_messages()
    from embodied_active_learning.ros.arm import franka_interface  # noqa: PLC0415 - needs the messages

    sent = {}

    def call(name, service_class, **fields):
        service_class._request_class(**fields)  # rejects unknown fields
        sent[name] = fields
        return SimpleNamespace(success=True)

    monkeypatch.setattr(franka_interface, "_call", call)
    return sent


class _NoThread:
    def __init__(self, **_arguments):
        pass

    def start(self):
        pass


def test_contact_limits_are_sent_in_all_fields(requests):
    from embodied_active_learning.ros.arm.franka_interface import FrankaInterface  # noqa: PLC0415

    torques, forces = tuple(range(11, 18)), tuple(range(21, 27))
    config = Config.from_dict({"franka": {"torque_limits": torques, "force_limits": forces}}).franka
    FrankaInterface.set_collision_behaviour(None, config)
    fields = requests[names.FRANKA_COLLISION]
    assert len(fields) == 8
    for name, values in fields.items():
        assert tuple(values) == (torques if "torque" in name else forces), name


def test_load_is_sent_with_centre_and_inertia(requests):
    from embodied_active_learning.ros.arm.franka_interface import FrankaInterface  # noqa: PLC0415

    load = {"load_mass": 0.3, "load_centre": (0.01, 0.02, 0.03), "load_inertia": (0.001, 0.002, 0.003)}
    FrankaInterface.set_load(SimpleNamespace(_load_mass=0.0), Config.from_dict({"franka": load}).franka)
    assert requests[names.FRANKA_LOAD] == {
        "mass": 0.3,
        "F_x_center_load": [0.01, 0.02, 0.03],
        "load_inertia": [0.001, 0.0, 0.0, 0.0, 0.002, 0.0, 0.0, 0.0, 0.003],
    }


@pytest.mark.parametrize("error", [ConnectionRefusedError(), http.client.IncompleteRead(b""), ExpatError()])
def test_publishers_are_kept_while_master_is_down(monkeypatch, error):
    """Connections of nodes outlive the master: another publisher may still send."""
    use_messages()
    from embodied_active_learning.ros.arm.franka_interface import FrankaInterface  # noqa: PLC0415

    topic = rospy.resolve_name(names.FRANKA_SET_POINT)
    interface = SimpleNamespace(_other_publishers=[])
    responses = [lambda: (1, "", ([[topic, ["/rival", rospy.get_name()]]], [], []))]
    system = SimpleNamespace(getSystemState=lambda caller: responses[-1]())
    monkeypatch.setattr("embodied_active_learning.ros.arm.franka_interface.master_proxy", lambda: system)
    assert FrankaInterface.other_publishers(interface) == ["/rival"]

    def refuse():
        raise error

    responses.append(refuse)
    assert FrankaInterface.other_publishers(interface) == ["/rival"]


def condition(lab):
    with lab.driver.readiness() as readiness:
        return readiness.condition


def test_robot_is_prepared_before_its_controller_is_started(lab):
    lab.supervisor.check()
    lab.passes(0.2)
    assert lab.interface.calls == ["set_collision_behaviour", "set_load", "load", "set_stiffness", "start"]
    assert condition(lab) is Condition.READY


@pytest.mark.parametrize("request_", ["set_collision_behaviour", "set_load", "load", "set_stiffness"])
def test_controller_is_not_started_after_rejected_setting(lab, request_):
    lab.interface.rejected = request_
    lab.supervisor.check()
    assert "start" not in lab.interface.calls
    assert lab.driver.why_not_ready() == f"{request_} rejected"
    calls = len(lab.interface.calls)
    lab.supervisor.check()
    assert len(lab.interface.calls) == calls, "it is retried by a person only"


def test_own_controller_is_not_restarted_while_arm_moves(lab):
    lab.interface.running = {CONTROLLER: Controller("running", True)}
    lab.interface.speed = 0.02
    lab.passes(0.5)
    lab.supervisor.check()
    assert lab.interface.calls == []
    assert "moves the arm on behalf of another node" in lab.driver.why_not_ready()
    lab.interface.speed = 0.0
    lab.passes(0.5)
    lab.supervisor.recover()
    assert lab.interface.calls[0] == "stop"


def prepared(lab):
    lab.supervisor.check()
    lab.passes(0.2)
    lab.interface.calls.clear()
    return lab


def test_requested_recovery_clears_reflex(lab):
    prepared(lab)
    lab.interface.errors, lab.interface.recovers = ERROR, [True]
    lab.passes()
    lab.supervisor.recover()
    assert lab.interface.calls == ["recover"]
    assert condition(lab) is Condition.READY


def test_error_unknown_to_franka_control_is_provoked_and_cleared(lab):
    """After its restart franka_control has no controllers, and its recovery has no effect at first."""
    prepared(lab)
    lab.interface.errors, lab.interface.recovers, lab.interface.running = ERROR, [False, True], {}
    lab.passes()
    lab.supervisor.recover()
    preparation = ["stop", "set_collision_behaviour", "set_load", "set_stiffness", "start"]
    assert lab.interface.calls == ["recover", "load", "start", "recover", *preparation]
    assert condition(lab) is Condition.READY


def test_robot_is_never_ready_with_lost_settings(lab):
    """A command that is accepted before the preparation would be cut off when the controller is stopped."""
    prepared(lab)
    lab.interface.errors, lab.interface.recovers, lab.interface.running = ERROR, [False, True], {}
    lab.passes()
    conditions = []
    lab.interface.before_call = lambda: conditions.append(condition(lab))
    lab.supervisor.recover()
    assert len(conditions) == 9
    assert Condition.READY not in conditions


def test_controller_restarted_elsewhere_is_prepared_on_request(lab):
    prepared(lab)
    for controller in (Controller("stopped", True), Controller("running", True)):
        lab.interface.running = {CONTROLLER: controller}
        lab.supervisor.update_controllers()
        lab.passes(0.2)
    lab.supervisor.check()
    assert lab.interface.calls == []
    assert "was stopped by another node" in lab.driver.why_not_ready()
    lab.supervisor.recover()
    assert lab.interface.calls == ["stop", "set_collision_behaviour", "set_load", "set_stiffness", "start"]
    assert condition(lab) is Condition.READY


def test_recovery_ends_whatever_fails_after_it(lab):
    prepared(lab)
    lab.interface.errors, lab.interface.recovers = ERROR, [True]
    lab.passes(1.5)
    lab.supervisor.update_controllers()

    def fail():
        raise KeyError("unexpected")

    lab.interface.other_publishers = fail
    with pytest.raises(KeyError):
        lab.supervisor.check()
    lab.passes()
    assert condition(lab) is Condition.READY


def test_error_that_persists_is_reported_with_remedy(lab):
    prepared(lab)
    lab.interface.errors, lab.interface.recovers = ERROR, [False, False]
    lab.passes()
    with pytest.raises(RobotError, match=r"still reports communication.*Desk.*/arm/recover"):
        lab.supervisor.recover()


def test_robot_is_not_recovered_beside_another_controller(lab):
    prepared(lab)
    lab.interface.running = {"other": Controller("running", True)}
    lab.interface.errors, lab.interface.recovers = ERROR, [False]
    lab.passes()
    with pytest.raises(RobotError, match="other may move the robot"):
        lab.supervisor.recover()
    assert lab.interface.calls == []


@pytest.mark.parametrize("errors", [(), ERROR])
def test_controllers_are_requested_once_beside_another_controller(lab, errors):
    prepared(lab)
    lab.interface.running = {"other": Controller("running", True)}
    lab.interface.errors = errors
    lab.passes()
    requests, controllers = [], lab.interface.controllers
    lab.interface.controllers = lambda: requests.append("list") or controllers()
    with pytest.raises((ArmNotReadyError, RobotError), match="other"):
        lab.supervisor.recover()
    assert requests == ["list"]


def test_recovery_during_user_stop_is_rejected(lab):
    prepared(lab)
    lab.interface.is_user_stopped = True
    lab.passes()
    with pytest.raises(ArmNotReadyError, match="user stop is pressed"):
        lab.supervisor.recover()
    assert lab.interface.calls == []


def test_recovery_is_rejected_while_supervisor_is_busy(lab, monkeypatch):
    """A request to controller_manager hangs: the person gets an error instead of no response."""
    monkeypatch.setattr(requested_recovery, "LOCK_TIMEOUT", 0.0)
    prepared(lab)
    with lab.supervisor._lock, pytest.raises(ArmNotReadyError, match="call /arm/recover again later"):
        lab.supervisor.recover()
    assert condition(lab) is Condition.READY, "nothing was changed"


def test_failed_recovery_after_user_stop_holds_robot(lab):
    """The cause of the failure disappears later, while a person may be at the robot."""
    prepared(lab)
    lab.interface.is_user_stopped = True
    lab.passes()
    lab.interface.is_user_stopped, lab.interface.has_manager = False, False
    lab.passes()
    with pytest.raises(ArmNotReadyError, match="no response from controller_manager"):
        lab.supervisor.recover()
    lab.interface.has_manager = True
    lab.passes(2.0)
    lab.supervisor.check()
    assert condition(lab) is Condition.RECOVERY_REQUIRED
    assert "the requested recovery failed (no response from controller_manager" in lab.driver.why_not_ready()
    lab.supervisor.recover()
    assert condition(lab) is Condition.READY


def test_failed_recovery_from_early_reflex_is_not_retried(lab):
    """A reflex that is older than the node's first motion is cleared only at the request of a person."""
    lab.interface.errors, lab.interface.recovers = ERROR, [False, False, True]
    lab.passes()
    with pytest.raises(RobotError, match="Desk"):
        lab.supervisor.recover()
    lab.interface.calls.clear()
    lab.passes(30.0)
    lab.supervisor.check()
    assert lab.interface.calls == []
    assert condition(lab) is Condition.RECOVERY_REQUIRED
