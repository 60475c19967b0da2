"""The configuration of a recorded run, stored in its bag as YAML text."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict

import yaml

from embodied_active_learning.config import Config
from embodied_active_learning.files import LARGEST_YAML, parse_yaml


def settings_text(config: Config) -> str:
    """Return the configuration as YAML, without the recording computer's paths."""
    values = config.to_dict()
    values.pop("session")
    values["simulation"]["world"] = Path(config.simulation.world).stem
    return yaml.safe_dump(values, sort_keys=False)


def read_settings(text: str) -> Dict[str, Any]:
    """Parse the output of settings_text into sections of keys. Raises ValueError if malformed or of another version."""
    if len(text) > LARGEST_YAML:
        raise ValueError(f"it has {len(text)} characters, {LARGEST_YAML} are allowed")
    values = Config.from_dict(parse_yaml(text)).to_dict()
    values.pop("session")
    return values
