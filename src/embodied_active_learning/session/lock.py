"""One writer at a time, with locks that the kernel releases however their holder ends."""

from __future__ import annotations

import fcntl
import os
import socket
from pathlib import Path
from typing import BinaryIO, Optional

from embodied_active_learning.errors import SessionError


def claim(stream: BinaryIO, path: Path) -> None:
    """Lock an open file for this process until it is closed. Raises SessionError when another one has it."""
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise SessionError(f"{path} is being written by another process: end that one first") from error


def acquire(path: Path) -> BinaryIO:
    """Create and lock a lock file that names this process; closing it gives it back.

    Raises SessionError naming the process that holds it.
    """
    stream = path.open("a+b")
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        stream.close()
        raise SessionError(in_use(path.parent, _name_in(path))) from error
    stream.truncate(0)
    stream.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
    stream.flush()
    return stream


def holder(path: Path) -> Optional[str]:
    """Who holds a lock file, such as "process 12 on robot"; None when it is free. Creates nothing."""
    try:
        with path.open("rb") as stream:
            fcntl.flock(stream.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return None
    except BlockingIOError:
        return _name_in(path)
    return None


def in_use(folder: Path, who: str) -> str:
    """What the second writer of a session is told."""
    return f"session {folder} is in use by {who}: end that run, or choose another session/name"


def _name_in(path: Path) -> str:
    # The holder may not have written its name yet.
    return path.read_bytes().decode("utf-8", "replace").strip() or "another process"
