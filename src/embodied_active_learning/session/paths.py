"""Paths of the parts of a session."""

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
