"""Disks to fill and to make read-only, in a mount namespace of the test process's own, which ends with it."""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path

import pytest

_CLONE_NEWNS = 0x00020000


def enter_own_mounts() -> None:
    """See mounts of one's own from here on. Skips the test where that is not allowed."""
    if ctypes.CDLL(None, use_errno=True).unshare(_CLONE_NEWNS) != 0:
        pytest.skip(f"no mounts of one's own here: {os.strerror(ctypes.get_errno())}")
    _mount("--make-rprivate", "/")


class SmallDisk:
    """A disk of a few hundred kilobytes at a folder."""

    def __init__(self, folder: Path, kilobytes: int) -> None:
        self.folder = folder
        folder.mkdir()
        _mount("-t", "tmpfs", "-o", f"size={kilobytes}k,nr_inodes=200", "tmpfs", str(folder))

    def fill(self, leave: int = 0) -> None:
        """Fill the disk except for a number of bytes, in whole blocks."""
        free = os.statvfs(self.folder)
        with (self.folder / "filler").open("ab") as stream:
            size = stream.tell() + free.f_bavail * free.f_frsize - leave
            os.posix_fallocate(stream.fileno(), 0, max(size, 1))

    def free(self) -> None:
        """Give back what was taken."""
        (self.folder / "filler").unlink()

    def set_writable(self, writable: bool) -> None:
        """Mount it read-only, or for writing again."""
        _mount("-o", f"remount,{'rw' if writable else 'ro'}", str(self.folder))

    def remove(self) -> None:
        """Unmount it, also while files on it are open."""
        subprocess.run(["umount", "--lazy", str(self.folder)], check=True)


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], check=False, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"mounting is not possible here: {done.stderr.strip()}")
