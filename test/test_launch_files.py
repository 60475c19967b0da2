"""Launch files: every argument says what it is for."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader

LAUNCH = sorted((Path(__file__).resolve().parents[1] / "launch").glob("*.launch"))


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.stem)
def test_every_argument_has_its_meaning_beside_it(path):
    for argument in ElementTree.parse(path).getroot().iter("arg"):
        if argument.get("value") is None:
            assert argument.get("doc"), f"{path.name}: argument {argument.get('name')} lacks doc="


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
