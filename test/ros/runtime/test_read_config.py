"""Which configuration a node reads; a dictionary takes the place of the parameter server."""

from types import SimpleNamespace

import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.ros.runtime import node


def config(robot):
    return Config.from_dict({"arm": {"robot": robot}}).to_dict()


@pytest.fixture
def system(monkeypatch):
    """A run of the paper's robot, on a master that knows the parameters of a franka_arm."""
    parameters = {"/config": config("velocity_service"), "/franka_arm/config": config("franka")}
    system = SimpleNamespace(parameters=parameters, registered=True, connection_error="")
    master = SimpleNamespace(lookupNode=lambda name: (1 if system.registered else -1, "", "http://robot:1"))
    monkeypatch.setattr(rospy, "get_master", lambda: master)
    monkeypatch.setattr(rospy, "get_param", parameters.get)
    monkeypatch.setattr(node, "connection_error", lambda uri: system.connection_error)
    return system


def test_configuration_of_running_arm_is_read_on_request(system):
    assert node.read_config(of_arm=True).arm.robot == "franka"
    assert node.read_config().arm.robot == "velocity_service"


@pytest.mark.parametrize("change", [{"registered": False}, {"connection_error": "refused"}])
def test_configuration_of_ended_arm_is_ignored(system, change):
    vars(system).update(change)
    assert node.read_config(of_arm=True).arm.robot == "velocity_service"


def test_own_parameter_replaces_that_of_namespace(system):
    system.parameters["~config"] = config("pybullet")
    assert node.read_config().arm.robot == "pybullet"
