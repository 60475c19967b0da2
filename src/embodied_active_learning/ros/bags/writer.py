"""Writing ROS bags: under a name of its own until the bag is closed, and never over one that is there."""

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
"""What follows the name of a bag that is being written, as rosbag has it; a recorder that is killed leaves it so."""
_FIRST_INSTANT = genpy.Time(0, 1)  # rosbag takes no earlier one


class BagWriter:
    """One bag; any thread may write. Raises BagError when the disk fails; then nothing more is written."""

    def __init__(self, path: Path, compression: str = rosbag.Compression.NONE) -> None:
        """Begin a bag that must not exist."""
        self.path = Path(path)
        self.messages = 0
        self._active = self.path.with_name(f"{self.path.name}{ACTIVE}")
        self._lock = threading.Lock()
        for taken in (self.path, self._active):
            if os.path.lexists(taken):
                raise BagError(f"{taken} exists: choose another name, or move it away")
        with self._told():
            self._stream = open(self._active, "x+b")  # noqa: SIM115  closed by close()
            self._bag: Optional[rosbag.Bag] = rosbag.Bag(self._stream, "w", compression=compression)

    @property
    def size(self) -> int:
        """Bytes written so far."""
        with suppress(OSError):
            return (self._active if self._bag is not None else self.path).stat().st_size
        return 0

    def write(self, topic: str, message: genpy.Message, time: genpy.Time, latched: bool = False) -> None:
        """Append a message as published at a time; after the end of the bag nothing happens.

        latched: whether who plays the bag should keep it for those who come later.
        """
        kind = type(message)
        header = {"topic": topic, "type": kind._type, "md5sum": kind._md5sum, "message_definition": kind._full_text}
        if latched:
            header["latching"] = "1"
        with self._lock:
            if self._bag is None:
                return
            with self._told():
                self._bag.write(topic, message, max(time, _FIRST_INSTANT), connection_header=header)
            self.messages += 1

    def close(self) -> None:
        """Write the index, and give the bag its own name. A second call does nothing."""
        with self._lock:
            bag, self._bag = self._bag, None
            if bag is None:
                return
            with self._told():
                bag.close()
                self._stream.close()
                os.rename(self._active, self.path)
                sync_folder(self.path.parent)

    def discard(self) -> None:
        """Leave nothing of the bag behind."""
        with self._lock:
            self._bag = None
            with suppress(OSError):
                self._stream.close()
                self._active.unlink()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: Optional[type], *rest: object) -> None:
        """Close the bag, or leave nothing of one that was not finished."""
        if kind is None:
            self.close()
        else:
            self.discard()

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Turn what the disk refuses into an error that names the file."""
        try:
            yield
        except OSError as error:
            self._bag = None
            raise BagError(
                f"{self._active} cannot be written ({error.strerror}): see to the disk; rosbag reindex saves "
                "what is there"
            ) from error
