"""Launch files: documented arguments, nodes and parameters."""

import os
import runpy
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rospy
from roslaunch import substitution_args
from roslaunch.arg_dump import get_args
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader, XmlParseException

from embodied_active_learning.config import REAL_ROBOTS, SIMULATED
from embodied_active_learning.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = sorted((ROOT / "launch").glob("*.launch"))


def path_of(name):
    return ROOT / "launch" / f"{name}.launch"


def load(name, *arguments):
    """Return what roslaunch would start and set."""
    config = ROSLaunchConfig()
    XmlLoader().load(str(path_of(name)), config, argv=list(arguments), verbose=False)
    return config


@pytest.fixture
def commands(monkeypatch):
    """The commands of parameters, which are recorded instead of run."""
    recorded = []

    def param_value(loader, verbose, name, kind, value, textfile, binfile, command):
        recorded.append(command or "")
        return read(loader, verbose, name, kind, value, textfile, binfile, None) if command is None else {}

    read = XmlLoader.param_value
    monkeypatch.setattr(XmlLoader, "param_value", param_value)
    return recorded


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.stem)
def test_arguments_are_documented(path):
    for argument in ElementTree.parse(path).getroot().iter("arg"):
        if argument.get("value") is None:
            assert argument.get("doc"), f"{path.name}: argument {argument.get('name')} lacks doc="


@pytest.mark.parametrize(
    "name", ["learn", "fingerprint", "identify", "replay", "robot", "trainer_workers", "two_machines"]
)
def test_roslaunch_lists_no_argument_as_required(name):
    """`roslaunch --ros-args` lists arguments with an empty default as required, and derived ones as optional.

    The resolver reports a missing argument more clearly than roslaunch does.
    """
    arguments = get_args([str(path_of(name))])
    assert {argument for argument, (_, default) in arguments.items() if not default} == set()
    if name != "robot":
        assert [argument for argument, (doc, _) in arguments.items() if not doc] == []


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.stem)
def test_nodes_do_not_keep_parameters_of_earlier_launches(path):
    """Such as ~once of fingerprint.launch, with which the fingerprinter of learn.launch would end the run."""
    for node in ElementTree.parse(path).getroot().iter("node"):
        if node.find("param") is not None or node.find("rosparam") is not None:
            assert node.get("clear_params") == "true", f"{path.name}: node {node.get('name')}"


def test_learn_launch_clears_private_parameters(commands):
    config = load("learn")
    private = {f"/{node.name}/" for node in config.nodes if any(f"/{node.name}/" in name for name in config.params)}
    assert private == {"/trainer/", "/ergodic_planner/", "/fingerprinter/", "/monitor/"}
    assert private <= set(config.clear_params)


@pytest.mark.parametrize("robot", [SIMULATED, *REAL_ROBOTS])
def test_stop_outlasts_launch_of_real_arm_only(robot):
    cleared = [name for name in load(f"{robot}_arm").params if name.endswith(("stopped_by", "held_for"))]
    assert cleared == (["/arm/stopped_by"] if robot == SIMULATED else [])


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """Stubs of the packages of a real arm that the launch files refer to."""
    files = {
        "franka_control": {
            "launch/franka_control.launch": """<launch>
                <arg name="robot_ip" /> <arg name="robot" default="panda" /> <arg name="load_gripper" default="true" />
                <node name="franka_control" pkg="franka_control" type="franka_control_node">
                  <param name="robot_ip" value="$(arg robot_ip)" />
                </node> </launch>""",
        },
        "franka_example_controllers": {
            "config/franka_example_controllers.yaml": """cartesian_impedance_example_controller:
                {type: franka_example_controllers/CartesianImpedanceExampleController, arm_id: $(arg arm_id)}""",
        },
        "usb_cam": {},
    }
    for package, contents in files.items():
        manifest = f"<package><name>{package}</name><version>0.0.0</version><description>-</description></package>"
        for name, text in {"package.xml": manifest, **contents}.items():
            path = tmp_path / package / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(substitution_args, "_rospack", None)  # it remembers the packages that it found


