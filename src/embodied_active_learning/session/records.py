"""The bytes of one stored observation, and the small file that says how they are laid out."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Dict, Optional, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.session.atomic import write_text
from embodied_active_learning.workspace import STATE_NAMES

FORMAT = "embodied_active_learning/observations"
VERSION = 1
_CHECKSUM_BYTES = 4


@dataclass(frozen=True)
class RecordLayout:
    """Fixed-size little-endian records: index, stamp [s], state (D,) SI, image (H, W, 3), CRC-32 of all before it."""

    image_shape: Tuple[int, ...]
    state_names: Tuple[str, ...] = STATE_NAMES

    @cached_property
    def dtype(self) -> np.dtype:
        """One record as a structured numpy type, packed."""
        return np.dtype(
            [
                ("index", "<u8"),
                ("stamp", "<f8"),
                ("state", "<f8", (len(self.state_names),)),
                ("image", "u1", self.image_shape),
                ("crc32", "<u4"),
            ]
        )

    @property
    def size(self) -> int:
        """Bytes of one record."""
        return self.dtype.itemsize

    def pack(self, index: int, stamp: float, state: np.ndarray, image: np.ndarray) -> bytes:
        """One observation as the bytes of a record."""
        record = np.zeros((), self.dtype)
        record["index"], record["stamp"], record["state"], record["image"] = index, stamp, state, image
        record["crc32"] = _checksum(record.tobytes())
        return record.tobytes()

    def unpack(self, raw: bytes, index: int) -> Optional[np.void]:
        """The record of that index, or None when the bytes are not what pack made of it."""
        if len(raw) != self.size:
            return None
        record = np.frombuffer(raw, self.dtype)[0]
        intact = record["crc32"] == _checksum(raw) and record["index"] == index
        return record if intact else None

    def save(self, path: Path) -> None:
        """Write the layout as JSON."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "image_shape": list(self.image_shape),
            "state_names": list(self.state_names),
            "record_bytes": self.size,
        }
        write_text(path, json.dumps(content, indent=2) + "\n")

    @classmethod
    def load(cls, path: Path) -> RecordLayout:
        """Read a layout. Raises CorruptFileError naming the file, the field and what was expected."""
        content = _read_json(path)
        _expect(path, content, "format", FORMAT)
        _expect(path, content, "version", VERSION)
        shape, names = content.get("image_shape"), content.get("state_names")
        if not (isinstance(shape, list) and len(shape) == 3 and all(type(n) is int and n > 0 for n in shape)):
            raise CorruptFileError(f"{path}: image_shape is {shape!r}, expected [height, width, 3]: {_REMEDY}")
        if not (isinstance(names, list) and names and all(isinstance(name, str) for name in names)):
            raise CorruptFileError(f"{path}: state_names is {names!r}, expected a list of names: {_REMEDY}")
        layout = cls(image_shape=tuple(shape), state_names=tuple(names))
        _expect(path, content, "record_bytes", layout.size)
        return layout


_REMEDY = "restore the file, or choose another session"


def _checksum(raw: bytes) -> int:
    return zlib.crc32(memoryview(raw)[:-_CHECKSUM_BYTES])


def _read_json(path: Path) -> Dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise CorruptFileError(f"{path} is missing: {_REMEDY}") from error
    except ValueError as error:
        raise CorruptFileError(f"{path} is not JSON ({error}): {_REMEDY}") from error
    if not isinstance(content, dict):
        raise CorruptFileError(f"{path} is a {type(content).__name__}, expected fields: {_REMEDY}")
    return content


def _expect(path: Path, content: Dict[str, Any], field: str, expected: Any) -> None:
    found = content.get(field)
    if found != expected:
        raise CorruptFileError(f"{path}: {field} is {found!r}, expected {expected!r}: {_REMEDY}")
