"""The bytes of one stored observation, and the small file that says how they are laid out."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Optional, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.files import FileReader, shown
from embodied_active_learning.session.atomic import write_text
from embodied_active_learning.workspace import STATE_NAMES

FORMAT = "embodied_active_learning/observations"
VERSION = 1
_CHECKSUM_BYTES = 4
_LARGEST = 4096  # px, as in the configuration
_READER = FileReader(CorruptFileError, "restore the file, or choose another session", limit=2**16)


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
        content = _READER.read_json(path)
        _READER.expect(path, content, {"format": FORMAT, "version": VERSION})
        shape = content.get("image_shape")
        if not _is_image_shape(shape):
            raise _READER.refuse(
                f"{path}:", f"image_shape is {shown(shape)}, expected [height, width, 3] of at most {_LARGEST} px"
            )
        _READER.expect(path, content, {"state_names": list(STATE_NAMES)})
        layout = cls(image_shape=tuple(shape))
        _READER.expect(path, content, {"record_bytes": layout.size})
        return layout


def _is_image_shape(shape: Any) -> bool:
    if not (isinstance(shape, list) and len(shape) == 3 and all(type(size) is int for size in shape)):
        return False
    return shape[2] == 3 and all(0 < size <= _LARGEST for size in shape)


def _checksum(raw: bytes) -> int:
    return zlib.crc32(memoryview(raw)[:-_CHECKSUM_BYTES])