def test_robot_launch_starts_driver_and_camera_only(lab):
    options = ("exposure:=100", "video_device:=/dev/video3")
    config = load("robot", "robot_ip:=172.16.0.2", "robot_profile:=franka", *options)
    names = {f"{node.namespace}{node.name}" for node in config.nodes}
    assert names == {"/franka_control", "/usb_cam", "/franka_arm", "/camera_pipeline"}
    parameters = {name: parameter.value for name, parameter in config.params.items()}
    assert parameters["/franka_control/robot_ip"] == "172.16.0.2"
    assert parameters["/cartesian_impedance_example_controller/arm_id"] == "panda"
    camera = {name.rsplit("/", 1)[1]: value for name, value in parameters.items() if name.startswith("/usb_cam/")}
    assert (camera["exposure"], camera["video_device"]) == (100, "/dev/video3")
    assert not any(camera[name] for name in ("autoexposure", "autofocus", "auto_white_balance"))
    assert parameters["/franka_arm/config"]["arm"]["robot"] == "franka"
    assert not any(name.startswith("/measure_latency") for name in parameters)  # would outlast robot.launch
    assert not any(name.startswith("/config") for name in parameters)  # belongs to a system that may be learning
    assert not parameters["/use_sim_time"]


def test_two_machines_run_arm_at_robot_and_rest_on_server(commands_in_process, tmp_path):
    arguments = {
        "robot_host": "10.77.0.1",
        "server_host": "10.77.0.2",
        "robot_env": "/env.sh",
        "server_env": "/env.sh",
        "robot_ip": "172.16.0.2",
        "bringup": "nodes",
        "robot_profile": "franka",
        "trainers": "3",
        "session_root": tmp_path,
    }
    config = load("two_machines", *(f"{name}:={value}" for name, value in arguments.items()))
    config.assign_machines()
    places = {node.name: node.machine.address for node in config.nodes}
    at_robot = {name for name, address in places.items() if address == "10.77.0.1"}
    assert at_robot == {"franka_arm", "camera_pipeline"}
    on_server = ("trainer", "trainer_worker_1", "trainer_worker_2", "ergodic_planner", "monitor")
    assert {places[name] for name in on_server} == {"10.77.0.2"}
    assert "trainer_worker_3" not in places
    assert config.params["/config"].value["training"]["trainers"] == 3
    assert not config.params["/use_sim_time"].value


@pytest.mark.parametrize("name", ["learn", "identify"])
def test_recorder_is_respawned(commands, name):
    nodes = load(name, "record:=true", "respawn:=true", "once:=false").nodes
    recorder = next(node for node in nodes if node.name == "recorder")
    assert recorder.respawn
    assert recorder.respawn_delay == 3.0


NOT_ON_TWO_MACHINES = {"world", "local_workers"}
"""Arguments of learn.launch for a simulated arm, or with the right default for a server."""


def test_two_machines_pass_all_arguments_of_learn_launch():
    learn, two_machines = (ElementTree.parse(path_of(name)).getroot() for name in ("learn", "two_machines"))
    declared = {item.get("name") for item in learn.findall("arg") if not item.get("value")}
    includes = {include.get("file"): include for include in two_machines.iter("include")}
    include = includes["$(find embodied_active_learning)/launch/learn.launch"]
    passed = {item.get("name") for item in include.findall("arg")}
    at_robot = includes["$(find embodied_active_learning)/launch/arm.launch"]
    passed |= {item.get("name") for item in at_robot.findall("arg")}
    assert declared - passed == NOT_ON_TWO_MACHINES


@pytest.mark.parametrize(("paused", "expected"), [("true", "/operator"), ("false", "")])
def test_paused_planner_waits_for_an_operator(commands, paused, expected):
    config = load("learn", f"paused:={paused}")
    assert config.params["/ergodic_planner/paused_by"].value == expected


NAMES_AND_PATHS = {
    "learn": ("profile", "world", "session", "session_root", "robot_profile"),
    "fingerprint": ("profile", "session", "session_root", "robot_profile"),
    "identify": ("sessions", "replay", "world", "profile", "name", "session", "session_root", "robot_profile"),
    "replay": ("bag", "profile", "namespace", "session", "session_root"),
    "robot": ("profile", "robot_profile"),
    "two_machines": ("robot_host", "server_host", "robot_env", "server_env", "robot_profile", "session_root"),
}


@pytest.mark.parametrize(
    ("name", "argument"), [(name, argument) for name, arguments in NAMES_AND_PATHS.items() for argument in arguments]
)
def test_double_quotes_are_refused(commands_in_process, name, argument):
    """Also beside a name of digits, which roslaunch evaluates as a number."""
    arguments = {"session": "7", "profile": "7", argument: 'a"b'}
    with pytest.raises(XmlParseException, match="double quotes are not allowed"):
        load(name, *(f"{key}:={value}" for key, value in arguments.items()))


def test_visits_without_an_arm_are_refused():
    with pytest.raises(XmlParseException, match="visit:=true needs the arm: not possible with replay"):
        load("identify", "replay:=a", "visit:=true")


