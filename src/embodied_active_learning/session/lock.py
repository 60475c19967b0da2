"""One writer at a time, with locks that the kernel releases however their holder ends."""

from __future__ import annotations

import fcntl
import os
import socket
import time
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Iterator, Optional

from embodied_active_learning.errors import SessionError
from embodied_active_learning.files import open_plain

_TRIES = 3
_PAUSE = 0.1  # s between two tries
_LONGEST_NAME = 200  # bytes of a lock file that are told


def claim(stream: BinaryIO, path: Path) -> None:
    """Lock an open file for this process until it is closed. Raises SessionError when another one has it."""
    with _named(path):
        if not _lock(stream, fcntl.LOCK_EX):
            raise SessionError(f"{path} is being written by another process: end that one first")


def acquire(path: Path) -> BinaryIO:
    """Create and lock a lock file that names this process; closing it gives it back.

    Raises SessionError naming the process that holds it, or the file when it cannot be locked.
    """
    with _named(path):
        stream = open_plain(path, "r+b")
        try:
            if not _lock_patiently(stream):
                raise SessionError(in_use(path.parent, _name_in(stream)))
            stream.truncate(0)
            stream.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
        except BaseException:
            stream.close()
            raise
    return stream


def holder(path: Path) -> Optional[str]:
    """Who holds a lock file, such as "process 12 on robot"; None when it is free. Creates nothing.

    Raises SessionError naming the file when that cannot be told.
    """
    with _named(path):
        try:
            stream = open_plain(path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        with stream:
            return None if _lock(stream, fcntl.LOCK_SH) else _name_in(stream)


def in_use(folder: Path, who: str) -> str:
    """What the second writer of a session is told."""
    return f"session {folder} is in use by {who}: end that run, or choose another session/name"


def _name_in(stream: BinaryIO) -> str:
    # The holder may not have written its name yet.
    return os.pread(stream.fileno(), _LONGEST_NAME, 0).decode("utf-8", "replace").strip() or "another process"


def _lock_patiently(stream: BinaryIO) -> bool:
    """Whether the file could be locked: whoever asks for its holder locks it too, for a moment."""
    for _ in range(_TRIES - 1):
        if _lock(stream, fcntl.LOCK_EX):
            return True
        time.sleep(_PAUSE)
    return _lock(stream, fcntl.LOCK_EX)


def _lock(stream: BinaryIO, kind: int) -> bool:
    """Lock an open file without waiting; False when another process has locked it."""
    try:
        fcntl.flock(stream.fileno(), kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Turn what the system refuses, such as locks on a network drive without them, into an error naming the file."""
    try:
        yield
    except OSError as error:
        raise SessionError(f"{path} cannot be locked ({error.strerror}): choose another session/root") from error
