"""Launch files: every argument says what it is for."""

import os
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader

LAUNCH = sorted((Path(__file__).resolve().parents[2] / "launch").glob("*.launch"))


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.stem)
def test_every_argument_has_its_meaning_beside_it(path):
    for argument in ElementTree.parse(path).getroot().iter("arg"):
        if argument.get("value") is None:
            assert argument.get("doc"), f"{path.name}: argument {argument.get('name')} lacks doc="


@pytest.fixture
def lab(tmp_path):
    """An environment in which the packages of a real arm are installed, as far as launch files look into them."""
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
    return {**os.environ, "ROS_PACKAGE_PATH": f"{tmp_path}:{os.environ['ROS_PACKAGE_PATH']}", "ROS_HOME": str(tmp_path)}


def test_a_real_arm_is_brought_up_with_its_controller_its_camera_and_nothing_that_moves_it_besides(lab):
    def told(option, *arguments):
        command = ["roslaunch", option, "embodied_active_learning", "robot.launch", "robot_ip:=172.16.0.2", *arguments]
        return subprocess.run(command, env=lab, check=True, capture_output=True, text=True).stdout

    assert set(told("--nodes").split()) == {"/franka_control", "/usb_cam", "/franka_arm", "/camera_pipeline"}
    parameters = yaml.safe_load(told("--dump-params", "exposure:=100", "video_device:=/dev/video3"))
    assert parameters["/franka_control/robot_ip"] == "172.16.0.2"
    assert parameters["/cartesian_impedance_example_controller/arm_id"] == "panda"
    camera = {name.rsplit("/", 1)[1]: value for name, value in parameters.items() if name.startswith("/usb_cam/")}
    assert (camera["exposure"], camera["video_device"]) == (100, "/dev/video3")
    assert not any(camera[name] for name in ("autoexposure", "autofocus", "auto_white_balance"))
    assert parameters["/franka_arm/config"]["arm"]["robot"] == "franka"
    assert not any(name.startswith("/config") for name in parameters)  # of a system that may be learning already
    assert not parameters["/use_sim_time"]


def test_over_two_machines_the_arm_runs_at_the_robot_and_all_else_on_the_server(tmp_path):
    config = ROSLaunchConfig()
    arguments = {
        "robot_host": "10.77.0.1",
        "server_host": "10.77.0.2",
        "robot_env": "/env.sh",
        "server_env": "/env.sh",
        "robot_ip": "172.16.0.2",
        "hardware": "false",
        "session_root": tmp_path,
    }
    path = next(path for path in LAUNCH if path.stem == "two_machines")
    XmlLoader().load(str(path), config, argv=[f"{name}:={value}" for name, value in arguments.items()], verbose=False)
    config.assign_machines()
    places = {node.name: node.machine.address for node in config.nodes}
    at_robot = {name for name, address in places.items() if address == "10.77.0.1"}
    assert at_robot == {"franka_arm", "camera_pipeline"}
    assert {places["trainer"], places["ergodic_planner"], places["monitor"]} == {"10.77.0.2"}
    assert not config.params["/use_sim_time"].value
