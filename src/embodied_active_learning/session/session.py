"""One run = one folder. Who writes it holds its lock; whoever reads it needs none."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO, Dict, List, Optional

import numpy as np

from embodied_active_learning.config import RECORDED, Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.naming import check_name
from embodied_active_learning.session import lock
from embodied_active_learning.session.atomic import is_leftover, make_folder, remove_file, remove_leftovers
from embodied_active_learning.session.description import (
    changed_keys,
    is_description,
    read_description,
    write_description,
)
from embodied_active_learning.session.disk import bytes_below, check_space
from embodied_active_learning.session.observations import ObservationStore
from embodied_active_learning.session.paths import (
    CONFIG_FILE,
    LOCK_FILE,
    SUMMARY_FILE,
    SessionPaths,
    stays_inside,
)
from embodied_active_learning.session.tables import COLUMNS, Table, read_table

_LARGEST_HINT = 4096
_MOST_LISTED = 20  # sessions that a message names


class Session:
    """The folder of one run: `paths` says where things lie, `config` what was configured."""

    def __init__(self, path: Path, config: Config, held: Optional[BinaryIO] = None) -> None:
        self.paths = SessionPaths(path)
        self.config = config
        self._held = held

    @classmethod
    def open_for_writing(cls, config: Config) -> Session:
        """Create the session of config.session, or continue it when session/resume is set, and hold its lock.

        Raises SessionError as check_session does.
        """
        path = check_session(config)
        make_folder(path)
        held = lock.acquire(path / LOCK_FILE)
        try:
            _check_folder(path, config)  # again, now that nobody else can change it
            remove_leftovers(path)
            remove_file(path / SUMMARY_FILE)  # a run that goes on is not finished
            write_description(path / CONFIG_FILE, config)
        except BaseException:
            held.close()
            raise
        return cls(path, config, held)

    @classmethod
    def open_read_only(cls, path: Path) -> Session:
        """A session to look at, also while it runs. Raises CorruptFileError when the folder is none.

        Raises SessionError when a part of it is a link that leads out of it.
        """
        SessionPaths(path).check_links()
        return cls(Path(path), read_description(Path(path) / CONFIG_FILE))

    @property
    def name(self) -> str:
        """The name of the session: that of its folder."""
        return self.paths.path.name

    @property
    def writable(self) -> bool:
        """Whether this process holds the session."""
        return self._held is not None

    def open_observations(self) -> ObservationStore:
        """The observation store, for writing when the session is."""
        workspace, camera = self.config.workspace.box(), self.config.camera
        shape = (camera.height, camera.width, 3)
        if not self.writable:
            return ObservationStore.open_read_only(self.paths.observations, workspace, shape)
        capacity = min(self.config.exploration.steps, _LARGEST_HINT)
        return ObservationStore.open_for_writing(self.paths.observations, workspace, shape, capacity)

    def open_table(self, name: str) -> Table:
        """A table to append to: exploration, training or evaluation.

        Each table locks itself, so that another process than the session's holder may keep one.
        """
        return Table(self.paths.table(name), COLUMNS[name])

    def read_table(self, name: str) -> Dict[str, np.ndarray]:
        """The columns of a table, (N,) float64 each; N is 0 when nothing was written."""
        return read_table(self.paths.table(name), COLUMNS[name])

    def close(self) -> None:
        """Give the session's lock back."""
        if self._held is not None:
            self._held.close()
            self._held = None

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def session_path(config: Config) -> Path:
    """The folder of the configured session. Raises SessionError for a name or a root that is not allowed."""
    return session_root(config) / check_name(config.session.name)


def session_root(config: Config) -> Path:
    """The folder that holds the sessions, absolute. Raises SessionError for one that cannot be."""
    root = os.path.expanduser(config.session.root)
    if root.startswith("~") or "\0" in root:
        raise SessionError(f"session/root is {config.session.root!r}, and no such folder can be: give another one")
    return Path(os.path.abspath(root))


def find_session(root: Path, name: str, subject: str = "session") -> Path:
    """The folder of a stored session that was asked for by name.

    Raises SessionError for a name that is not allowed or that leads out of root through a link, and for one that there
    is not, with those that there are; subject says what the name was given as.
    """
    path = root / check_name(name, subject)
    stays_inside(root, path)
    if not path.is_dir():
        known = ", ".join(found.name for found in list_sessions(root)[:_MOST_LISTED]) or "none"
        raise SessionError(f"{subject} is {name!r}, and there is none of that name in {root}; there are: {known}")
    return path


def check_session(config: Config) -> Path:
    """Check that the configured session can be opened for writing, and create nothing. -> its folder.

    Raises SessionError when its name is not allowed, its folder is not ours, it is in use, exists already (without
    session/resume), does not exist (with it), differs in what its data depends on, or when the disk is too small.
    """
    path = session_path(config)
    try:
        _check_folder(path, config)
        who = lock.holder(path / LOCK_FILE)
        if who is not None:
            raise SessionError(lock.in_use(path, who))
        check_space(path, config, bytes_below(path))
    except OSError as error:
        raise SessionError(f"{path} cannot be used ({error.strerror}): choose another session/root") from error
    return path


def list_sessions(root: Path) -> List[Path]:
    """The folders below root that are sessions, by name."""
    return sorted(path.parent for path in Path(root).glob(f"*/{CONFIG_FILE}") if is_description(path))


def _check_folder(path: Path, config: Config) -> None:
    if not _is_new(path):
        _check_existing(path, config)
    elif config.session.resume:
        known = ", ".join(found.name for found in list_sessions(path.parent)[:_MOST_LISTED]) or "none"
        raise SessionError(f"there is no session {path} to resume; in that folder there are: {known}")


def _check_existing(path: Path, config: Config) -> None:
    if path.is_symlink() or not (path / CONFIG_FILE).is_file():
        raise SessionError(f"{path} exists but is no session of this package: choose another session/name")
    SessionPaths(path).check_links()
    stored = read_description(path / CONFIG_FILE)
    if not config.session.resume:
        raise SessionError(f"session {path} exists: choose another session/name, or set session/resume to continue it")
    if stored.arm.robot == RECORDED != config.arm.robot:
        raise SessionError(
            f"session {path} was learned from a recording, so no arm can go on with it: replay.launch resume:=true "
            "can; fingerprint.launch takes views_from:=stored"
        )
    changes = changed_keys(stored, config)
    if changes:
        raise SessionError(f"session {path} cannot be continued: {'; '.join(changes)}: set it back, or start a new one")


def _is_new(path: Path) -> bool:
    """Whether there is nothing at the path, or only what a process left that was killed while it created a session."""
    if not path.is_dir() or path.is_symlink():
        return not (path.exists() or path.is_symlink())
    return all(entry.name == LOCK_FILE or is_leftover(entry.name) for entry in path.iterdir())
