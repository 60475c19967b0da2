"""Values of launch arguments: overrides and checks before a launch."""

import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.ros.launch_arguments import check_bringup, check_robot, parse_overrides, unset_to_empty


def resolved(robot, franka=()):
    return Config.from_dict({"arm": {"robot": robot}, "franka": dict(franka)})


def test_automatic_steps_stand_for_the_stopping_criterion():
    assert parse_overrides(["exploration/steps=auto"]) == {"exploration": {"stop": "stable"}}


def test_override_without_value_is_ignored():
    assert parse_overrides(["exploration/steps=", "exploration/seed=unset"]) == {}


def test_last_override_of_a_key_counts():
    assert parse_overrides(["exploration/seed=1", "exploration/seed=2"]) == {"exploration": {"seed": 2}}


def test_text_is_not_parsed_as_yaml():
    assert parse_overrides(["session/name=1e3"]) == {"session": {"name": "1e3"}}


@pytest.mark.parametrize(
    ("override", "expected"),
    [("exploration.steps=5", "malformed: expected section/key=value"), ("exploration/steps=[", "not plain YAML")],
)
def test_malformed_override_is_rejected(override, expected):
    with pytest.raises(ConfigError, match=expected):
        parse_overrides([override])


@pytest.mark.parametrize(("value", "expected"), [("unset", ""), ("", ""), ("007", "007")])
def test_unset_argument_is_empty(value, expected):
    assert unset_to_empty(value) == expected


@pytest.mark.parametrize(
    ("robot", "bringup", "robot_ip", "expected"),
    [
        ("franka", "all", "", "robot_ip is missing"),
        ("franka", "all", "172.16.0.2", "robot_profile is missing"),
        ("velocity_service", "all", "", "robot_profile is missing"),
        ("franka", "some", "172.16.0.2", "expected one of all, nodes, none"),
        ("recording", "all", "", "use replay.launch"),
    ],
)
def test_invalid_bringup_is_rejected(robot, bringup, robot_ip, expected):
    config = resolved(robot)
    with pytest.raises(ConfigError, match=expected):
        check_bringup(config, bringup, robot_ip)


@pytest.mark.parametrize(
    ("robot", "expected"),
    [
        ("recording", r"no arm: learn from a recording with replay\.launch"),
        ("ur5", "robot is 'ur5': expected one of pybullet, franka, velocity_service$"),
    ],
)
def test_robot_without_an_arm_is_rejected(robot, expected):
    with pytest.raises(ConfigError, match=expected):
        check_robot({"arm": {"robot": robot}})


@pytest.mark.parametrize("changes", [{}, {"arm": {"robot": "franka"}}])
def test_robot_with_an_arm_is_accepted(changes):
    check_robot(changes)


@pytest.mark.parametrize(
    ("robot", "bringup"),
    [("pybullet", "all"), ("franka", "nodes"), ("velocity_service", "nodes"), ("recording", "none")],
)
def test_address_is_required_only_to_connect(robot, bringup):
    check_bringup(resolved(robot), bringup, "")


def test_connecting_with_a_robot_profile():
    config = resolved("franka")
    check_bringup(config, "all", "172.16.0.2", "panda", "lab.yaml")


def test_other_arm_id_than_the_profile_is_rejected():
    config = resolved("velocity_service", {"arm_id": "fr3"})
    check_bringup(config, "nodes", "", "fr3")
    with pytest.raises(ConfigError, match="give arm_id:=fr3"):
        check_bringup(config, "nodes", "", "panda")
