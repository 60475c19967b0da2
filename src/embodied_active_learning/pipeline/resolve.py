"""Combine profile and overrides into the configuration of a run, checked against world and session."""

from __future__ import annotations

import os
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Sequence

from embodied_active_learning.config import (
    FRANKA,
    REAL_ROBOTS,
    RECORDED,
    SIMULATED,
    Config,
    SessionConfig,
    find_profile,
    load_profile,
    merge,
)
from embodied_active_learning.errors import ConfigError, SessionError
from embodied_active_learning.files import parse_yaml, short_repr
from embodied_active_learning.hardware_config import ARMS
from embodied_active_learning.naming import MAX_NAME_LENGTH, check_name
from embodied_active_learning.schema import check_keys, settings
from embodied_active_learning.session.session import Session, check_session, known_sessions, session_path, session_root
from embodied_active_learning.simulation.resources import PACKAGE, package_folder
from embodied_active_learning.simulation.world import find_world, load_world

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


def resolve_config(
    profile: str,
    changes: Mapping[str, Dict[str, Any]],
    robot_profile: str = "",
    recorded: Optional[Mapping[str, Any]] = None,
    needs_arm: bool = True,
) -> Config:
    """Return the configuration of a run, with the path of its world and the name of its session filled in.

    Args:
        profile: Name of a profile in config/, or path of a YAML file. Without one, the defaults, or the configuration
            of the session that is resumed.
        changes: Sections of keys that override the profile.
        robot_profile: The same for a real robot, whose limits override the run's profile; by default the one that
            ARMS lists.
        recorded: Sections of keys that recorded images were made with; defaults of a new session of these images.
        needs_arm: False if a resumed session is only read: its world may be missing on this computer.

    Raises:
        ConfigError: A profile or a value is invalid.
        WorldError: The world cannot be built.
        SessionError: The session cannot be opened for writing, see check_session.
    """
    config = merge_config(profile, changes, robot_profile, recorded)
    if config.arm.robot == SIMULATED:
        if unset_to_empty(robot_profile):
            raise ConfigError(
                f"the robot profile {short_repr(robot_profile)} is for a real robot: set arm/robot, or leave it out"
            )
        if needs_arm or not config.session.resume:
            config = _with_world(config)
    elif "world" in changes.get("simulation", {}):
        raise ConfigError(
            f"simulation/world is given, but arm/robot is {config.arm.robot}: only a simulated world can be chosen"
        )
    name = config.session.name or _session_name(config)
    root = os.path.realpath(session_root(config))
    config = replace(config, session=replace(config.session, name=name, root=root))
    check_session(config)
    return config


def merge_config(
    profile: str,
    changes: Mapping[str, Dict[str, Any]],
    robot_profile: str = "",
    recorded: Optional[Mapping[str, Any]] = None,
) -> Config:
    """Return the configuration of resolve_config() without checking session and world. Raises ConfigError."""
    profile, robot_profile = unset_to_empty(profile), unset_to_empty(robot_profile)
    return Config.from_dict(merge(_base(profile, robot_profile, changes, dict(recorded or {})), dict(changes)))


def unset_to_empty(value: str) -> str:
    """Return the value of a launch argument; empty if it is unset."""
    return "" if value == UNSET else value


def require_arguments(values: Mapping[str, str]) -> None:
    """Check that launch arguments are given. Raises ConfigError."""
    for name, value in values.items():
        if not unset_to_empty(value):
            raise ConfigError(f"{name} is missing: give {name}:={_PLACEHOLDERS.get(name, 'VALUE')}")


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

    A new session whose launch connects to a Panda needs a robot profile: the shipped one has the table at the height of
    the base and no camera mount. bringups: values of bringup that the launch file takes.
    """
    if bringup not in bringups:
        raise ConfigError(f"bringup is {short_repr(bringup)}: expected one of {', '.join(bringups)}")
    if config.arm.robot == RECORDED and bringup != "none":
        raise ConfigError("arm/robot is recording, which has no arm: use replay.launch")
    if config.arm.robot == FRANKA and bringup == "all" and not unset_to_empty(robot_ip):
        raise ConfigError(
            "robot_ip is missing: give the address of the Panda's controller, such as robot_ip:=172.16.0.2, or "
            "bringup:=nodes if franka_ros and the camera driver are running"
        )
    if config.arm.robot == FRANKA and bringup == "all" and not (unset_to_empty(robot_profile) or config.session.resume):
        raise ConfigError(
            "robot_profile is missing: copy config/franka.yaml, enter the height of your table and the mount of your "
            "camera (docs/panda.md), and give robot_profile:=YOUR_FILE.yaml"
        )
    if config.arm.robot in REAL_ROBOTS and arm_id not in ("", config.franka.arm_id):
        raise ConfigError(
            f"arm_id is {short_repr(arm_id)}, but the robot profile has franka/arm_id {config.franka.arm_id}: give "
            f"arm_id:={config.franka.arm_id}, or correct the robot profile"
        )


def _with_world(config: Config) -> Config:
    """Check the world, and fill in its path."""
    world = os.path.realpath(find_world(config.simulation.world))
    load_world(world, config.workspace.box(), config.camera)
    return replace(config, simulation=replace(config.simulation, world=world))


def _base(
    profile: str, robot_profile: str, changes: Mapping[str, Dict[str, Any]], stored: Dict[str, Any]
) -> Dict[str, Any]:
    """Return the sections that the overrides apply to. stored: settings of a recording, if any."""
    folder = package_folder(PACKAGE) / "config"
    # Not a whole configuration, because relations between settings may hold only with the profile.
    given = check_keys(Config, {section: changes.get(section, {}) for section in ("session", "arm")})
    session, robot = SessionConfig(**given["session"]), given["arm"].get("robot", SIMULATED)
    if session.resume:
        if not session.name:
            root = session_root(Config(session=session))
            raise SessionError(f"session/name is missing: resume:=true needs session:=NAME; {known_sessions(root)}")
        path = session_path(Config(session=session))
        if path.is_dir():
            stored = Session.open_read_only(path).config.to_dict()
    base = stored if stored and not profile else merge(stored, load_profile(find_profile(profile or "default", folder)))
    if not robot_profile and not stored and robot in REAL_ROBOTS:
        robot_profile = ARMS[robot].profile
    return merge(base, load_profile(find_profile(robot_profile, folder))) if robot_profile else base


def _session_name(config: Config) -> str:
    """Return a valid session name for any name of the world."""
    simulated = config.arm.robot == SIMULATED
    world = Path(config.simulation.world).stem if simulated else config.arm.robot
    exploration = config.exploration
    explorer = exploration.explorer.rpartition(":")[2].lower()[:20]
    rest = f"-{explorer}-seed{exploration.seed}-{time.strftime('%Y%m%d-%H%M%S')}"
    stem = re.sub("[^a-z0-9]+", "-", world.lower()).strip("-")[: min(20, MAX_NAME_LENGTH - len(rest))] or "world"
    return check_name(f"{stem}{rest}")


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
