"""Values of launch arguments: defaults that mean "not given", overrides of settings, and checks before a launch."""

from __future__ import annotations

import sys
from typing import Any, Dict, Mapping, Sequence

from embodied_active_learning.config import FRANKA, REAL_ROBOTS, RECORDED, SIMULATED, Config, merge
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.files import parse_yaml, short_repr
from embodied_active_learning.hardware_config import ARMS
from embodied_active_learning.schema import settings

UNSET = "unset"
"""Default of optional launch arguments: roslaunch --ros-args lists those with an empty default as required."""
AUTO = "auto"
"""Value of exploration/steps in launch files that stands for exploration/stop: stable."""
BRINGUPS = ("all", "nodes", "none")
"""What a launch file starts of the arm: everything, everything but a real arm's drivers, or nothing."""
_PLACEHOLDERS = {
    "session": "NAME",
    "bag": "PATH",
    "robot_host": "ADDRESS",
    "server_host": "ADDRESS",
    "robot_env": "FILE",
    "server_env": "FILE",
    "robot_profile": "FILE",
}
"""What stands for the value of a required launch argument in messages."""


def parse_overrides(overrides: Sequence[str]) -> Dict[str, Dict[str, Any]]:
    """Return sections of keys from texts SECTION/KEY=VALUE. Raises ConfigError.

    An override without a value is ignored, and of several for one key the last counts.
    """
    changes: Dict[str, Dict[str, Any]] = {}
    for override in overrides:
        changes = merge(changes, _parse_override(override))
    return changes


def unset_to_empty(value: str) -> str:
    """Return the value of a launch argument; empty if it is unset."""
    return "" if value == UNSET else value


def require_arguments(values: Mapping[str, str]) -> None:
    """Check that launch arguments are given. Raises ConfigError."""
    for name, value in values.items():
        if not unset_to_empty(value):
            raise ConfigError(f"{name} is missing: give {name}:={_PLACEHOLDERS.get(name, 'VALUE')}")


def print_failure(error: Exception, aliases: Sequence[str] = ()) -> None:
    """Print why a launch file starts nothing: in red on a terminal, because roslaunch prints much after it.

    Args:
        error: The reason.
        aliases: Texts SECTION/KEY=NAME: launch arguments to name with their settings, which are named differently.
    """
    pairs = [text.partition("=") for text in aliases]
    message = "; ".join([str(error), *(f"{name}:= sets {key}" for key, _, name in pairs if key in str(error))])
    red, end = ("\033[31m", "\033[0m") if sys.stderr.isatty() else ("", "")
    print(f"\n{red}nothing was started: {message}{end}\n", file=sys.stderr)  # noqa: T201 - for the launch file's reader


def check_robot(changes: Mapping[str, Dict[str, Any]]) -> None:
    """Check that the robot a launch file sets, if any, has an arm. Raises ConfigError."""
    robot = changes.get("arm", {}).get("robot", SIMULATED)
    if robot == RECORDED:
        raise ConfigError(
            "robot is recording, which has no arm: learn from a recording with replay.launch, search its session's "
            "images with identify.launch replay:=NAME"
        )
    if robot not in ARMS:
        raise ConfigError(f"robot is {short_repr(robot)}: expected one of {', '.join(ARMS)}")


def check_bringup(
    config: Config,
    bringup: str,
    robot_ip: str,
    arm_id: str = "",
    robot_profile: str = "",
    bringups: Sequence[str] = BRINGUPS,
) -> None:
    """Check the launch arguments about starting the arm. Raises ConfigError.

    A new session whose launch moves a real arm needs a robot profile: the shipped one has the table at the height of
    the base and no camera mount. bringups: values of bringup that the launch file takes.
    """
    if bringup not in bringups:
        raise ConfigError(f"bringup is {short_repr(bringup)}: expected one of {', '.join(bringups)}")
    if config.arm.robot == RECORDED and bringup != "none":
        raise ConfigError("arm/robot is recording, which has no arm: use replay.launch")
    if config.arm.robot == FRANKA and bringup == "all" and not robot_ip:
        raise ConfigError(
            "robot_ip is missing: give the address of the Panda's controller, such as robot_ip:=172.16.0.2, or "
            "bringup:=nodes if franka_ros and the camera driver are running"
        )
    if config.arm.robot in REAL_ROBOTS and bringup == "all" and not (robot_profile or config.session.resume):
        raise ConfigError(
            "robot_profile is missing: copy config/franka.yaml, enter the height of your table and the mount of your "
            "camera (docs/panda.md), and give robot_profile:=YOUR_FILE.yaml"
        )
    if config.arm.robot in REAL_ROBOTS and arm_id not in ("", config.franka.arm_id):
        raise ConfigError(
            f"arm_id is {short_repr(arm_id)}, but the robot profile has franka/arm_id {config.franka.arm_id}: give "
            f"arm_id:={config.franka.arm_id}, or correct the robot profile"
        )


def _parse_override(text: str) -> Dict[str, Dict[str, Any]]:
    path, equals, value = text.partition("=")
    section, slash, key = path.partition("/")
    if not (equals and slash and section and key):
        raise ConfigError(f"override {short_repr(text)} is malformed: expected section/key=value")
    if not unset_to_empty(value):
        return {}
    if (section, key, value) == ("exploration", "steps", AUTO):
        return {section: {"stop": "stable"}}
    try:
        return {section: {key: value if _is_text(section, key) else parse_yaml(value)}}
    except ValueError as error:
        raise ConfigError(f"override {short_repr(text)} is malformed: the value is not plain YAML ({error})") from error


def _is_text(section: str, key: str) -> bool:
    """Return whether a setting is a text, which must not be parsed as YAML: a session may be named 1e3."""
    return any(isinstance(item.default, str) for name, item in settings(Config) if (name, item.name) == (section, key))
