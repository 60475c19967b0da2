"""YAML files with a checksum of their content, which detects changed digits as well as truncation."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Dict

import yaml

from embodied_active_learning.files import FileReader
from embodied_active_learning.session.atomic import write_text

# A single changed bit cannot turn this word into a comment that hides the line.
CHECKSUM = "sha256"


def write_checksummed(path: Path, content: Dict[str, Any]) -> None:
    """Write plain fields and their checksum atomically."""
    write_text(path, checksummed_text(content))


def checksummed_text(content: Dict[str, Any]) -> str:
    """Return plain fields and their checksum as YAML."""
    return yaml.safe_dump({**content, CHECKSUM: _digest(content)}, sort_keys=False)


def read_checksummed(path: Path, reader: FileReader, file_format: str = "", version: int = 1) -> Dict[str, Any]:
    """Read a file of write_checksummed.

    Args:
        path: The file.
        reader: Error class and remedy.
        file_format: Expected `format` field; empty for files without format and version.
        version: Expected `version` field.

    Returns:
        The fields without the checksum.

    Raises:
        reader.error: The file is malformed, damaged, or of another version.
    """
    content = reader.read_yaml(path)
    if file_format:
        reader.expect(path, content, {"format": file_format})
        reader.expect_version(path, content, version)
    fields = {name: value for name, value in content.items() if name != CHECKSUM}
    if CHECKSUM not in content:
        raise reader.make_error(f"{path}:", f"{CHECKSUM} is missing, so the end of the file was lost")
    if content[CHECKSUM] != _digest(fields):
        raise reader.make_error(f"{path}:", f"{CHECKSUM} does not match, so the file was changed after it was written")
    return fields


def _digest(content: Dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode("utf-8")).hexdigest()
