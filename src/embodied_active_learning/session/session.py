"""The session: one folder per run. Its writer holds the lock; readers need none."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO, Dict, List, Optional

import numpy as np

from embodied_active_learning.config import RECORDED, Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.naming import check_name
from embodied_active_learning.session import lock
from embodied_active_learning.session.atomic import is_leftover, make_folder, remove_leftovers
from embodied_active_learning.session.disk import check_space, folder_size
from embodied_active_learning.session.observations import ObservationStore
from embodied_active_learning.session.paths import (
    CONFIG_FILE,
    LOCK_FILE,
    SUMMARY_FILE,
    SessionPaths,
    check_not_link,
    stays_inside,
)
from embodied_active_learning.session.stored_config import (
    changed_keys,
    is_stored_config,
    read_stored_config,
    write_stored_config,
)
from embodied_active_learning.session.summary import reopen_summary
from embodied_active_learning.session.tables import COLUMNS, Table, read_table

_MAX_CAPACITY_HINT = 4096
_MAX_LISTED = 20  # sessions in a message


class Session:
    """The folder of one run.

    Attributes:
        paths: Paths of its parts.
        config: Configuration of the run.
    """

    def __init__(self, path: Path, config: Config, held: Optional[BinaryIO] = None) -> None:
        self.paths = SessionPaths(path)
        self.config = config
        self._held = held

    @classmethod
    def open_for_writing(cls, config: Config) -> Session:
        """Create the session of config.session, or continue it if session/resume is set, and lock it.

        Raises:
            SessionError: Like check_session.
        """
        path = check_session(config)
        make_folder(path)
        held = lock.acquire(path / LOCK_FILE)
        try:
            _check_folder(path, config)  # again, now that no other process can change it
            remove_leftovers(path)
            reopen_summary(path / SUMMARY_FILE, config)
            write_stored_config(path / CONFIG_FILE, config)
        except BaseException:
            held.close()
            raise
        return cls(path, config, held)

    @classmethod
    def open_read_only(cls, path: Path) -> Session:
        """Open a session for reading, also while it runs.

        Raises:
            CorruptFileError: The folder is not a session.
            SessionError: A part of it is a link out of the folder.
        """
        SessionPaths(path).check_links()
        return cls(Path(path), read_stored_config(Path(path) / CONFIG_FILE))

    def __repr__(self) -> str:
        return f"Session({str(self.paths.path)!r})"

    @property
    def name(self) -> str:
        """Name of the session and its folder."""
        return self.paths.path.name

    @property
    def writable(self) -> bool:
        """Whether this process has opened the session for writing."""
        return self._held is not None

    def open_observations(self) -> ObservationStore:
        """Open the observation store, for writing if the session is writable."""
        workspace, camera = self.config.workspace.box(), self.config.camera
        shape = (camera.height, camera.width, 3)
        if not self.writable:
            return ObservationStore.open_read_only(self.paths.observations, workspace, shape)
        capacity = min(self.config.exploration.steps, _MAX_CAPACITY_HINT)
        return ObservationStore.open_for_writing(self.paths.observations, workspace, shape, capacity)

    def open_table(self, name: str) -> Table:
        """Open a table of tables.COLUMNS to append to.

        Each table has its own lock, so that planner and trainer can write different ones.
        """
        return Table(self.paths.table(name), COLUMNS[name])

    def read_table(self, name: str) -> Dict[str, np.ndarray]:
        """Return the columns of a table, (N,) float64 each; N is 0 before the first row."""
        return read_table(self.paths.table(name), COLUMNS[name])

    def close(self) -> None:
        """Release the session's lock."""
        if self._held is not None:
            self._held.close()
            self._held = None

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def session_path(config: Config) -> Path:
    """Return the folder of the configured session. Raises SessionError for an invalid name or root."""
    return session_root(config) / check_name(config.session.name)


def session_root(config: Config) -> Path:
    """Return the absolute folder of all sessions. Raises SessionError if it is invalid."""
    root = os.path.expanduser(config.session.root)
    if root.startswith("~") or "\0" in root:
        raise SessionError(f"session/root is {config.session.root!r}, which is not a valid folder: choose another one")
    return Path(os.path.abspath(root))


def find_session(root: Path, name: str, subject: str = "session") -> Path:
    """Return the folder of a stored session.

    Args:
        root: Folder of all sessions.
        name: Name of the session.
        subject: Origin of the name for messages.

    Raises:
        SessionError: The name is invalid, a link out of root, or unknown; lists the known sessions.
    """
    path = root / check_name(name, subject)
    stays_inside(root, path)
    if not path.is_dir():
        raise SessionError(f"{subject} is {name!r}, but there is no such session in {root}: {known_sessions(root)}")
    return path


def check_session(config: Config) -> Path:
    """Check that the configured session can be opened for writing, without creating anything. Return its folder.

    Raises:
        SessionError: Invalid name; not a session folder, or a symbolic link; in use; exists already (without
            session/resume) or does not exist (with it); stored with settings that must not change; or the disk is too
            small.
    """
    path = session_path(config)
    try:
        _check_folder(path, config)
        holder = lock.holder(path / LOCK_FILE)
        if holder is not None:
            raise SessionError(lock.in_use(path, holder))
        check_space(path, config, folder_size(path))
    except OSError as error:
        raise SessionError(f"{path} cannot be used ({error.strerror}): choose another session/root") from error
    return path


def list_sessions(root: Path) -> List[Path]:
    """Return the session folders below root, sorted by name."""
    return sorted(path.parent for path in Path(root).glob(f"*/{CONFIG_FILE}") if is_stored_config(path))


def known_sessions(root: Path) -> str:
    """Return the end of a message about an unknown session."""
    return f"known are {', '.join(found.name for found in list_sessions(root)[:_MAX_LISTED]) or 'none'}"


def _check_folder(path: Path, config: Config) -> None:
    check_not_link(path)
    if not _is_new(path):
        _check_existing(path, config)
    elif config.session.resume:
        raise SessionError(f"there is no session {path.name} in {path.parent}: {known_sessions(path.parent)}")


def _check_existing(path: Path, config: Config) -> None:
    if not (path / CONFIG_FILE).is_file():
        raise SessionError(f"{path} exists but is not a session: choose another session/name")
    SessionPaths(path).check_links()
    stored = read_stored_config(path / CONFIG_FILE)
    if not config.session.resume:
        raise SessionError(
            f"session {path} exists: choose another session/name (session:=), or continue it with session/resume "
            "(learn.launch or replay.launch resume:=true)"
        )
    if stored.arm.robot == RECORDED != config.arm.robot:
        raise SessionError(
            f"session {path} was learned from a recording, so an arm cannot continue it: use replay.launch "
            "resume:=true, and fingerprint.launch views_from:=stored"
        )
    changes = changed_keys(stored, config)
    if changes:
        raise SessionError(
            f"session {path} cannot be continued: {'; '.join(changes)}; restore these settings, or start a new session"
        )


def _is_new(path: Path) -> bool:
    """Return whether the path is free, or has only leftovers of a process killed while creating a session."""
    if not path.is_dir():
        return not path.exists()
    return all(entry.name == LOCK_FILE or is_leftover(entry.name) for entry in path.iterdir())
