"""The file of observation records: whole records are kept through any crash, a torn last one is cut off."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Iterator

import numpy as np

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.files import open_plain
from embodied_active_learning.session import lock
from embodied_active_learning.session.atomic import sync_folder
from embodied_active_learning.session.records import RecordLayout

_LOG = logging.getLogger(__name__)
_REMEDY = "restore the file, or start a new session"


class RecordFile:
    """Records number 0, 1, 2 ... one after the other; written by one process, which holds the file's lock."""

    def __init__(self, path: Path, layout: RecordLayout, writable: bool) -> None:
        self.path = path
        self.layout = layout
        try:
            self._stream = open_plain(path, "r+b" if writable else "rb")
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
        """Every whole record from number start on.

        Raises CorruptFileError when one is damaged that can't be a write cut short.
        """
        size = os.fstat(self._stream.fileno()).st_size
        for index in range(start, size // self.layout.size):
            offset = index * self.layout.size
            record = self.layout.unpack(self._bytes_at(offset), index)
            if record is not None:
                yield record
            elif offset + self.layout.size < size:
                raise CorruptFileError(f"{self.path}: record {index} is damaged (crc32): {_REMEDY}")

    def cut_after(self, count: int) -> None:
        """Cut off what follows the first `count` records: a write that was cut short, so never acknowledged."""
        descriptor = self._stream.fileno()
        torn = os.fstat(descriptor).st_size - count * self.layout.size
        if torn:
            _LOG.warning("%s: cut off %d bytes of record %d, which was not complete", self.path, torn, count)
            try:
                os.ftruncate(descriptor, count * self.layout.size)
                os.fsync(descriptor)
            except OSError as error:
                raise SessionError(f"{self.path} cannot be written ({error.strerror}): see to the disk") from error

    def write(self, index: int, raw: bytes) -> None:
        """Bring record number `index` to the disk. Raises SessionError when the disk fails; then write it again."""
        # At its own offset, so that the next attempt overwrites what a failed one left.
        offset, rest = index * self.layout.size, memoryview(raw)
        try:
            while rest:
                written = os.pwrite(self._stream.fileno(), rest, offset)
                offset, rest = offset + written, rest[written:]
            os.fdatasync(self._stream.fileno())
        except OSError as error:
            raise SessionError(
                f"{self.path}: record {index} could not be stored ({error.strerror}): free some disk space and hand "
                "the observation over again"
            ) from error

    def _bytes_at(self, offset: int) -> bytes:
        """One record's bytes, fewer where the file ends."""
        try:
            return os.pread(self._stream.fileno(), self.layout.size, offset)
        except OSError as error:
            raise CorruptFileError(f"{self.path} cannot be read ({error.strerror}): {_REMEDY}") from error

    def close(self) -> None:
        """Close the file and give its lock back."""
        self._stream.close()
