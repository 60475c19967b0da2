"""Write ROS bags: under a temporary name until closed, and never over an existing file."""

from __future__ import annotations

import os
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Iterator, Optional

import genpy
import rosbag

from embodied_active_learning.errors import BagError
from embodied_active_learning.session.atomic import sync_folder

ACTIVE = ".active"
"""Suffix of a bag being written, as used by rosbag; it remains if the recorder is killed."""
_FIRST_INSTANT = genpy.Time(0, 1)  # rosbag accepts no earlier time


class BagWriter:
    """Writes one bag; thread-safe. Raises BagError if the disk fails, and writes nothing afterwards."""

    def __init__(self, path: Path, compression: str = rosbag.Compression.NONE) -> None:
        """Create the bag. Raises BagError if it exists."""
        self.path = Path(path)
        self.messages = 0
        self._active = self.path.with_name(f"{self.path.name}{ACTIVE}")
        self._lock = threading.Lock()
        for taken in (self.path, self._active):
            if os.path.lexists(taken):
                raise BagError(f"{taken} exists: choose another name, or move it away")
        with self._disk_errors():
            self._stream = open(self._active, "x+b")  # noqa: SIM115  closed by close()
            self._bag: Optional[rosbag.Bag] = rosbag.Bag(self._stream, "w", compression=compression)

    @property
    def size(self) -> int:
        """Bytes written so far."""
        with suppress(OSError):
            return (self._active if self._bag is not None else self.path).stat().st_size
        return 0

    def write(self, topic: str, message: genpy.Message, time: genpy.Time, latched: bool = False) -> None:
        """Append a message published at a time; does nothing after close().

        latched: whether rosbag play should latch the message.
        """
        kind = type(message)
        header = {"topic": topic, "type": kind._type, "md5sum": kind._md5sum, "message_definition": kind._full_text}
        if latched:
            header["latching"] = "1"
        with self._lock:
            if self._bag is None:
                return
            with self._disk_errors():
                self._bag.write(topic, message, max(time, _FIRST_INSTANT), connection_header=header)
            self.messages += 1

    def close(self) -> None:
        """Write the index and rename the bag to its final name; a second call does nothing."""
        with self._lock:
            bag, self._bag = self._bag, None
            if bag is None:
                return
            with self._disk_errors():
                bag.close()
                self._stream.close()
                os.rename(self._active, self.path)
                sync_folder(self.path.parent)

    def discard(self) -> None:
        """Delete the bag."""
        with self._lock:
            self._bag = None
            with suppress(OSError):
                self._stream.close()
                self._active.unlink()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: Optional[type], *rest: object) -> None:
        """Close the bag, or delete it after an exception."""
        if kind is None:
            self.close()
        else:
            self.discard()

    @contextmanager
    def _disk_errors(self) -> Iterator[None]:
        """Turn OSError into BagError with the file's name."""
        try:
            yield
        except OSError as error:
            self._bag = None
            raise BagError(
                f"cannot write {self._active}: {error.strerror}; check the disk, and recover the bag with "
                "rosbag reindex"
            ) from error
