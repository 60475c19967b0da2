"""Whether what stands at a candidate pose looks like the fingerprint: compares several views of it with its own views.

A belief's peak tells where a fingerprint fits best, not that it fits: when its object is absent, the peak lies on
another object. The decoder has learned which image belongs to which latent at which state (paper, Sec. 4: that is what
the gamma term trains), so it reproduces a view badly, and says that it is unsure, when something else is in view; bare
table it reproduces too well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from embodied_active_learning.config import Config, IdentificationConfig
from embodied_active_learning.geometry import move, pose_distance, table_grid
from embodied_active_learning.model.learned import LearnedModel
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint

_NEAR = (0.015, 0.4)
"""Distance [m] and turn [rad] that count alike when the stored view next to a pose is sought."""


@dataclass(frozen=True)
class Comparison:
    """How V views of a candidate compare with the fingerprint."""

    views: np.ndarray  # (V,) indices of the images
    mismatch: np.ndarray  # (V,) grey levels of 1: how much worse they are explained than the fingerprint's own views

    @property
    def typical(self) -> float:
        """Median mismatch; infinite without views."""
        return float(np.median(self.mismatch)) if len(self.mismatch) else float("inf")


class Verifier:
    """Compares views of candidates with one fingerprint."""

    def __init__(
        self, model: LearnedModel, fingerprint: Fingerprint, trained: Config, settings: IdentificationConfig
    ) -> None:
        """trained: the configuration that the model was trained with."""
        self._model = model
        self._fingerprint = fingerprint
        self._camera = trained.camera
        self._workspace = trained.workspace.box()
        self._settings = settings
        self._by_pixels = settings.features == "pixels"
        own = fingerprint.states, fingerprint.states, fingerprint.images, fingerprint.centre
        self._own = float(np.median(self._errors(*own, itself=True)))

    def views(self, candidate: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Which of the images from states (N, 3) show a candidate pose (3,) [m, m, rad]: their indices (V,).

        Those are seen from next to it, and from where the camera could also stand over the fingerprint's object; the
        nearest ones, if there are more than settings.views.
        """
        distance, _ = pose_distance(states, candidate)
        stored = move(states, candidate, self._fingerprint.centre)
        usable = np.flatnonzero((distance < self._settings.view_distance) & self._workspace.contains(stored))
        return usable[np.argsort(distance[usable], kind="stable")[: self._settings.views]]

    def compare(self, candidate: np.ndarray, states: np.ndarray, images: np.ndarray) -> Comparison:
        """Compare those of the images (N, H, W, 3) from states (N, 3) that show a candidate pose (3,) [m, m, rad]."""
        views = self.views(candidate, states)
        if not len(views):
            return Comparison(views, np.empty(0))
        stored = move(states[views], candidate, self._fingerprint.centre)
        errors = self._errors(stored, states[views], images[views], candidate)
        return Comparison(views, errors - self._own)

    def _errors(
        self, stored: np.ndarray, states: np.ndarray, images: np.ndarray, centre: np.ndarray, itself: bool = False
    ) -> np.ndarray:
        """(V,) how badly each image is explained, grey levels of 1.

        stored: (V, 3) where the camera would be over the fingerprint's object; states: (V, 3) where it is over the
        candidate, whose centre is given. itself: the images are the fingerprint's own.
        """
        on_object = self._on_object(states, centre)
        if self._by_pixels:
            return _rms(images / 255.0 - self._nearest_views(stored, itself), on_object)
        latents, _ = self._model.encode(stored, images)
        predicted, std = self._model.decode(latents, stored)
        error = _rms(images / 255.0 - predicted, on_object)
        # The predicted standard deviation is that of the whole image, and around a blank place there may be anything.
        return error if self._fingerprint.kind == BLANK else error + std

    def _nearest_views(self, stored: np.ndarray, itself: bool) -> np.ndarray:
        """The fingerprint's images (V, H, W, 3) in [0, 1] from next to each pose; never the same view as itself."""
        distance, turn = pose_distance(stored[:, None], self._fingerprint.states)
        away = np.square(distance / _NEAR[0]) + np.square(turn / _NEAR[1])
        if itself:
            np.fill_diagonal(away, np.inf)
        return self._fingerprint.images[away.argmin(axis=1)] / 255.0

    def _on_object(self, states: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """(V, H, W) whether a pixel shows the table within the object's radius of its centre."""
        away = np.linalg.norm(table_grid(states, self._camera) - np.asarray(centre)[:2], axis=-1)
        return away < self._settings.object_radius


def _rms(difference: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Root mean square (V,) of differences (V, H, W, 3) over masked pixels (V, H, W)."""
    squares = np.square(difference).mean(axis=3) * mask
    return np.sqrt(squares.sum(axis=(1, 2)) / np.maximum(mask.sum(axis=(1, 2)), 1))
