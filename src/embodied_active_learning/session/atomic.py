"""Atomic file replacement: a file has either its old or its new content, whatever kills the process or the machine."""

from __future__ import annotations

import os
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Iterator

from embodied_active_learning.errors import SessionError

_SUFFIX = ".tmp"


@contextmanager
def replace_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a temporary file that replaces path at the end of the block, and is deleted if the block fails."""
    path = Path(path)
    # In the same folder, because a rename is atomic only within one file system.
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}{_SUFFIX}")
    try:
        # A leftover of a killed process with the same id, or a link, which must not be written through.
        temporary.unlink(missing_ok=True)
        with temporary.open("xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
        sync_folder(path.parent)
    except OSError as error:
        raise SessionError(f"{path} cannot be written ({error.strerror}): the previous file is kept") from error
    finally:
        with suppress(OSError):  # the next writer removes it; the first error is the one to report
            temporary.unlink()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file atomically."""
    with replace_file(path) as stream:
        stream.write(content)


def write_text(path: Path, text: str) -> None:
    """Write a whole UTF-8 file atomically."""
    write_bytes(path, text.encode("utf-8"))


def make_folder(folder: Path) -> None:
    """Create a folder that survives a power failure. Raises SessionError if disk or permissions prevent it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sync_folder(folder.parent)
    except OSError as error:
        raise SessionError(
            f"{folder} cannot be created ({error.strerror}): free disk space, fix the permissions, or choose another "
            "folder"
        ) from error


def remove_file(path: Path) -> None:
    """Delete a file if it exists. Raises SessionError if disk or permissions prevent it."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise SessionError(f"{path} cannot be deleted ({error.strerror}): fix the permissions of its folder") from error


def sync_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk; otherwise a renamed file may be lost in a power failure."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files whose writer no longer runs."""
    for leftover in folder.glob(f".*{_SUFFIX}"):
        if not _is_being_written(leftover):
            with suppress(OSError):  # harmless if it stays
                leftover.unlink()


def _is_being_written(temporary: Path) -> bool:
    """Return whether the process in the name of a temporary file still runs on this machine."""
    parts = temporary.name.split(".")[-3:]  # process, thread, suffix
    return len(parts) == 3 and parts[0].isdecimal() and os.path.exists(f"/proc/{parts[0]}")


def is_leftover(name: str) -> bool:
    """Return whether a file name is that of a temporary file."""
    return name.startswith(".") and name.endswith(_SUFFIX)
