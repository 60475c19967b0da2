"""config.yaml of a session: the complete configuration, and the package version that wrote it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, List

from embodied_active_learning import __version__
from embodied_active_learning.config import CONFIG_VERSION, Config
from embodied_active_learning.errors import ConfigError, CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.schema import build, settings, to_plain
from embodied_active_learning.session.checksummed_yaml import read_checksummed, write_checksummed

FORMAT = "embodied_active_learning/session"

_READER = FileReader(CorruptFileError, "restore it, or choose another session")


@dataclass(frozen=True)
class _StoredConfig:
    """The fields of the file."""

    format: str
    version: int
    package_version: str
    written: str
    config: Any


def write_stored_config(path: Path, config: Config) -> None:
    """Write the configuration of a run atomically."""
    written = time.strftime("%Y-%m-%d %H:%M:%S %z")
    write_checksummed(path, to_plain(_StoredConfig(FORMAT, CONFIG_VERSION, __version__, written, to_plain(config))))


def read_stored_config(path: Path) -> Config:
    """Read the configuration of a run.

    Raises:
        CorruptFileError: The file is damaged or of another version; names the file and the field.
    """
    content = read_checksummed(path, _READER, FORMAT, CONFIG_VERSION)
    found = build(_StoredConfig, content, path, CorruptFileError, _READER.remedy)
    try:
        return Config.from_dict(found.config, stored=True)
    except ConfigError as error:
        raise CorruptFileError(
            f"{path}: {error}; the session was written by embodied_active_learning {found.package_version}: open it "
            "with that version, restore the file, or choose another session"
        ) from error


def is_stored_config(path: Path) -> bool:
    """Return whether a file is a readable configuration of a session."""
    try:
        read_stored_config(path)
    except CorruptFileError:
        return False
    return True


def changed_keys(stored: Config, wanted: Config) -> List[str]:
    """Return the differences that prevent a session from being continued with another configuration."""
    before, after = stored.to_dict(), wanted.to_dict()
    changes = []
    for section, item in settings(Config):
        key = item.name
        old, new = before[section][key], after[section][key]
        if item.metadata["fixed"] and _comparable(key, old) != _comparable(key, new):
            changes.append(f"{section}/{key} is {new!r} but the session has {old!r}")
    return changes


def _comparable(key: str, value: Any) -> Any:
    # A new installation may store the same world in another folder.
    return Path(value).stem if key == "world" else value
