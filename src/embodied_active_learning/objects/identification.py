"""Identification: search for fingerprints in a stream of images.

Paper, Sec. "Object Identification" and appendix.
"""

from __future__ import annotations

import logging
from dataclasses import fields
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import VERIFIED, CameraConfig, IdentificationConfig
from embodied_active_learning.errors import ConfigError, CorruptFileError, SessionError
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.beliefs import BeliefGrid, EvidenceWeights
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.decision_rule import make_rule
from embodied_active_learning.objects.fingerprint import FingerprintSet
from embodied_active_learning.objects.matching import Matcher
from embodied_active_learning.objects.scene_views import ObservedScene
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.objects.unknown import UnknownObject, find_unknown
from embodied_active_learning.workspace import Workspace

LOG = logging.getLogger(__name__)

CHUNK = 64
"""Images processed at a time."""


class Identification:
    """Searches for the fingerprints of any number of sessions, each with its own model, in one stream of images."""

    def __init__(
        self,
        sets: Sequence[FingerprintSet],
        workspace: Workspace,
        camera: CameraConfig,
        settings: IdentificationConfig,
    ) -> None:
        """Build models and belief grids.

        Args:
            sets: Fingerprints to search for, one set per session.
            workspace: Workspace of the stream.
            camera: Camera of the stream.
            settings: How to search and decide.

        Raises:
            ConfigError: If a model was trained with another camera.
            SessionError: If two sets are of sessions with the same name.
            CorruptFileError: If a model does not fit its session's configuration.
        """
        _check_names(sets)
        self._workspace, self._camera, self._settings = workspace, camera, settings
        self._rule = make_rule(settings)
        self._groups: List[Tuple[Matcher, List[SearchTarget]]] = []
        self._start()
        for item in sets:
            _check_camera(item, camera)
            if item.fingerprints:
                self._groups.append(_make_group(item, workspace, settings))
        missing = [target.label for target in self.targets if target.needs_calibration]
        if self.by_views and missing:
            LOG.warning(
                "no stored limits for %s: computing them takes about a second each; fingerprint the session again to "
                "store them",
                ", ".join(missing),
            )

    @property
    def targets(self) -> List[SearchTarget]:
        """Every fingerprint that is searched for, grouped by session."""
        return [target for _, group in self._groups for target in group]

    @property
    def open_count(self) -> int:
        """Number of fingerprints whose decision more images may change, as of the last call of `decide`."""
        return len(self.targets) - len(self._closed)

    @property
    def by_views(self) -> bool:
        """Whether decisions are made by comparing views, not by the belief alone."""
        return self._settings.decision == VERIFIED

    def reset(self) -> None:
        """Forget the stream, to search another scene. What was learned about the fingerprints is kept."""
        self._start()
        for target in self.targets:
            target.reset(BeliefGrid(self._workspace, self._settings))

    def _start(self) -> None:
        """Start a stream."""
        self._weights = EvidenceWeights(self._settings)
        self.image_count = 0
        self.all_closed = False
        """Whether more images change no decision, whatever the outcomes, as of the last call of `decide`."""
        self.open_places: np.ndarray = np.empty((0, 2))
        """(P, 2) places [m] that need more views, as of the last call of `decide`."""
        self._closed: Dict[str, List[Decision]] = {}
        self._scene: Optional[ObservedScene] = None

    def observe(self, states: np.ndarray, images: np.ndarray) -> None:
        """Process the next images of the stream.

        Args:
            states: (N, 3) camera states [m, m, rad].
            images: (N, H, W, 3) uint8.
        """
        for begin in range(0, len(states), CHUNK):
            part = slice(begin, begin + CHUNK)
            weights = self._weights.update(states[part])
            for matcher, targets in self._groups:
                for target, matches in zip(targets, matcher.match(states[part], images[part])):
                    target.observe(matches, weights)
            self.image_count += len(states[part])

    def decide(self, states: np.ndarray, images: np.ndarray) -> List[Decision]:
        """Decide for every fingerprint, given the states (N, 3) [m, m, rad] and images of the stream so far.

        May be called after any number of images: the decision of a closed fingerprint is kept.
        """
        self._scene = ObservedScene(states, images, self._camera, self._workspace, self._settings.margin)
        results = [
            result
            for _, targets in self._groups
            for result in self._rule.decide(targets, self._scene, closed=self._closed)
        ]
        self._closed = {result.target.label: result.candidates for result in results if not result.is_open}
        self.all_closed = not any(result.is_open for result in results)
        self.open_places = np.array([place for result in results for place in result.open_places]).reshape(-1, 2)
        return [decision for result in results for decision in result.decisions]

    def unknown_objects(self, decisions: Sequence[Decision]) -> List[UnknownObject]:
        """Return what stands where none of the last decisions found an object, the largest one first."""
        if self._scene is None:
            return []
        return find_unknown(self._scene.views, self._scene.mosaic, decisions, self._settings.separation)


def _make_group(
    fingerprint_set: FingerprintSet, workspace: Workspace, settings: IdentificationConfig
) -> Tuple[Matcher, List[SearchTarget]]:
    """Build the matcher and the search targets of one session."""
    model = _load_model(fingerprint_set)
    matcher = Matcher(model, fingerprint_set.fingerprints, settings)
    targets = []
    for fingerprint in fingerprint_set.fingerprints:
        grid = BeliefGrid(workspace, settings)
        targets.append(SearchTarget(fingerprint_set, fingerprint, model, matcher.threshold, grid, settings.error_rate))
    return matcher, targets


def _check_names(sets: Sequence[FingerprintSet]) -> None:
    """Check that no two sets have labels in common, by which decisions and results are stored."""
    names = [item.session for item in sets]
    duplicate = next((name for name in names if names.count(name) > 1), "")
    if duplicate:
        raise SessionError(
            f"two sets of fingerprints are of sessions named {duplicate}: results are stored by that name; identify "
            "with one of them at a time"
        )


def _load_model(fingerprint_set: FingerprintSet) -> TrainedModel:
    """Build the model of a session's fingerprints."""
    try:
        return TrainedModel(fingerprint_set.config, fingerprint_set.weights)
    except RuntimeError as error:
        raise CorruptFileError(
            f"the model of session {fingerprint_set.session}'s fingerprints does not match the session's camera and "
            f"model settings ({' '.join(str(error).split())}): fingerprint the session again"
        ) from error


def _check_camera(fingerprint_set: FingerprintSet, camera: CameraConfig) -> None:
    """Check that a session was trained with the camera of the stream."""
    for item in fields(camera):
        trained, given = getattr(fingerprint_set.config.camera, item.name), getattr(camera, item.name)
        if item.metadata["fixed"] and trained != given:
            raise ConfigError(
                f"camera mismatch: session {fingerprint_set.session} was trained with camera/{item.name} = {trained}, "
                f"the images have {given}; use images of the same camera, or train again"
            )
