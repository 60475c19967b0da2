"""Atomic file replacement: a file has either its old or its new content, whatever kills the process or the machine.

A folder is replaced as a whole: it has its old or its new content, whatever fails. Only a process that is killed
between the two renames leaves none.
"""

from __future__ import annotations

import os
import shutil
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Iterable, Iterator

from embodied_active_learning.errors import SessionError

_SUFFIX = ".tmp"


@contextmanager
def replace_file(path: Path) -> Iterator[BinaryIO]:
    """Yield a temporary file that replaces path at the end of the block, and is deleted if the block fails.

    Raises:
        SessionError: The disk failed; the message says whether the previous or the new file is in place.
    """
    path = Path(path)
    # In the same folder, because a rename is atomic only within one file system.
    temporary = _temporary(path, path.name)
    try:
        # A leftover of a killed process with the same id, or a link, which must not be written through.
        temporary.unlink(missing_ok=True)
        with temporary.open("xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise SessionError(f"{path} cannot be written ({error.strerror}): the previous file is kept") from error
    finally:
        with suppress(OSError):  # the next writer removes it; the first error is the one to report
            temporary.unlink()
    _flush_rename(path)


@contextmanager
def replace_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder that replaces path at the end of the block, and is deleted if the block fails.

    The functions of this module flush what the block writes with them.

    Raises:
        SessionError: Writing failed, also inside the block; the message says whether the previous or the new folder is
            in place.
    """
    temporary, previous = _temporary(path, path.name), _temporary(path, f"{path.name}.previous")
    try:
        with disk_failure_named(path, "the previous one is kept"):
            remove_paths([temporary])
            temporary.mkdir()
            yield temporary
            _swap(path, temporary, previous)
        _flush_rename(path)
        remove_paths([previous])
    finally:
        remove_paths([temporary])


@contextmanager
def disk_failure_named(folder: Path, consequence: str) -> Iterator[None]:
    """Raise a SessionError that names a folder if the disk fails in the block.

    Args:
        folder: What the block writes.
        consequence: The last words of the message, such as "the previous one is kept".
    """
    try:
        yield
    except (OSError, SessionError) as error:
        reason = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(reason, OSError):
            raise
        raise SessionError(
            f"{folder} cannot be written ({reason.strerror}): free disk space, or make the folder writable; "
            f"{consequence}"
        ) from reason


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


def remove_paths(paths: Iterable[Path]) -> None:
    """Delete files and folders without following links. What cannot be deleted is left for the next writer."""
    for path in paths:
        with suppress(OSError):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()


def sync_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk; otherwise a renamed file may be lost in a power failure."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files and folders whose writer no longer runs."""
    remove_paths(path for path in folder.glob(f".*{_SUFFIX}") if not _is_being_written(path))


def _temporary(path: Path, name: str) -> Path:
    """Return a path beside another one that only this thread uses."""
    return path.with_name(f".{name}.{os.getpid()}.{threading.get_ident()}{_SUFFIX}")


def _swap(path: Path, new: Path, previous: Path) -> None:
    """Rename a new folder to a path, and what is there to another one. A rename cannot replace a folder with files."""
    replaces = os.path.lexists(path)
    if replaces:
        remove_paths([previous])
        os.replace(path, previous)
    try:
        os.replace(new, path)
    except BaseException:
        if replaces:
            os.replace(previous, path)
        raise


def _flush_rename(path: Path) -> None:
    """Flush the rename of a new file or folder to a path."""
    try:
        sync_folder(path.parent)
    except OSError as error:
        raise SessionError(
            f"{path} was written, but may be lost in a power failure ({error.strerror}): check the disk"
        ) from error


def _is_being_written(temporary: Path) -> bool:
    """Return whether the process in the name of a temporary file still runs on this machine."""
    parts = temporary.name.split(".")[-3:]  # process, thread, suffix
    return len(parts) == 3 and parts[0].isdecimal() and os.path.exists(f"/proc/{parts[0]}")


def is_leftover(name: str) -> bool:
    """Return whether a file name is that of a temporary file."""
    return name.startswith(".") and name.endswith(_SUFFIX)
