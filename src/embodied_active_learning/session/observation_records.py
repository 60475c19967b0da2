"""Observation records of fixed size with a checksum, and the append-only file that holds them."""

from __future__ import annotations

import json
import logging
import os
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Iterator, Optional, Tuple

import numpy as np

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import FileReader, open_regular_file
from embodied_active_learning.schema import build, required, to_plain
from embodied_active_learning.session import lock
from embodied_active_learning.session.atomic import sync_folder, write_text
from embodied_active_learning.workspace import STATE_NAMES

FORMAT = "embodied_active_learning/observations"
VERSION = 1
_CHECKSUM_BYTES = 4
_LARGEST = 4096  # px, as in the configuration
_REMEDY = "restore the file, or start a new session"
_READER = FileReader(CorruptFileError, "restore the file, or choose another session", limit=2**16)
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class _LayoutFile:
    """The fields of format.json."""

    format: str = required("kind of the file")
    version: int = required("version of the format")
    image_shape: Tuple[int, ...] = required("height, width, channels", "px", low=1, high=_LARGEST, length=3)
    state_names: Tuple[str, ...] = required("names of the state dimensions")
    record_bytes: int = required("size of a record")


@dataclass(frozen=True)
class RecordLayout:
    """Little-endian records: index, stamp [s], state (D,) SI units, image (H, W, 3), CRC-32 of all before it."""

    image_shape: Tuple[int, ...]
    state_names: Tuple[str, ...] = STATE_NAMES

    @cached_property
    def dtype(self) -> np.dtype:
        """One record as a packed structured type."""
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
        """Return the bytes of one record."""
        record = np.zeros((), self.dtype)
        record["index"], record["stamp"], record["state"], record["image"] = index, stamp, state, image
        record["crc32"] = _checksum(record.tobytes())
        return record.tobytes()

    def unpack(self, raw: bytes, index: int) -> Optional[np.void]:
        """Return the record of that index, or None if the bytes are incomplete or damaged."""
        if len(raw) != self.size:
            return None
        record: np.void = np.frombuffer(raw, self.dtype)[0]
        intact = record["crc32"] == _checksum(raw) and record["index"] == index
        return record if intact else None

    def save(self, path: Path) -> None:
        """Write the layout as JSON."""
        content = _LayoutFile(FORMAT, VERSION, self.image_shape, self.state_names, self.size)
        write_text(path, json.dumps(to_plain(content), indent=2) + "\n")

    @classmethod
    def load(cls, path: Path) -> RecordLayout:
        """Read a layout. Raises CorruptFileError naming the file, the field and the expected value."""
        stored = _READER.read_json(path)
        _READER.expect(path, stored, {"format": FORMAT})
        _READER.expect_version(path, stored, VERSION)
        content = build(_LayoutFile, stored, path, CorruptFileError, _READER.remedy)
        height, width, _ = content.image_shape
        layout = cls((height, width, 3))
        _READER.expect(path, stored, {name: to_plain(getattr(layout, name)) for name in ("image_shape", "state_names")})
        _READER.expect(path, stored, {"record_bytes": layout.size})
        return layout


class RecordFile:
    """Records 0, 1, 2, ... in one file. One process writes it and holds its lock.

    Complete records survive any crash; an incomplete one at the end is removed by the next writer.
    """

    def __init__(self, path: Path, layout: RecordLayout, writable: bool) -> None:
        self.path = path
        self.layout = layout
        try:
            self._stream = open_regular_file(path, "r+b" if writable else "rb")
            if writable:
                sync_folder(path.parent)  # the file may be new
        except OSError as error:
            raise CorruptFileError(f"{path} cannot be opened ({error.strerror}): {_REMEDY}") from error
        if writable:
            try:
                lock.claim(self._stream, path)
            except SessionError:
                self._stream.close()
                raise

    def read(self, start: int = 0) -> Iterator[np.void]:
        """Yield all complete records from number start on. Raises CorruptFileError for a damaged one before the end."""
        size = os.fstat(self._stream.fileno()).st_size
        for index in range(start, size // self.layout.size):
            offset = index * self.layout.size
            record = self.layout.unpack(self._bytes_at(offset), index)
            if record is not None:
                yield record
            elif offset + self.layout.size < size:
                raise CorruptFileError(f"{self.path}: record {index} is damaged (crc32): {_REMEDY}")

    def cut_after(self, count: int) -> None:
        """Remove everything after the first `count` records: an interrupted write, which was not acknowledged."""
        descriptor = self._stream.fileno()
        incomplete = os.fstat(descriptor).st_size - count * self.layout.size
        if incomplete:
            _LOG.warning("%s: removed %d bytes of the incomplete record %d", self.path, incomplete, count)
            try:
                os.ftruncate(descriptor, count * self.layout.size)
                os.fsync(descriptor)
            except OSError as error:
                raise SessionError(f"{self.path} cannot be written ({error.strerror}): check the disk") from error

    def write(self, index: int, raw: bytes) -> None:
        """Write a record to the disk. After a SessionError the same record can be written again."""
        # At its own offset, so that a retry overwrites an incomplete attempt.
        offset, rest = index * self.layout.size, memoryview(raw)
        try:
            while rest:
                written = os.pwrite(self._stream.fileno(), rest, offset)
                offset, rest = offset + written, rest[written:]
            os.fdatasync(self._stream.fileno())
        except OSError as error:
            raise SessionError(
                f"{self.path}: record {index} could not be stored ({error.strerror}): free disk space and send the "
                "observation again"
            ) from error

    def close(self) -> None:
        """Close the file and release its lock."""
        self._stream.close()

    def _bytes_at(self, offset: int) -> bytes:
        """Return the bytes of one record, fewer at the end of the file."""
        try:
            return os.pread(self._stream.fileno(), self.layout.size, offset)
        except OSError as error:
            raise CorruptFileError(f"{self.path} cannot be read ({error.strerror}): {_REMEDY}") from error


def _checksum(raw: bytes) -> int:
    return zlib.crc32(memoryview(raw)[:-_CHECKSUM_BYTES])
