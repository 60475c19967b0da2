"""Names that become files and folders: which are allowed, and where each part of a session lies."""

from __future__ import annotations

import re
from pathlib import Path

from embodied_active_learning.errors import SessionError

_LEGAL = re.compile(r"[a-z0-9][a-z0-9_.-]{0,63}")
_SHOWN = 80

CONFIG_FILE = "config.yaml"
LOCK_FILE = ".lock"
SUMMARY_FILE = "summary.yaml"


def check_name(name: str, subject: str = "session/name") -> str:
    """The name, if it is safe as a file name. Raises SessionError that says the rule."""
    if not isinstance(name, str) or not _LEGAL.fullmatch(name):
        raise SessionError(
            f"{subject} is {str(name)[:_SHOWN]!r}: give 1 to 64 of a-z, 0-9, '_', '-' and '.', beginning with a letter "
            "or a digit"
        )
    return name


class SessionPaths:
    """Where the parts of a session lie below its folder."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.observations = self.path / "observations"
        self.checkpoints = self.path / "checkpoints"
        self.model = self.path / "model.safetensors"
        self.planner = self.path / "planner.safetensors"
        self.fingerprints = self.path / "fingerprints"
        self.identification = self.path / "identification"
        self.figures = self.path / "figures"
        self.summary = self.path / SUMMARY_FILE
        self.config = self.path / CONFIG_FILE
        self.lock = self.path / LOCK_FILE

    def table(self, name: str) -> Path:
        """The file of a table: exploration, training or evaluation."""
        return self.path / f"{name}.csv"
