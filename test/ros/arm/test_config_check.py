"""A real arm takes commands only from a system that was configured for it."""

import pytest

from embodied_active_learning.config import Config, merge
from embodied_active_learning.errors import CommandError
from embodied_active_learning.ros.arm import config_check
from embodied_active_learning.ros.arm.config_check import ConfigCheck

OWN = Config.from_dict({"franka": {"table_height": 0.1}, "workspace": {"x": [0.4, 0.6]}})


@pytest.fixture
def system(monkeypatch):
    """The configuration on the master, to be changed by a test."""
    values = {"config": OWN.to_dict()}
    monkeypatch.setattr(config_check, "WallTimer", lambda period, function: None)
    monkeypatch.setattr(config_check.rospy, "get_param", values.get)
    return values


def test_a_system_with_the_same_workspace_camera_and_limits_may_drive(system):
    system["config"] = merge(OWN.to_dict(), {"exploration": {"seed": 7}, "session": {"name": "another"}})
    ConfigCheck(OWN).require()


def test_no_system_at_all_is_no_disagreement(system):
    del system["config"]
    ConfigCheck(OWN).require()


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [("workspace", "x", [0.4, 0.7]), ("franka", "table_height", 0.0), ("arm", "max_speed", 0.3)],
)
def test_another_workspace_mount_or_limit_is_refused_by_name(system, section, key, value):
    watched = ConfigCheck(OWN)
    system["config"] = merge(OWN.to_dict(), {section: {key: value}})
    watched.require()  # not looked at yet
    watched.look()
    with pytest.raises(CommandError, match=f"{section}/{key} is .* give both launch files the same robot_profile"):
        watched.require()
    system["config"] = OWN.to_dict()
    watched.look()
    watched.require()


@pytest.mark.parametrize("values", ["text", {"workspace": 3}, {"unknown": {}}])
def test_a_configuration_that_is_none_is_refused(system, values):
    system["config"] = values
    with pytest.raises(CommandError, match="the system's configuration is none"):
        ConfigCheck(OWN).require()
