"""From a profile and overrides to the configuration of one run, checked against world and session."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Sequence

import yaml

from embodied_active_learning.config import Config, find_profile, load_profile, merge, settings
from embodied_active_learning.errors import ConfigError
from embodied_active_learning.session.session import check_session
from embodied_active_learning.simulation.world import load_world


def resolve(profile: str, overrides: Sequence[str], profiles: Path) -> Config:
    """The configuration of a profile (name in the folder profiles, or path) with SECTION/KEY=VALUE overrides.

    The world's path and the session's name are filled in. Raises ConfigError, WorldError or SessionError.
    """
    values = load_profile(find_profile(profile, profiles))
    for override in overrides:
        values = merge(values, _parse_override(override))
    config = Config.from_dict(values)
    world = load_world(config.simulation.world, config.workspace.box())
    simulation = replace(config.simulation, world=str(world.path))
    name = config.session.name or _session_name(config, world.path.stem)
    root = str(Path(config.session.root).expanduser().resolve())
    config = replace(config, simulation=simulation, session=replace(config.session, name=name, root=root))
    check_session(config)
    return config


def _session_name(config: Config, world: str) -> str:
    exploration = config.exploration
    return f"{world}-{exploration.explorer}-seed{exploration.seed}-{time.strftime('%Y%m%d-%H%M%S')}".lower()


def _parse_override(text: str) -> Dict[str, Dict[str, Any]]:
    path, equals, value = text.partition("=")
    section, slash, key = path.partition("/")
    if not (equals and slash and section and key):
        raise ConfigError(f"override {text!r} is not of the form section/key=value")
    return {section: {key: value if _is_text(section, key) else yaml.safe_load(value)}}


def _is_text(section: str, key: str) -> bool:
    """Whether the setting is a text, which must not be read as YAML: a session may be called 1e3."""
    return any(isinstance(item.default, str) for name, item in settings() if (name, item.name) == (section, key))
