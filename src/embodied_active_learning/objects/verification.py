"""Comparison of views of a candidate pose with the fingerprint's own views.

A belief's peak is where a fingerprint fits best, not proof that it fits: if its object is absent, the peak lies on
another object. The decoder has learned which image belongs to which latent at which state (Paper, Sec. 4: trained by
the gamma term). So if something else is in view, it reconstructs the view badly and predicts a large standard
deviation; bare table it reconstructs better than an object.

Assumptions beyond the paper: a camera that looks straight down from a known height, and objects within
`identification/object_radius` of their centre.
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

_CHANNELS = 3
_NEAREST_VIEW_SCALE = (0.015, 0.4)
"""Distance [m] and turn [rad] of equal weight in the search for the stored view that is nearest to a state."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of V views of a candidate with the fingerprint.

    Attributes:
        views: (V,) indices of the images.
        residual: (V,) reconstruction error minus the median error of the fingerprint's own views, in grey levels of
            [0, 1]; negative if a view is reconstructed better than the fingerprint's own views.
    """

    views: np.ndarray
    residual: np.ndarray

    @property
    def median(self) -> float:
        """Median residual; infinite without views."""
        return float(np.median(self.residual)) if len(self.residual) else float("inf")


class Verifier:
    """Compares views of candidates with one fingerprint."""

    def __init__(
        self, model: TrainedModel, fingerprint: Fingerprint, trained: Config, settings: IdentificationConfig
    ) -> None:
        """Compute the error of the fingerprint's own views.

        Args:
            model: The model that encoded the fingerprint.
            fingerprint: What the views are compared with.
            trained: The configuration that the model was trained with.
            settings: How to select and compare views.
        """
        self._model = model
        self._fingerprint = fingerprint
        self._camera = trained.camera
        self._workspace = trained.workspace.box()
        self._settings = settings
        self._by_pixels = settings.features == "pixels"
        self._own = float(np.median(self._own_errors()))

    def views(self, candidate: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Return the indices (V,) of the images that can be compared, nearest first, at most `settings.views`.

        An image can be compared if it was taken near the candidate, and if the camera could take the same view of the
        fingerprint's object within the workspace.

        Args:
            candidate: (3,) pose [m, m, rad].
            states: (N, 3) camera states [m, m, rad] of the images.
        """
        distance, _ = pose_distance(states, candidate)
        stored = move(states, candidate, self._fingerprint.centre)
        usable = np.flatnonzero((distance < self._settings.view_distance) & self._workspace.contains(stored))
        return usable[np.argsort(distance[usable], kind="stable")[: self._settings.views]]

    def compare(self, candidate: np.ndarray, states: np.ndarray, images: np.ndarray) -> Comparison:
        """Compare the views of a candidate pose (3,) among the images (N, H, W, 3) uint8 from states (N, 3)."""
        views = self.views(candidate, states)
        if not len(views):
            return Comparison(views, np.empty(0))
        stored = move(states[views], candidate, self._fingerprint.centre)
        discs = self._discs(states[views], candidate)
        errors = self._errors(stored, images[views], discs)
        return Comparison(views, errors - self._own)

    def _own_errors(self) -> np.ndarray:
        """Reconstruction errors (V,) of the fingerprint's own views, from its stored latents."""
        own = self._fingerprint
        discs = self._discs(own.states, own.centre)
        if self._by_pixels:
            return _rms(own.images, self._nearest_views(own.states, itself=True), discs)
        return self._decoded_errors(own.latent_means, own.states, own.images, discs)

    def _errors(self, stored: np.ndarray, images: np.ndarray, discs: Sequence[_Disc]) -> np.ndarray:
        """Reconstruction errors (V,) of images within their discs.

        stored: (V, 3) states at which the camera would take the same views of the fingerprint's object.
        """
        if self._by_pixels:
            return _rms(images, self._nearest_views(stored), discs)
        latents, _ = self._model.encode(stored, images)
        return self._decoded_errors(latents, stored, images, discs)

    def _decoded_errors(
        self, latents: np.ndarray, stored: np.ndarray, images: np.ndarray, discs: Sequence[_Disc]
    ) -> np.ndarray:
        """RMS errors (V,) of decoded images, plus the predicted standard deviation for an object."""
        predicted, std = self._model.decode(latents, stored)
        error = _rms(images, predicted, discs)
        # The standard deviation is predicted for the whole image, and anything may stand next to a blank place.
        return error if self._fingerprint.kind == BLANK else error + std

    def _nearest_views(self, stored: np.ndarray, itself: bool = False) -> np.ndarray:
        """Stored images (V, H, W, 3) in [0, 1] nearest to each state; `itself` excludes identical views."""
        distance, turn = pose_distance(stored[:, None], self._fingerprint.states)
        separation = np.square(distance / _NEAREST_VIEW_SCALE[0]) + np.square(turn / _NEAREST_VIEW_SCALE[1])
        if itself:
            np.fill_diagonal(separation, np.inf)
        return np.divide(self._fingerprint.images[separation.argmin(axis=1)], 255.0, dtype=np.float32)

    def _discs(self, states: np.ndarray, centre: np.ndarray) -> List[_Disc]:
        """Pixels of each image that show the table within the object's radius of a centre, from states (V, 3)."""
        radius = self._settings.object_radius / metres_per_pixel(self._camera)
        middles = zip(*pixels_of(states, centre, self._camera))
        return [_disc(row, column, radius, self._camera) for row, column in middles]


class _Disc(NamedTuple):
    """The pixels of an image within a radius of a point: a window and a mask in it."""

    rows: slice
    columns: slice
    inside: np.ndarray  # (h, w) bool


def _disc(row: float, column: float, radius: float, camera: CameraConfig) -> _Disc:
    """Return the disc around a point, in pixels, clipped to the image."""
    rows, columns = _window(row, radius, camera.height), _window(column, radius, camera.width)
    down, right = np.arange(camera.height)[rows, None] - row, np.arange(camera.width)[columns] - column
    return _Disc(rows, columns, np.square(down) + np.square(right) < radius**2)


def _window(middle: float, radius: float, length: int) -> slice:
    """Indices within a radius of a point, clipped to the length."""
    begin = min(max(math.ceil(middle - radius), 0), length)
    return slice(begin, max(begin, math.floor(middle + radius) + 1))


def _rms(images: np.ndarray, predicted: np.ndarray, discs: Sequence[_Disc]) -> np.ndarray:
    """RMS difference (V,) of images (V, H, W, 3) uint8 and predictions in [0, 1] over discs; 0 over an empty disc.

    Only the sum is in double precision; the result is accurate to 1e-6.
    """
    errors = np.zeros(len(images))
    for index, (rows, columns, inside) in enumerate(discs):
        difference = np.divide(images[index, rows, columns], 255.0, dtype=np.float32)
        difference -= predicted[index, rows, columns]
        squares = np.einsum("ijc,ijc->ij", difference, difference)[inside]
        errors[index] = squares.sum(dtype=np.float64) / (_CHANNELS * max(len(squares), 1))
    return np.sqrt(errors)
