"""From a profile and overrides to the configuration of one run, checked against world and session."""

from __future__ import annotations

import os
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Sequence

from embodied_active_learning.config import Config, find_profile, load_profile, merge, settings
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.reading import parse_yaml, shown
from embodied_active_learning.session.names import LONGEST_NAME, check_name
from embodied_active_learning.session.session import Session, check_session, session_path, session_root
from embodied_active_learning.simulation.resources import PACKAGE, package_folder
from embodied_active_learning.simulation.world import find_world, load_world


def resolve(profile: str, overrides: Sequence[str]) -> Config:
    """The configuration of one run: a profile (name in config/, or path) with SECTION/KEY=VALUE overrides.

    No profile is the paper's, or for a session that is resumed the configuration that it was made with. An override
    without a value changes nothing. The world's path and the session's name are filled in. Raises ConfigError,
    WorldError or SessionError, for whatever would keep the run from starting.
    """
    changes: Dict[str, Dict[str, Any]] = {}
    for override in overrides:
        changes = merge(changes, _parse_override(override))
    config = Config.from_dict(merge(_base(profile, changes), changes))
    world = Path(os.path.realpath(find_world(config.simulation.world)))
    load_world(str(world), config.workspace.box())
    simulation = replace(config.simulation, world=str(world))
    name = config.session.name or _session_name(config, world.stem)
    root = os.path.realpath(session_root(config))
    config = replace(config, simulation=simulation, session=replace(config.session, name=name, root=root))
    check_session(config)
    return config


def _base(profile: str, changes: Dict[str, Dict[str, Any]]) -> Dict[str, Any]:
    """What the overrides apply to."""
    given = Config.from_dict({"session": changes.get("session", {})})
    stored: Dict[str, Any] = {}
    if given.session.resume:
        path = session_path(given)
        if path.is_dir():
            stored = Session.open_read_only(path).config.to_dict()
    if not profile and stored:
        return stored
    return merge(stored, load_profile(find_profile(profile or "paper", package_folder(PACKAGE) / "config")))


def _session_name(config: Config, world: str) -> str:
    """A legal name, however the world is called, and however long explorer and seed are."""
    exploration = config.exploration
    rest = f"-{exploration.explorer}-seed{exploration.seed}-{time.strftime('%Y%m%d-%H%M%S')}"
    stem = re.sub("[^a-z0-9]+", "-", world.lower()).strip("-")[: min(20, LONGEST_NAME - len(rest))] or "world"
    return check_name(f"{stem}{rest}")


def _parse_override(text: str) -> Dict[str, Dict[str, Any]]:
    path, equals, value = text.partition("=")
    section, slash, key = path.partition("/")
    if not (equals and slash and section and key):
        raise ConfigError(f"override {shown(text)} is not of the form section/key=value")
    if not value:
        return {}
    try:
        return {section: {key: value if _is_text(section, key) else parse_yaml(value)}}
    except ValueError as error:
        raise ConfigError(f"override {shown(text)} has a value that is not plain YAML ({error})") from error


def _is_text(section: str, key: str) -> bool:
    """Whether the setting is a text, which must not be read as YAML: a session may be called 1e3."""
    return any(isinstance(item.default, str) for name, item in settings() if (name, item.name) == (section, key))
