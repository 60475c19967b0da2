"""Launch files refuse to replace the parameters of running nodes: roslaunch sets parameters before it starts nodes."""

from contextlib import suppress
from unittest.mock import Mock
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader, XmlParseException
from rospkg import ResourceNotFound

from embodied_active_learning.config import REAL_ROBOTS, SIMULATED, Config
from embodied_active_learning.pipeline import resolve
from embodied_active_learning.ros import launch_arguments
from embodied_active_learning.ros.bags import recording, replay_config
from embodied_active_learning.session import fingerprint_sets
from launching import ROOT
from threads import in_a_thread

pytestmark = pytest.mark.usefixtures("commands_in_process")


class Master(SimpleXMLRPCServer):
    """A ROS master that knows some nodes, and is the server of each of them."""

    def __init__(self):
        super().__init__(("localhost", 0), logRequests=False)
        self.uri = f"http://localhost:{self.server_address[1]}"
        self.running = set()
        self.requested = set()
        self.register_function(self._look_up, "lookupNode")
        self.register_function(lambda caller: (1, "", 7), "getPid")
        self.register_function(lambda caller, name: (-1, "not set", 0), "getParam")

    def _look_up(self, caller, name):
        self.requested.add(name)
        return (1, "", self.uri) if name in self.running else (-1, "unknown node", "")


@pytest.fixture
def master(monkeypatch):
    with Master() as master:
        monkeypatch.setenv("ROS_MASTER_URI", master.uri)
        thread = in_a_thread(master.serve_forever, 0.01)
        yield master
        master.shutdown()
        thread.join()


@pytest.fixture
def valid(monkeypatch):
    """All arguments are valid: sessions and bags need not exist."""
    monkeypatch.setattr(resolve, "resolve_config", lambda *arguments, **options: Config())
    monkeypatch.setattr(launch_arguments, "check_bringup", Mock())
    monkeypatch.setattr(fingerprint_sets, "searched_sessions", Mock())
    monkeypatch.setattr(recording, "Recording", lambda *arguments: Mock(warnings=list))
    monkeypatch.setattr(replay_config, "resolve_replay", lambda *arguments: Config())


def load(name, **arguments):
    path = ROOT / "launch" / f"{name}.launch"
    words = [f"{key}:={value}" for key, value in arguments.items()]
    XmlLoader().load(str(path), ROSLaunchConfig(), argv=words, verbose=False)


ARMS = {"/camera_pipeline", *(f"/{robot}_arm" for robot in (SIMULATED, *REAL_ROBOTS))}
MACHINES = dict.fromkeys(("robot_host", "server_host", "robot_env", "server_env", "robot_profile"), "x")
SYSTEM = {"/trainer", "/ergodic_planner", "/fingerprinter"}
LEARNING = SYSTEM | {"/monitor", "/recorder"}


@pytest.mark.parametrize(
    ("name", "arguments", "names"),
    [
        ("learn", {}, {*LEARNING, *ARMS}),
        ("learn", {"robot": "velocity_service"}, {*LEARNING, *ARMS}),
        ("learn", {"robot": "franka", "bringup": "none"}, LEARNING),
        ("robot", {"bringup": "nodes"}, ARMS),
        ("two_machines", MACHINES, ARMS),
        ("fingerprint", {"session": "a"}, {*SYSTEM, "/identifier", *ARMS}),
        ("fingerprint", {"session": "a", "views_from": "stored"}, {*SYSTEM, "/identifier"}),
        ("identify", {"once": "false"}, {*SYSTEM, "/identifier", "/recorder", *ARMS}),
        ("identify", {"sessions": "a", "replay": "b"}, {"/identifier"}),
        ("replay", {"bag": "nowhere.bag"}, {*SYSTEM, "/replay", "/monitor", "/identifier", *ARMS}),
    ],
)
def test_launch_requires_unused_names(master, valid, name, arguments, names):
    with suppress(ResourceNotFound):  # packages of a real arm
        load(name, **arguments)
    assert master.requested == names


@pytest.mark.parametrize("node", ["/franka_arm", "/ergodic_planner"])
def test_replay_is_refused_beside_a_running_system(master, valid, capfd, node):
    master.running.add(node)
    with pytest.raises(XmlParseException):
        load("replay", bag="nowhere.bag")
    output = capfd.readouterr().err
    assert f"node {node} is already running" in output
    assert "end robot.launch before it" in output


def test_remedy_beside_a_running_arm_is_accepted_by_the_launch(master, valid, capfd):
    """robot.launch itself takes no bringup:=none."""
    master.running.add("/franka_arm")
    for name, arguments, has_remedy in (
        ("learn", {"robot": "franka"}, True),
        ("robot", {"bringup": "nodes"}, False),
    ):
        with pytest.raises(XmlParseException):
            load(name, **arguments)
        assert ("use bringup:=none" in capfd.readouterr().err) == has_remedy


def test_simulated_arm_is_refused_beside_a_real_one(master, capfd, tmp_path):
    """It would take over /arm/stop."""
    master.running.add("/franka_arm")
    with pytest.raises(XmlParseException):
        load("learn", session_root=tmp_path)
    assert "node /franka_arm is already running" in capfd.readouterr().err


def test_invalid_argument_is_reported_before_running_node(master, capfd, tmp_path):
    master.running.add("/trainer")
    for name, arguments, message in (
        ("learn", {"seed": "one"}, "exploration/seed is 'one'"),
        ("replay", {"bag": "nowhere.bag"}, "nowhere.bag"),
    ):
        with pytest.raises(XmlParseException):
            load(name, session_root=tmp_path, **arguments)
        output = capfd.readouterr().err
        assert message in output
        assert "already running" not in output


def test_fingerprinting_is_refused_beside_an_identification(master, valid, capfd):
    master.running.add("/identifier")
    with pytest.raises(XmlParseException):
        load("fingerprint", session="a", views_from="stored")
    output = capfd.readouterr().err
    assert "node /identifier is already running" in output
    assert "bringup:=none" not in output
