"""The configuration of a recorded run, stored in its bag as YAML text."""

from __future__ import annotations

from typing import Any, Dict

import yaml

from embodied_active_learning.config import CONFIG_VERSION, Config
from embodied_active_learning.files import MAX_YAML_SIZE, parse_yaml, short_repr


def settings_text(config: Config) -> str:
    """Return the configuration as YAML, without the recording computer's paths."""
    return yaml.safe_dump({"version": CONFIG_VERSION, **config.portable()}, sort_keys=False)


def read_settings(text: str) -> Dict[str, Any]:
    """Parse the output of settings_text into sections of keys.

    Raises:
        ValueError: The text is malformed, or of another version.
    """
    if len(text) > MAX_YAML_SIZE:
        raise ValueError(f"it has {len(text)} characters, {MAX_YAML_SIZE} are allowed")
    stored = parse_yaml(text)
    version = stored.pop("version", None) if isinstance(stored, dict) else None
    if version != CONFIG_VERSION:
        raise ValueError(f"version is {short_repr(version)}, but this package reads version {CONFIG_VERSION} only")
    values = Config.from_dict(stored).to_dict()
    values.pop("session")
    return values
