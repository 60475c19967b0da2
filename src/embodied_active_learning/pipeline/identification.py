"""Identifying fingerprints in the images of one session, stored or still growing, without robot or ROS."""

from __future__ import annotations

from pathlib import Path
from typing import List, Sequence

import numpy as np

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.errors import SessionError
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import FingerprintSet
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.identifications import (
    identification_folder,
    is_identified,
    save_identification,
)
from embodied_active_learning.session.observations import ObservationStore
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.session import Session, find_session

MOST_SESSIONS = 64
"""Sessions whose fingerprints are looked for at a time: each has a model that is kept in memory."""

_CHUNK = 64


def read_sets(root: Path, sessions: Sequence[str]) -> List[FingerprintSet]:
    """The fingerprints of sessions below a folder, by name; one that is named twice is read once.

    Raises SessionError for a name that is not allowed or unknown, and for none or too many of them.
    """
    names = list(dict.fromkeys(sessions))
    if not names:
        raise SessionError("no session was named whose fingerprints are looked for: name one at least")
    if len(names) > MOST_SESSIONS:
        raise SessionError(f"{len(names)} sessions were named: name {MOST_SESSIONS} at most")
    return [load_fingerprints(find_session(root, name, "one of sessions")) for name in names]


def check_results(session_path: Path, name: str, overwrite: bool) -> None:
    """Raise SessionError unless results may be kept under a name: it is legal, and new or meant to be replaced."""
    if is_identified(session_path, name) and not overwrite:
        folder = identification_folder(session_path, name)
        raise SessionError(f"there are results in {folder}: choose another name, or ask for overwrite")


class IdentificationRun:
    """Looks for the fingerprints of some sessions in the images of another one, as they come.

    The images are read from the session's store: none is lost, a run can be repeated, and others can be tested on them.
    """

    def __init__(
        self,
        session_path: Path,
        sets: Sequence[FingerprintSet],
        name: str,
        images: int,
        settings: IdentificationConfig,
        overwrite: bool = False,
    ) -> None:
        """session_path: whose images are looked at, so many; 0 for all there are. sets: the fingerprints of sessions.

        overwrite: whether earlier results of that name may be replaced.
        Raises SessionError when there is no such session or nothing to look at, or when the name is taken, ConfigError
        when cameras differ.
        """
        self._path = Path(session_path)
        check_results(self._path, name, overwrite)
        self.folder = identification_folder(self._path, name)
        self.figures = SessionPaths(self._path).figures
        self._name = name
        self.sets = tuple(sets)
        self._session = Session.open_read_only(self._path)
        config = self._session.config
        self.identification = Identification(self.sets, config.workspace.box(), config.camera, settings)
        self._store: ObservationStore = self._session.open_observations()
        self.images = images or len(self._store)
        if self.images < 1:
            self.close()
            raise SessionError(
                f"there are no images to look at: {self._path} holds {self.stored}, {images} were asked for; give a "
                "number from 1, or 0 for all"
            )

    @property
    def config(self) -> Config:
        """The configuration that the images were taken with."""
        return self._session.config

    @property
    def stored(self) -> int:
        """Images that were stored when last looked for."""
        return len(self._store)

    @property
    def looked_at(self) -> int:
        """Images looked at."""
        return self.identification.images

    @property
    def complete(self) -> bool:
        """Whether all images were looked at."""
        return self.looked_at >= self.images

    @property
    def states(self) -> np.ndarray:
        """(N, 3) m, m, rad: where the images were taken that were looked at."""
        return self._store.raw_states[: self.looked_at]

    @property
    def pictures(self) -> np.ndarray:
        """(N, H, W, 3) uint8: the images that were looked at."""
        return self._store.images[: self.looked_at]

    def advance(self) -> int:
        """Look at the next images, a few at most -> how many. 0 when no new ones were stored.

        Raises CorruptFileError for a damaged store.
        """
        if len(self._store) == self.looked_at:
            self._store.refresh()
        part = slice(self.looked_at, min(self.looked_at + _CHUNK, self.images, len(self._store)))
        states, images = self._store.raw_states[part], self._store.images[part]
        self.identification.observe(states, images)
        return len(states)

    def decide(self) -> List[Decision]:
        """Decide for every fingerprint by what was looked at so far."""
        return self.identification.decide(self.states, self.pictures)

    def save(self, decisions: Sequence[Decision]) -> Path:
        """Store decisions, beliefs and trace -> the folder. Raises SessionError when the disk fails."""
        return save_identification(self._path, self._name, self.identification, decisions)

    def close(self) -> None:
        """Close the store's file."""
        self._store.close()
