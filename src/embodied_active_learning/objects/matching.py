"""Measurement model: the stored view of a fingerprint that is most similar to a new image, and the pose it implies.

Paper, appendix "Object Identification", steps 1 to 3: the encoder is evaluated for the image paired with each stored
state, and the stored view with the smallest L2 distance between latents is the most likely measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import cv2
import numpy as np
from scipy.spatial.distance import cdist

from embodied_active_learning.config import PIXELS, IdentificationConfig
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.geometry import transform_poses
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.fingerprint import Fingerprint

PIXEL_SIDE = 30
"""Side [px] of the downscaled images that the pixel baseline compares in place of latents."""


@dataclass(frozen=True)
class Matches:
    """Measurements of one fingerprint in N images.

    Attributes:
        view: (N,) int32 index of the most similar stored view.
        distance: (N,) float32 L2 distance between the latents of image and stored view.
        value: (N,) float32 in (0, 1), the measurement; 1/2 at the distance threshold.
        pose: (N, 3) float64 pose [m, m, rad] of the object if the image shows it.
    """

    view: np.ndarray
    distance: np.ndarray
    value: np.ndarray
    pose: np.ndarray


class Matcher:
    """Compares images with all fingerprints of one model; the convolutions run once per image."""

    def __init__(
        self, model: TrainedModel, fingerprints: Sequence[Fingerprint], settings: IdentificationConfig
    ) -> None:
        """Compute the distance threshold: the smallest distance between different fingerprints (Paper, appendix).

        Raises:
            ObservationError: For a single fingerprint with a single view.
        """
        self._model = model
        self._fingerprints = tuple(fingerprints)
        self._by_pixels = settings.features == PIXELS
        self._states = np.concatenate([item.states for item in fingerprints])
        self._starts = np.cumsum([0, *(len(item.states) for item in fingerprints)])
        own = [_pixels(item.images) if self._by_pixels else item.latent_means for item in fingerprints]
        self._stored = np.concatenate(own)
        self.threshold, self.largest = _threshold(own)

    def match(self, states: np.ndarray, images: np.ndarray) -> List[Matches]:
        """Compare images with every fingerprint.

        Args:
            states: (N, 3) camera states [m, m, rad].
            images: (N, H, W, 3) uint8.

        Returns:
            One Matches of length N for each fingerprint.
        """
        distances = self._distances(images)
        found = []
        for item, begin, end in zip(self._fingerprints, self._starts, self._starts[1:]):
            view = distances[:, begin:end].argmin(axis=1)
            distance = distances[np.arange(len(view)), begin + view]
            pose = transform_poses(item.centre, item.states[view], states)
            found.append(Matches(view.astype(np.int32), distance, self.value(distance), pose))
        return found

    def value(self, distance: np.ndarray) -> np.ndarray:
        """Return the measurement (N,) for distances (N,): 0.88 at distance 0, 1/2 at the threshold, decreasing to 0.

        The paper gives the threshold but not the function; a tanh with different widths on both sides is our choice.
        """
        threshold, span = self.threshold, max(2.0 * self.largest - self.threshold, 1e-9)
        scale = np.where(distance < threshold, threshold, span)
        return (0.5 + 0.5 * np.tanh((threshold - distance) / scale)).astype(np.float32)

    def _distances(self, images: np.ndarray) -> np.ndarray:
        """Distances (N, V) float32 from each image to all stored views of all fingerprints."""
        if self._by_pixels:
            return _pairwise(_pixels(images), self._stored)
        latents = self._model.encode_pairs(self._states, self._model.image_features(images))
        return np.linalg.norm(latents - self._stored, axis=2)


def _threshold(own: Sequence[np.ndarray]) -> Tuple[float, float]:
    """Smallest and largest distance between different fingerprints, or between the views of a single fingerprint."""
    if len(own) == 1:
        distances = _pairwise(own[0], own[0])[np.triu_indices(len(own[0]), 1)]
    else:
        distances = np.concatenate(
            [_pairwise(one, other).ravel() for index, one in enumerate(own) for other in own[:index]]
        )
    if not distances.size:
        raise ObservationError(
            "no distance threshold: the only fingerprint has a single view; raise fingerprint/views, then "
            "fingerprint the session again"
        )
    return float(max(distances.min(), 1e-9)), float(distances.max())


def _pairwise(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Euclidean distances (N, M) float32 between vectors (N, K) and (M, K)."""
    return cdist(one, other).astype(np.float32)  # direct differences: precise also for nearly equal vectors


def _pixels(images: np.ndarray) -> np.ndarray:
    """Downscaled images as vectors (N, 30 * 30 * 3) in [0, 1]."""
    small = [cv2.resize(image, (PIXEL_SIDE, PIXEL_SIDE), interpolation=cv2.INTER_AREA).ravel() for image in images]
    return np.stack(small).astype(np.float64) / 255.0
