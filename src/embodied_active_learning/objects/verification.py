"""Whether what stands at a candidate pose looks like the fingerprint: compares several views of it with its own views.

A belief's peak tells where a fingerprint fits best, not that it fits: when its object is absent, the peak lies on
another object. The decoder has learned which image belongs to which latent at which state (paper, Sec. 4: that is what
the gamma term trains), so it reproduces a view badly, and says that it is unsure, when something else is in view; bare
table it reproduces too well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, NamedTuple, Sequence

import numpy as np

from embodied_active_learning.config import CameraConfig, Config, IdentificationConfig
from embodied_active_learning.geometry import metres_per_pixel, move, pixels_of, pose_distance
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint

_NEAR = (0.015, 0.4)
"""Distance [m] and turn [rad] that count alike when the stored view next to a pose is sought."""


@dataclass(frozen=True)
class Comparison:
    """How V views of a candidate compare with the fingerprint."""

    views: np.ndarray  # (V,) indices of the images
    residual: np.ndarray  # (V,) grey levels of 1: how much worse they are explained than the fingerprint's own views

    @property
    def typical(self) -> float:
        """Median residual; infinite without views."""
        return float(np.median(self.residual)) if len(self.residual) else float("inf")


class Verifier:
    """Compares views of candidates with one fingerprint."""

    def __init__(
        self, model: TrainedModel, fingerprint: Fingerprint, trained: Config, settings: IdentificationConfig
    ) -> None:
        """trained: the configuration that the model was trained with."""
        self._model = model
        self._fingerprint = fingerprint
        self._camera = trained.camera
        self._workspace = trained.workspace.box()
        self._settings = settings
        self._by_pixels = settings.features == "pixels"
        self._own = float(np.median(self._own_errors()))

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
        discs = self._discs(states[views], candidate)
        errors = self._errors(stored, images[views], discs)
        return Comparison(views, errors - self._own)

    def _own_errors(self) -> np.ndarray:
        """(V,) how badly each of the fingerprint's own views is explained; its latents are stored with it."""
        own = self._fingerprint
        discs = self._discs(own.states, own.centre)
        if self._by_pixels:
            return _rms(own.images, self._nearest_views(own.states, itself=True), discs)
        return self._decoded_errors(own.latent_means, own.states, own.images, discs)

    def _errors(self, stored: np.ndarray, images: np.ndarray, discs: Sequence[_Disc]) -> np.ndarray:
        """(V,) how badly each image is explained, grey levels of 1, within its disc.

        stored: (V, 3) where the camera would be over the fingerprint's object.
        """
        if self._by_pixels:
            return _rms(images, self._nearest_views(stored), discs)
        latents, _ = self._model.encode(stored, images)
        return self._decoded_errors(latents, stored, images, discs)

    def _decoded_errors(
        self, latents: np.ndarray, stored: np.ndarray, images: np.ndarray, discs: Sequence[_Disc]
    ) -> np.ndarray:
        predicted, std = self._model.decode(latents, stored)
        error = _rms(images, predicted, discs)
        # The predicted standard deviation is that of the whole image, and around a blank place there may be anything.
        return error if self._fingerprint.kind == BLANK else error + std

    def _nearest_views(self, stored: np.ndarray, itself: bool = False) -> np.ndarray:
        """The fingerprint's images (V, H, W, 3) in [0, 1] from next to each pose; never the same view as itself."""
        distance, turn = pose_distance(stored[:, None], self._fingerprint.states)
        away = np.square(distance / _NEAR[0]) + np.square(turn / _NEAR[1])
        if itself:
            np.fill_diagonal(away, np.inf)
        return np.divide(self._fingerprint.images[away.argmin(axis=1)], 255.0, dtype=np.float32)

    def _discs(self, states: np.ndarray, centre: np.ndarray) -> List[_Disc]:
        """For each state (V, 3), where its image shows the table within the object's radius of a centre."""
        radius = self._settings.object_radius / metres_per_pixel(self._camera)
        middles = zip(*pixels_of(states, centre, self._camera))
        return [_disc(row, column, radius, self._camera) for row, column in middles]


class _Disc(NamedTuple):
    """The pixels of an image within a radius of a point: a window, and which of its pixels they are."""

    rows: slice
    columns: slice
    inside: np.ndarray  # (h, w) bool


def _disc(row: float, column: float, radius: float, camera: CameraConfig) -> _Disc:
    """All in pixels; what lies outside of the image is left out."""
    rows, columns = _window(row, radius, camera.height), _window(column, radius, camera.width)
    down, right = np.arange(camera.height)[rows, None] - row, np.arange(camera.width)[columns] - column
    return _Disc(rows, columns, np.square(down) + np.square(right) < radius**2)


def _window(middle: float, radius: float, length: int) -> slice:
    begin = min(max(math.ceil(middle - radius), 0), length)
    return slice(begin, max(begin, math.floor(middle + radius) + 1))


def _rms(images: np.ndarray, predicted: np.ndarray, discs: Sequence[_Disc]) -> np.ndarray:
    """Root mean square (V,) of images (V, H, W, 3) uint8 less predicted ones in [0, 1], over discs; 0 over none.

    In single precision but for the sum: to 1e-6.
    """
    errors = np.zeros(len(images))
    for index, (rows, columns, inside) in enumerate(discs):
        difference = np.divide(images[index, rows, columns], 255.0, dtype=np.float32)
        difference -= predicted[index, rows, columns]
        squares = np.einsum("ijc,ijc->ij", difference, difference)[inside]
        errors[index] = squares.sum(dtype=np.float64) / (images.shape[3] * max(len(squares), 1))
    return np.sqrt(errors)
