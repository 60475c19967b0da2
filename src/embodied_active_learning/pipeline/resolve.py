"""Combine profile and overrides into the configuration of a run, checked against world and session."""

from __future__ import annotations

import os
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Mapping, Optional

from embodied_active_learning.config import (
    REAL_ROBOTS,
    SIMULATED,
    Config,
    SessionConfig,
    find_profile,
    load_profile,
    merge,
)
from embodied_active_learning.errors import ConfigError, SessionError
from embodied_active_learning.files import short_repr
from embodied_active_learning.hardware_config import ARMS
from embodied_active_learning.naming import MAX_NAME_LENGTH, check_name
from embodied_active_learning.schema import check_keys
from embodied_active_learning.session.session import Session, check_session, known_sessions, session_path, session_root
from embodied_active_learning.simulation.resources import PACKAGE, package_folder
from embodied_active_learning.simulation.world import find_world, load_world


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
        if robot_profile:
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
    return Config.from_dict(merge(_base(profile, robot_profile, changes, dict(recorded or {})), dict(changes)))


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
