"""The measurement: which stored view of a fingerprint a new image is most like, and what that says (appendix)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import cv2
import numpy as np

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.geometry import move
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.fingerprint import Fingerprint

PIXELS = 30
"""Side of the picture that the baseline compares instead of latents."""


@dataclass(frozen=True)
class Matches:
    """What N images say about one fingerprint."""

    view: np.ndarray  # (N,) int32: the stored view that is most like the image
    distance: np.ndarray  # (N,) float32: L2 distance of their latents
    value: np.ndarray  # (N,) float32 in (0, 1): the measurement, 1/2 at the threshold
    pose: np.ndarray  # (N, 3) float64 m, m, rad: where the object is if the image shows it


class Matcher:
    """Compares images with all fingerprints of one model; an image is encoded once for all of them."""

    def __init__(
        self, model: TrainedModel, fingerprints: Sequence[Fingerprint], settings: IdentificationConfig
    ) -> None:
        """The threshold is the smallest distance between views of different fingerprints (paper, appendix).

        Raises ObservationError for one fingerprint of one view.
        """
        self._model = model
        self._fingerprints = tuple(fingerprints)
        self._by_pixels = settings.features == "pixels"
        self._states = np.concatenate([item.states for item in fingerprints])
        self._starts = np.cumsum([0, *(len(item.states) for item in fingerprints)])
        own = [_pixels(item.images) if self._by_pixels else item.latent_means for item in fingerprints]
        self._stored = np.concatenate(own)
        self.threshold, self.largest = _threshold(own)

    def match(self, states: np.ndarray, images: np.ndarray) -> List[Matches]:
        """Compare images (N, H, W, 3) uint8 from states (N, 3) [m, m, rad] -> one Matches for each fingerprint."""
        distances = self._distances(images)
        found = []
        for item, begin, end in zip(self._fingerprints, self._starts, self._starts[1:]):
            view = distances[:, begin:end].argmin(axis=1)
            distance = distances[np.arange(len(view)), begin + view]
            pose = move(item.centre, item.states[view], states)
            found.append(Matches(view.astype(np.int32), distance, self.value(distance), pose))
        return found

    def value(self, distance: np.ndarray) -> np.ndarray:
        """Measurement of a distance: 0.88 for none, 1/2 at the threshold, towards 0.12 for the largest ones."""
        threshold, span = self.threshold, max(2.0 * self.largest - self.threshold, 1e-9)
        scale = np.where(distance < threshold, threshold, span)
        return (0.5 + 0.5 * np.tanh((threshold - distance) / scale)).astype(np.float32)

    def _distances(self, images: np.ndarray) -> np.ndarray:
        """(N, V) float32 from each image to each stored view of any fingerprint."""
        if self._by_pixels:
            return _pairwise(_pixels(images), self._stored)
        latents = self._model.encode_pairs(self._states, self._model.image_features(images))
        return np.linalg.norm(latents - self._stored, axis=2)


def _threshold(own: Sequence[np.ndarray]) -> Tuple[float, float]:
    """Smallest and largest distance between views of different fingerprints; of one alone, between its own views."""
    if len(own) == 1:
        distances = _pairwise(own[0], own[0])[np.triu_indices(len(own[0]), 1)]
    else:
        distances = np.concatenate(
            [_pairwise(one, other).ravel() for index, one in enumerate(own) for other in own[:index]]
        )
    if not distances.size:
        raise ObservationError(
            "a single view leaves nothing to tell a near match from a far one: raise fingerprint/views, and call "
            "/fingerprint again"
        )
    return float(max(distances.min(), 1e-9)), float(distances.max())


def _pairwise(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances (N, M) between vectors (N, K) and (M, K)."""
    squares = np.square(one).sum(axis=1)[:, None] + np.square(other).sum(axis=1) - 2.0 * one @ other.T
    return np.sqrt(np.maximum(squares, 0.0)).astype(np.float32)


def _pixels(images: np.ndarray) -> np.ndarray:
    """Images as small pictures in one vector each, (N, 30 * 30 * 3) in [0, 1]."""
    small = [cv2.resize(image, (PIXELS, PIXELS), interpolation=cv2.INTER_AREA).ravel() for image in images]
    return np.stack(small).astype(np.float64) / 255.0
