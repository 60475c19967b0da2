"""config.yaml of a session: the whole resolved configuration, and which package wrote it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Dict, List, Tuple

import yaml

from embodied_active_learning import __version__
from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, CorruptFileError
from embodied_active_learning.session.atomic import write_text

FORMAT = "embodied_active_learning/session"
VERSION = 1

# What the stored observations and weights depend on; everything else may change when a session is continued.
FIXED: Tuple[Tuple[str, Tuple[str, ...]], ...] = (
    ("workspace", ()),
    ("camera", ("width", "height", "field_of_view", "distance")),
    ("model", ()),
    ("simulation", ("world",)),
    ("exploration", ("explorer", "seed")),
)


def write_description(path: Path, config: Config) -> None:
    """Write the configuration of a run atomically."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "package_version": __version__,
        "written": time.strftime("%Y-%m-%d %H:%M:%S %z"),
        "config": config.to_dict(),
    }
    write_text(path, yaml.safe_dump(content, sort_keys=False))


def read_description(path: Path) -> Config:
    """The configuration of a run. Raises CorruptFileError naming the file and the field."""
    content = _read_yaml(path)
    for field, expected in (("format", FORMAT), ("version", VERSION)):
        if content.get(field) != expected:
            raise CorruptFileError(
                f"{path}: {field} is {content.get(field)!r}, expected {expected!r}: it is no session of this package's "
                f"version {__version__}; choose another folder"
            )
    try:
        return Config.from_dict(content.get("config"))
    except ConfigError as error:
        raise CorruptFileError(f"{path}: {error}") from error


def is_description(path: Path) -> bool:
    """Whether a file is the description of a session that can be read."""
    try:
        read_description(path)
    except CorruptFileError:
        return False
    return True


def changed_keys(stored: Config, wanted: Config) -> List[str]:
    """What keeps `wanted` from continuing a session with the `stored` configuration, in words; empty when nothing."""
    before, after = stored.to_dict(), wanted.to_dict()
    changes = []
    for section, keys in FIXED:
        for key in keys or before[section]:
            old, new = before[section][key], after[section][key]
            if _comparable(key, old) != _comparable(key, new):
                changes.append(f"{section}/{key} is {new!r} but the session has {old!r}")
    return changes


def _comparable(key: str, value: Any) -> Any:
    # The same world may lie elsewhere after a new installation.
    return Path(value).stem if key == "world" else value


def _read_yaml(path: Path) -> Dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CorruptFileError(f"{path} cannot be read ({error.strerror}): choose another session") from error
    except (yaml.YAMLError, ValueError) as error:
        raise CorruptFileError(f"{path} is not plain YAML ({error}): restore it, or choose another session") from error
    if not isinstance(content, dict):
        raise CorruptFileError(f"{path} is a {type(content).__name__}, expected fields: choose another session")
    return content
