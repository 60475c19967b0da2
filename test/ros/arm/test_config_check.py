"""A real arm accepts commands only from a system that was configured for it."""

import pytest

from embodied_active_learning.config import Config, merge
from embodied_active_learning.errors import CommandError
from embodied_active_learning.ros.arm import config_check
from embodied_active_learning.ros.arm.config_check import ConfigCheck

OWN = Config.from_dict({"franka": {"table_height": 0.1}, "workspace": {"x": [0.4, 0.6]}})


@pytest.fixture
def system(monkeypatch):
    """The parameter server; a test may change the configuration there."""
    values = {"config": OWN.to_dict()}
    monkeypatch.setattr(config_check, "WallTimer", lambda period, function: None)
    monkeypatch.setattr(config_check.rospy, "get_param", values.get)
    return values


def test_system_with_same_arm_settings_is_accepted(system):
    changes = {"exploration": {"seed": 7}, "session": {"name": "another"}, "arm": {"retries": 9}}
    system["config"] = merge(OWN.to_dict(), changes)
    ConfigCheck(OWN).require()


def test_missing_system_is_no_mismatch(system):
    del system["config"]
    ConfigCheck(OWN).require()


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [("workspace", "x", [0.4, 0.7]), ("franka", "table_height", 0.0), ("arm", "max_speed", 0.3)],
)
def test_mismatch_is_rejected_with_key(system, section, key, value):
    check = ConfigCheck(OWN)
    system["config"] = merge(OWN.to_dict(), {section: {key: value}})
    check.require()  # not checked yet
    check.update()
    with pytest.raises(CommandError, match=f"{section}/{key} is .* give both launch files the same robot_profile"):
        check.require()
    system["config"] = OWN.to_dict()
    check.update()
    check.require()


@pytest.mark.parametrize("values", ["text", {"workspace": 3}, {"unknown": {}}])
def test_invalid_system_configuration_is_rejected(system, values):
    system["config"] = values
    with pytest.raises(CommandError, match="invalid system configuration"):
        ConfigCheck(OWN).require()
