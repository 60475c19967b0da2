"""Paths of the parts of a session, and which symbolic links are followed.

* session/root, and the path of a session that a user gives to read it, may be links.
* A session that is chosen by its name, such as one with fingerprints, may be a link that stays below session/root
  (`stays_inside`). A session that is created or resumed is never a link (`check_not_link`).
* Folders of a session may be links that stay inside it (`stays_inside`, `SessionPaths.check_links`).
* Files of a session are never links (files.open_regular_file); profiles, worlds and what these refer to may be links.
"""

from __future__ import annotations

import os
from pathlib import Path

from embodied_active_learning.errors import SessionError

CONFIG_FILE = "config.yaml"
LOCK_FILE = ".lock"
SUMMARY_FILE = "summary.yaml"
BAGS_FOLDER = "bags"


def stays_inside(folder: Path, path: Path) -> Path:
    """Return the path. Raises SessionError if a symbolic link leads out of the folder."""
    real = os.path.realpath(path)
    if os.path.commonpath((os.path.realpath(folder), real)) != os.path.realpath(folder):
        raise SessionError(f"{path} leads out of {folder}, to {real}: replace the link by what it refers to")
    return path


def check_not_link(path: Path) -> None:
    """Raise SessionError if the folder of a session that will be created or resumed is a symbolic link."""
    if path.is_symlink():
        raise SessionError(
            f"{path} is a symbolic link, and a session must be a folder: link session/root instead, or choose another "
            "session/name"
        )


class SessionPaths:
    """Paths of the parts of a session folder."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.observations = self.path / "observations"
        self.checkpoints = self.path / "checkpoints"
        self.model = self.path / "model.safetensors"
        self.planner = self.path / "planner.safetensors"
        self.arm_states = self.path / "arm_states.safetensors"
        self.fingerprints = self.path / "fingerprints"
        self.identification = self.path / "identification"
        self.figures = self.path / "figures"
        self.bags = self.path / BAGS_FOLDER
        self.summary = self.path / SUMMARY_FILE
        self.config = self.path / CONFIG_FILE
        self.lock = self.path / LOCK_FILE

    def check_links(self) -> None:
        """Raise SessionError if a subfolder is a link out of the session. Files are checked when they are opened."""
        for part in (
            self.observations, self.checkpoints, self.fingerprints, self.identification, self.figures, self.bags,
        ):  # fmt: skip
            stays_inside(self.path, part)

    def table(self, name: str) -> Path:
        """Return the file of a table of tables.COLUMNS."""
        return self.path / f"{name}.csv"
