"""The configuration of a recorded run, stored in its bag as YAML text."""

from __future__ import annotations

from typing import Any, Dict

import yaml

from embodied_active_learning.config import Config
from embodied_active_learning.config_versions import CONFIG_VERSION, FIRST_BAG_VERSION
from embodied_active_learning.files import MAX_YAML_SIZE, parse_yaml, short_repr


def settings_text(config: Config) -> str:
    """Return the configuration as YAML, without the recording computer's paths."""
    return yaml.safe_dump({"version": CONFIG_VERSION, **config.portable()}, sort_keys=False)


def read_settings(text: str) -> Dict[str, Any]:
    """Parse the output of settings_text, of this or an older version, into sections of keys.

    Raises:
        ValueError: The text is malformed, or stored by a newer version.
    """
    if len(text) > MAX_YAML_SIZE:
        raise ValueError(f"it has {len(text)} characters, {MAX_YAML_SIZE} are allowed")
    stored = parse_yaml(text)
    version = stored.pop("version", FIRST_BAG_VERSION) if isinstance(stored, dict) else FIRST_BAG_VERSION
    if type(version) is not int:
        raise ValueError(f"version is {short_repr(version)}: expected a whole number")
    values = Config.from_stored(stored, version).to_dict()
    values.pop("session")
    return values