@pytest.mark.parametrize("replay", ["unset", "007"])
def test_identify_launch_keeps_names_of_digits(commands, replay):
    config = load("identify", "sessions:=20261102", "name:=0815", f"replay:={replay}")
    values = [config.params[f"/identifier/{name}"].value for name in ("sessions", "name", "replay")]
    assert values == ["20261102", "0815", replay]
    assert sum('--search "20261102"' in command for command in commands) == 1


def test_identifier_takes_unset_arguments_as_empty(monkeypatch):
    monkeypatch.setattr(rospy, "get_param", {"~name": "0815", "~replay": "unset"}.get)
    text_parameter = runpy.run_path(str(ROOT / "nodes" / "identifier"))["text_parameter"]
    assert [text_parameter(name) for name in ("name", "replay", "sessions")] == ["0815", "", ""]


@pytest.mark.parametrize("value", [100, 100.0])
def test_identifier_takes_whole_number_of_images(monkeypatch, value):
    monkeypatch.setattr(rospy, "get_param", lambda name, default: value)
    images = runpy.run_path(str(ROOT / "nodes" / "identifier"))["_images"]()
    assert (images, type(images)) == (100, int)


@pytest.mark.parametrize("value", [1.5, float("inf"), "auto"])
def test_identifier_rejects_malformed_number_of_images(monkeypatch, value):
    monkeypatch.setattr(rospy, "get_param", lambda name, default: value)
    with pytest.raises(ConfigError, match=r"images is .*: expected a whole number"):
        runpy.run_path(str(ROOT / "nodes" / "identifier"))["_images"]()


@pytest.mark.parametrize("images", ["0", "10"])
def test_invalid_number_of_images_names_launch_argument(commands_in_process, tmp_path, capfd, images):
    with pytest.raises(XmlParseException):
        load("identify", "once:=false", f"images:={images}", f"session_root:={tmp_path}")
    message = capfd.readouterr().err
    assert f"exploration/steps is {images}" in message
    assert "images:= sets exploration/steps" in message


@pytest.mark.parametrize("bringup", ["all", "nodes"])
def test_velocity_service_starts_its_adapter_and_no_driver(bringup):
    config = load("arm", "robot:=velocity_service", f"bringup:={bringup}")
    assert {node.name for node in config.nodes} == {"velocity_service_arm", "camera_pipeline"}


def test_invalid_number_of_trainers_is_reported_by_the_resolver(commands_in_process, tmp_path, capfd):
    with pytest.raises(XmlParseException):
        load("learn", "trainers:=two", f"session_root:={tmp_path}")
    assert "training/trainers is 'two': expected a whole number" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("explorer", "updates"),
    [("ergodic", ""), ("mine.spiral:SpiralExplorer", "")]
    + [(name, "0") for name in ("active", "random_walk", "uniform", "uniform_ergodic")],
)
def test_identify_launch_trains_for_own_explorers(commands, explorer, updates):
    load("identify", "sessions:=a", f"explorer:={explorer}")
    resolve = next(command for command in commands if "resolve_config" in command)
    assert f'--set "training/updates_per_observation={updates}"' in resolve


MACHINES = {"robot_host": "10.77.0.1", "server_host": "10.77.0.2", "robot_env": "/a.sh", "server_env": "/b.sh"}


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("fingerprint", {}, "session is missing: give session:=NAME"),
        ("replay", {}, "bag is missing: give bag:=PATH"),
        ("two_machines", {**MACHINES, "robot_env": "unset"}, "robot_env is missing: give robot_env:=FILE"),
        ("two_machines", MACHINES, "robot_profile is missing: give robot_profile:=FILE"),
        ("two_machines", {**MACHINES, "robot_profile": "franka"}, "robot_ip is missing: give the address"),
    ],
)
def test_missing_argument_is_reported(commands_in_process, capfd, name, arguments, message):
    with pytest.raises(XmlParseException):
        load(name, *(f"{key}:={value}" for key, value in arguments.items()))
    assert f"nothing was started: {message}" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("name", "argument", "message"),
    [
        ("robot", "bringup:=none", "bringup is 'none': expected one of all, nodes"),
        ("learn", "robot:=recording", "robot is recording, which has no arm"),
    ],
)
def test_robot_and_bringup_without_arm_are_rejected(commands_in_process, capfd, name, argument, message):
    with pytest.raises(XmlParseException):
        load(name, argument)
    assert f"nothing was started: {message}" in capfd.readouterr().err
