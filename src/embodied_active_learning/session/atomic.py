"""Files that are either the old one or the new one, never half of one, whatever kills the process or the machine."""

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
    """A new file that takes the place of path when the block ends, and vanishes when the block fails."""
    path = Path(path)
    # The same folder, because a rename is atomic only inside one file system.
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}{_SUFFIX}")
    try:
        # Of a process that was killed and had the same number; nobody else's: it is not written through a link.
        temporary.unlink(missing_ok=True)
        with temporary.open("xb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
        sync_folder(path.parent)
    except OSError as error:
        raise SessionError(f"{path} cannot be written ({error.strerror}): what was there before is kept") from error
    finally:
        with suppress(OSError):  # what is left is removed by the next writer; the first error is the one to tell
            temporary.unlink()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file atomically."""
    with replace_file(path) as stream:
        stream.write(content)


def write_text(path: Path, text: str) -> None:
    """Write a whole UTF-8 file atomically."""
    write_bytes(path, text.encode("utf-8"))


def make_folder(folder: Path) -> None:
    """Make a folder that is there after a power failure too. Raises SessionError when the disk or its rights forbid."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sync_folder(folder.parent)
    except OSError as error:
        raise SessionError(
            f"{folder} cannot be made ({error.strerror}): free some of the disk, mend its rights, or choose "
            "another folder"
        ) from error


def remove_file(path: Path) -> None:
    """Delete a file, if it is there. Raises SessionError when the disk or its rights forbid."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise SessionError(f"{path} cannot be deleted ({error.strerror}): mend the rights of its folder") from error


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk: without it a renamed file can be lost with the power."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files of writers that were killed, and of none that still runs."""
    for leftover in folder.glob(f".*{_SUFFIX}"):
        if not _is_being_written(leftover):
            with suppress(OSError):  # they do no harm
                leftover.unlink()


def _is_being_written(temporary: Path) -> bool:
    """Whether the process still runs, as far as this machine knows, that has given the file its name."""
    parts = temporary.name.split(".")[-3:]  # as replace_file puts them: process, thread, suffix
    return len(parts) == 3 and parts[0].isdecimal() and os.path.exists(f"/proc/{parts[0]}")


def is_leftover(name: str) -> bool:
    """Whether a file name is that of a temporary file."""
    return name.startswith(".") and name.endswith(_SUFFIX)
