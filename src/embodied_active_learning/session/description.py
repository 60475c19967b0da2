"""config.yaml of a session: the whole resolved configuration, and which package wrote it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, List, Tuple

from embodied_active_learning import __version__
from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, CorruptFileError
from embodied_active_learning.files import FileReader
from embodied_active_learning.session.checksummed_yaml import check_version, remove_seal, write_sealed

FORMAT = "embodied_active_learning/session"
VERSION = 2  # since it has a checksum

_READER = FileReader(CorruptFileError, "restore it, or choose another session")

# What the stored observations and weights depend on; everything else may change when a session is continued.
FIXED: Tuple[Tuple[str, Tuple[str, ...]], ...] = (
    ("workspace", ()),
    ("camera", ("width", "height", "field_of_view", "distance")),
    ("arm", ("robot",)),
    ("franka", ("table_height", "camera_position", "camera_rotation")),
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
    write_sealed(path, content)


def read_description(path: Path) -> Config:
    """The configuration of a run. Raises CorruptFileError naming the file and the field."""
    content = _READER.read_yaml(path)
    _READER.expect(path, content, {"format": FORMAT})
    check_version(path, content, VERSION, _READER)
    content = remove_seal(path, content, _READER)
    try:
        return Config.from_dict(content.get("config"))
    except ConfigError as error:
        raise _READER.refuse(f"{path}:", str(error)) from error


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
