"""Stored configurations of older versions: keys that were renamed since.

A session and a recorded bag store the whole configuration with its version. Add a version here when a key is renamed
or removed; a new key needs none, because it gets its default.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping, Optional

from embodied_active_learning.errors import ConfigError

CONFIG_VERSION = 6
FIRST_BAG_VERSION = 2
"""Version of the configuration in bags that do not state one."""

_RENAMED: Mapping[int, Mapping[str, Optional[str]]] = {
    3: {
        "identification/mismatch_limit": "identification/residual_limit",
        "identification/min_rise": "identification/min_prominence",
    },
    4: {
        "identification/residual_limit": None,
        "identification/agreement_distance": None,
        "identification/min_agreement": None,
        "identification/min_prominence": None,
        "identification/object_radius": None,
        "identification/min_views": None,
    },
    5: {"training/active_unit_threshold": None},
    6: {"identification/trials": "fingerprint/trials"},
}
"""Version -> old key -> its name since that version, or None if it was removed."""


def upgrade(values: Any, version: int) -> Any:
    """Return sections of keys that a version stored, with today's names; anything but sections is returned as it is.

    Raises:
        ConfigError: The version is unknown.
    """
    if not 1 <= version <= CONFIG_VERSION:
        raise ConfigError(
            f"version {version} of the configuration is unknown: this package reads versions 1 to {CONFIG_VERSION}; "
            "install the version of embodied_active_learning that stored it"
        )
    if not isinstance(values, dict):
        return values
    upgraded: Dict[Any, Any] = {name: dict(keys) if isinstance(keys, dict) else keys for name, keys in values.items()}
    for since in range(version + 1, CONFIG_VERSION + 1):
        for old, new in _RENAMED.get(since, {}).items():
            section, _, key = old.partition("/")
            keys = upgraded.get(section)
            if not isinstance(keys, dict) or key not in keys:
                continue
            value = keys.pop(key)
            if new is not None:
                section, _, key = new.partition("/")
                target = upgraded.setdefault(section, {})
                if isinstance(target, dict):  # else it is reported when the configuration is built
                    target.setdefault(key, value)
    return upgraded
