"""YAML files with a checksum of their own content: a digit that has changed on the disk is not taken for a setting."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Dict

import yaml

from embodied_active_learning.files import FileReader
from embodied_active_learning.session.atomic import write_text

# No single changed bit makes a comment of this word, which would hide the line.
SEAL = "sha256"


def write_sealed(path: Path, content: Dict[str, Any]) -> None:
    """Write plain fields and their checksum atomically."""
    write_text(path, sealed_text(content))


def sealed_text(content: Dict[str, Any]) -> str:
    """Plain fields and their checksum as YAML."""
    return yaml.safe_dump({**content, SEAL: _digest(content)}, sort_keys=False)


def check_version(path: Path, content: Dict[str, Any], version: int, reader: FileReader) -> None:
    """Refuse a file of another version than this one, and than version 1, which had no checksum."""
    if type(content.get("version")) is not int or content["version"] not in (1, version):
        reader.expect(path, content, {"version": version})


def remove_seal(path: Path, content: Dict[str, Any], reader: FileReader) -> Dict[str, Any]:
    """The fields without their checksum, which must be right; only files of version 1 and of none may lack it."""
    if content.get("version", 1) != 1 and SEAL not in content:
        raise reader.refuse(f"{path}:", f"{SEAL} is missing, so the end of the file was lost")
    fields = {field: value for field, value in content.items() if field != SEAL}
    if SEAL in content and content[SEAL] != _digest(fields):
        raise reader.refuse(f"{path}:", f"{SEAL} does not fit the rest, so the file was changed after it was written")
    return fields


def _digest(content: Dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode("utf-8")).hexdigest()
