"""Identification in the images of one session, finished or still running, without ROS."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import List, Sequence

import numpy as np

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.errors import SessionError
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import FingerprintSet
from embodied_active_learning.objects.identification import CHUNK, Identification
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.session.fingerprint_sets import searched_sessions
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.identifications import (
    identification_folder,
    is_identified,
    save_identification,
)
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.session import Session

FIRST_EVALUATION, _EVALUATION_GROWTH = 20, 1.2
"""Images before the first evaluation of the decisions, and factor from one evaluation to the next."""


def read_sets(root: Path, sessions: Sequence[str]) -> List[FingerprintSet]:
    """Load the fingerprints of sessions below a folder; each name is loaded once. Raises like searched_sessions."""
    return [load_fingerprints(path) for path in searched_sessions(root, sessions)]


def check_results(session_path: Path, name: str, overwrite: bool) -> None:
    """Raise SessionError if a name is invalid, or if it has results that must not be replaced."""
    if is_identified(session_path, name) and not overwrite:
        folder = identification_folder(session_path, name)
        raise SessionError(f"results exist in {folder}: choose another name, or set overwrite")


def next_evaluation(images: int, open_count: int) -> int:
    """Return the number of images after which decisions are evaluated again.

    Evaluation takes about 0.1 s for each open fingerprint, less than the arm needs for as many images.

    Args:
        images: Number of images at this evaluation.
        open_count: Number of fingerprints whose decision more images may change.
    """
    return max(images + max(open_count, 1), int(_EVALUATION_GROWTH * images))


class IdentificationRun:
    """Searches for fingerprints in the images of a session, also while it is running.

    Images are read from the session's store, so none is skipped and a run can be repeated on the same images.
    """

    def __init__(
        self,
        session_path: Path,
        sets: Sequence[FingerprintSet],
        name: str,
        images: int,
        settings: IdentificationConfig,
        overwrite: bool = False,
        must_be_stored: bool = False,
    ) -> None:
        """Open the session with the images.

        Args:
            session_path: Folder of the session with the images.
            sets: The fingerprints to search for.
            name: Name of the results.
            images: Largest number of images to process; 0 for all that are stored.
            settings: How to search and decide.
            overwrite: Whether results of the same name may be replaced.
            must_be_stored: Whether all images must be stored already, because the session is not running.

        Raises:
            SessionError: If the session does not exist or has too few images, or if the name is in use.
            ConfigError: If the cameras differ.
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
        self.unknown: List[UnknownObject] = []
        """Unknown objects, as of the last call of `decide`."""
        self._sequential = settings.stop_when_decided and self.identification.by_views
        self._next_evaluation = FIRST_EVALUATION
        with ExitStack() as opened:
            self._store = opened.enter_context(self._session.open_observations())
            self.max_images = self._largest_count(images, must_be_stored)
            opened.pop_all()

    @property
    def config(self) -> Config:
        """Configuration of the session with the images."""
        return self._session.config

    @property
    def stored(self) -> int:
        """Number of stored images at the last refresh."""
        return len(self._store)

    @property
    def processed(self) -> int:
        """Number of processed images."""
        return self.identification.image_count

    @property
    def complete(self) -> bool:
        """Whether more images change no decision, or all images are processed."""
        return self.identification.all_closed or self.processed >= self.max_images

    @property
    def states(self) -> np.ndarray:
        """(N, 3) camera states [m, m, rad] of the processed images."""
        return self._store.raw_states[: self.processed]

    @property
    def images(self) -> np.ndarray:
        """(N, H, W, 3) uint8, the processed images."""
        return self._store.images[: self.processed]

    def advance(self) -> int:
        """Process the next stored images, and evaluate the decisions when it is time. Return the number of images.

        It is at most CHUNK, so that the caller can report progress, and 0 if there are no new ones.

        Raises:
            CorruptFileError: If the store is damaged.
        """
        if len(self._store) == self.processed:
            self._store.refresh()
        limits = [self.processed + CHUNK, self.max_images, len(self._store)]
        if self._sequential:
            limits.append(self._next_evaluation)
        part = slice(self.processed, min(limits))
        states, images = self._store.raw_states[part], self._store.images[part]
        self.identification.observe(states, images)
        if self._sequential and len(states) and self.processed >= self._next_evaluation:
            self.identification.decide(self.states, self.images)
            self._next_evaluation = next_evaluation(self.processed, self.identification.open_count)
        return len(states)

    def decide(self) -> List[Decision]:
        """Decide for every fingerprint from the images processed so far."""
        decisions = self.identification.decide(self.states, self.images)
        self.unknown = self.identification.unknown_objects(decisions)
        return decisions

    def save(self, decisions: Sequence[Decision]) -> Path:
        """Store decisions, beliefs and traces. Return the folder. Raises SessionError if writing fails."""
        return save_identification(self._path, self._name, self.identification, decisions, self.unknown)

    def close(self) -> None:
        """Close the store's file."""
        self._store.close()

    def __enter__(self) -> IdentificationRun:
        return self

    def __exit__(self, *_details: object) -> None:
        self.close()

    def _largest_count(self, requested: int, must_be_stored: bool) -> int:
        """Return the largest number of images to process. Raises SessionError if it is invalid or too large."""
        images = requested or self.stored
        if images < 1:
            raise SessionError(
                f"no images: {requested} requested, {self._path} has {self.stored}; request at least 1, or 0 for all"
            )
        if must_be_stored and images > self.stored:
            raise SessionError(
                f"too few images: {requested} requested, session {self._path.name} has {self.stored}; request fewer, "
                "or 0 for all"
            )
        return images
