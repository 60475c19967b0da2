"""Exclusive write access through file locks, which the kernel releases however their holder ends."""

from __future__ import annotations

import fcntl
import os
import socket
import time
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Iterator, Optional

from embodied_active_learning.errors import SessionError
from embodied_active_learning.files import open_regular_file

_ATTEMPTS = 3
_PAUSE = 0.1  # s between attempts
_MAX_NAME_LENGTH = 200  # bytes of a lock file in a message


def claim(stream: BinaryIO, path: Path) -> None:
    """Lock an open file until it is closed. Raises SessionError if another process has locked it."""
    with _errors_naming(path):
        if not _lock(stream, fcntl.LOCK_EX):
            raise SessionError(f"{path} is being written by another process: stop that process first")


def acquire(path: Path) -> BinaryIO:
    """Create and lock a lock file that names this process. Closing the returned stream releases it.

    Raises:
        SessionError: Another process holds the lock (named), or the file cannot be locked.
    """
    with _errors_naming(path):
        stream = open_regular_file(path, "r+b")
        try:
            if not _lock_with_retries(stream):
                raise SessionError(in_use(path.parent, _name_in(stream)))
            stream.truncate(0)
            stream.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
        except BaseException:
            stream.close()
            raise
    return stream


def holder(path: Path) -> Optional[str]:
    """Return the holder of a lock file, such as "process 12 on robot"; None if it is free. Creates nothing.

    Raises:
        SessionError: The file cannot be locked.
    """
    with _errors_naming(path):
        try:
            stream = open_regular_file(path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        with stream:
            return None if _lock(stream, fcntl.LOCK_SH) else _name_in(stream)


def in_use(folder: Path, who: str) -> str:
    """Return the error message for the second writer of a session."""
    return f"session {folder} is in use by {who}: stop that run, or choose another session/name"


def _name_in(stream: BinaryIO) -> str:
    # The holder may not have written its name yet.
    return os.pread(stream.fileno(), _MAX_NAME_LENGTH, 0).decode("utf-8", "replace").strip() or "another process"


def _lock_with_retries(stream: BinaryIO) -> bool:
    """Lock an open file; calls of holder() also lock it for a moment."""
    for _ in range(_ATTEMPTS - 1):
        if _lock(stream, fcntl.LOCK_EX):
            return True
        time.sleep(_PAUSE)
    return _lock(stream, fcntl.LOCK_EX)


def _lock(stream: BinaryIO, kind: int) -> bool:
    """Lock an open file without waiting; return False if another process has locked it."""
    try:
        fcntl.flock(stream.fileno(), kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextmanager
def _errors_naming(path: Path) -> Iterator[None]:
    """Turn an OSError, as on a network drive without locks, into a SessionError that names the file."""
    try:
        yield
    except OSError as error:
        raise SessionError(f"{path} cannot be locked ({error.strerror}): choose another session/root") from error
