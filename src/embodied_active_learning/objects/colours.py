"""Colour features that change little with the light, and the colours of the table.

A feature is (log luminance, red and green share of the colour). A change of brightness adds a constant to the first
component and leaves the others, so light can be corrected where images are compared; so can the white balance. Shares
are multiplied by three: a small relative change of one channel is then about as large in either kind of component.

Noise would dominate the features of dark pixels. Features are therefore regularised: constants are added to the
luminance before its logarithm is taken, and to the sum of the channels before they are divided by it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import List, Sequence

import cv2
import numpy as np
from scipy.special import ndtr

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import metres_per_pixel, table_points
from embodied_active_learning.objects.fingerprint import OBJECT, Fingerprint

BLUR = 0.0012
"""Standard deviation of the blur before images are compared [m on the table]: suppresses noise and sampling."""
GRADIENT_UNIT = 0.05
"""Distance to which a gradient of the light refers [m]."""
_WHITE = 765
"""Sum of the channels of a white pixel."""
_DARK_LUMINANCE, _DARK_COLOUR = 0.02, 0.03
"""Regularisation: added to the luminance and to the sum of the channels (1 and 3 are white)."""
_MIN_LUMINANCE = 0.004
"""Lower limit of the luminance (1 is white) of features: one level in each channel."""
_LEVELS: np.ndarray = np.arange(_WHITE + 1, dtype=np.float32)
_LOG_LUMINANCE = np.log(_LEVELS / _WHITE + _DARK_LUMINANCE)
_SHARE: np.ndarray = (3.0 / (_LEVELS + 255.0 * _DARK_COLOUR)).astype(np.float32)
_MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""
_CLUSTERS = 8
_FIT_PIXELS = 8000
_MIN_SHARE = 0.005
"""Smallest share of a place's pixels that a colour of the place has."""
_STRIDE = 5
_NOISE = 0.03
"""Standard deviation added to that of a table colour, in features: that of a plain table may be zero."""
OBJECT_REACH = 0.065
"""Distance from the centre of a fingerprint beyond which its views show the table [m]."""


def blurred(image: np.ndarray, camera: CameraConfig) -> np.ndarray:
    """Blur an image (H, W, 3) uint8 by BLUR on the table, and remove the bias that noise leaves in dark channels.

    A camera cuts values off at 0 and 255, so noise raises the mean of a dark channel: a yellow object in little light
    would gain blue.
    """
    mean = cv2.GaussianBlur(image, (0, 0), max(0.5, BLUR / metres_per_pixel(camera)))
    noise = noise_level(image)
    return cv2.LUT(mean, _without_bias(noise)) if noise > 0.0 else mean


def noise_level(image: np.ndarray) -> float:
    """Return the standard deviation of an image's noise, from the median of its finest details (Donoho, 1994)."""
    values: np.ndarray = image.astype(np.float32)
    details = values[:-1:2, :-1:2] - values[1::2, :-1:2] - values[:-1:2, 1::2] + values[1::2, 1::2]
    return float(np.median(np.abs(details))) / (2.0 * _MEDIAN_OF_NORMAL)


@lru_cache(maxsize=64)
def _without_bias(noise: float) -> np.ndarray:
    """Lookup table (256,) uint8 from the mean of a pixel with clipped noise to its value without noise."""
    values: np.ndarray = np.linspace(-3.0 * noise, 255.0 + 3.0 * noise, 4096)
    dark, bright = values / noise, (255.0 - values) / noise
    raised = noise * _normal_density(dark) - values * ndtr(-dark)
    lowered = noise * _normal_density(bright) - (255.0 - values) * ndtr(-bright)
    return np.rint(np.clip(np.interp(np.arange(256), values + raised - lowered, values), 0, 255)).astype(np.uint8)


def _normal_density(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(-0.5 * values**2) / np.sqrt(2.0 * np.pi))


def colour_features(colours: np.ndarray) -> np.ndarray:
    """Return the features (..., 3) float32 of colours (..., 3) uint8."""
    total = colours[..., 0].astype(np.int32) + colours[..., 1] + colours[..., 2]
    share = _SHARE[total]
    return np.stack([_LOG_LUMINANCE[total], colours[..., 0] * share, colours[..., 1] * share], axis=-1)


def colour_distance(change: np.ndarray) -> np.ndarray:
    """Return the squared length (...) of a change of the three shares, which sums to 0: (..., 2) of red and green."""
    red, green = change[..., 0], change[..., 1]
    return red**2 + green**2 + (red + green) ** 2


def colours_of(features: np.ndarray) -> np.ndarray:
    """Return the colours (..., 3) of features (..., 3), not rounded; outside 0 to 255 if no colour has the features."""
    total = _WHITE * np.maximum(np.exp(features[..., 0]) - _DARK_LUMINANCE, 0.0)
    shown = features[..., 1:] * ((total + 255.0 * _DARK_COLOUR) / 3.0)[..., None]
    return np.concatenate([shown, (total - shown.sum(axis=-1))[..., None]], axis=-1)


def luminance_of(features: np.ndarray) -> np.ndarray:
    """Return the luminance (...) of features (..., 3): 1 is white, at least _MIN_LUMINANCE."""
    return np.maximum(np.exp(features[..., 0]) - _DARK_LUMINANCE, _MIN_LUMINANCE)


def log_luminance(luminance: np.ndarray) -> np.ndarray:
    """Return the regularised log luminance: the first feature of pixels with a luminance."""
    return np.asarray(np.log(luminance + _DARK_LUMINANCE))


def dark_factor(luminance: np.ndarray) -> np.ndarray:
    """Return the ratio of the regularised to the true colour share at a luminance."""
    return np.asarray(luminance / (luminance + _DARK_COLOUR / 3.0))


def balance_jacobian(features: np.ndarray) -> np.ndarray:
    """Return the Jacobian (..., 2, 2) of the red and green shares of features (..., 3) under white balance.

    The variables are the log gains of red and of green relative to blue. White balance multiplies channels, so it
    hardly changes the share of a dark channel.
    """
    shares = features[..., 1:]
    diagonal = shares[..., None] * np.eye(2, dtype=np.float32)
    return np.asarray(diagonal - shares[..., :, None] * shares[..., None, :] / 3.0)


class TableColours:
    """The colours of the bare table: clusters, each with its covariance."""

    def __init__(self, places: Sequence[np.ndarray], min_share: float = 0.0) -> None:
        """Fit to features (N, 3) of pixels around several places of the table.

        Colours that only one place shows are left out: they may belong to a large object.

        Args:
            places: (N, 3) features of each place, N >= 1.
            min_share: Share of the places that must show a colour.
        """
        random = np.random.default_rng(0)
        drawn = [
            features[random.choice(len(features), min(_FIT_PIXELS // len(places), len(features)), replace=False)]
            for features in places
        ]
        chosen, source = np.concatenate(drawn), np.repeat(np.arange(len(drawn)), [len(part) for part in drawn])
        count = min(_CLUSTERS, len(chosen))
        cv2.setRNGSeed(1)
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 1e-3)
        _, found, centres = cv2.kmeans(chosen, count, None, criteria, 1, cv2.KMEANS_PP_CENTERS)
        labels = np.ravel(found)
        table = np.zeros((len(places), count))
        np.add.at(table, (source, labels), 1.0)
        table /= np.maximum(table.sum(axis=1, keepdims=True), 1.0)
        common = (table > _MIN_SHARE).sum(axis=0) >= max(min(2, len(places)), min_share * len(places))
        kept = np.flatnonzero(common) if common.any() else np.array([int(table.sum(axis=0).argmax())])
        self._centres = np.asarray(centres)[kept]
        self._whitening: List[np.ndarray] = []
        for index, centre in zip(kept, self._centres):
            change = chosen[labels == index] - centre
            covariance = change.T @ change / max(len(change), 1) + _NOISE**2 * np.eye(3)
            self._whitening.append(np.linalg.cholesky(np.linalg.inv(covariance)).astype(np.float32))

    def distance(self, features: np.ndarray) -> np.ndarray:
        """Mahalanobis distance (...) of features (..., 3) from the nearest table colour."""
        pairs = zip(self._centres, self._whitening)
        return np.min([np.linalg.norm((features - centre) @ whiten, axis=-1) for centre, whiten in pairs], axis=0)


def table_features(fingerprint: Fingerprint, fingerprints: Sequence[Fingerprint], camera: CameraConfig) -> np.ndarray:
    """Return the features (N, 3) of the pixels of a fingerprint's views that show the table.

    Args:
        fingerprint: Whose views are used.
        fingerprints: All of its set; pixels near the centre of an object among them are left out.
        camera: The camera of the views.
    """
    rows, columns = np.mgrid[0 : camera.height : _STRIDE, 0 : camera.width : _STRIDE]
    points = table_points(fingerprint.states[:, None, None], rows, columns, camera)
    bare: np.ndarray = np.ones(points.shape[:-1], dtype=bool)
    for other in fingerprints:
        if other.kind == OBJECT:
            bare &= np.hypot(*np.moveaxis(points - other.centre[:2], -1, 0)) > OBJECT_REACH
    parts = [
        colour_features(blurred(image, camera)[::_STRIDE, ::_STRIDE][shown])
        for image, shown in zip(fingerprint.images, bare)
    ]
    return np.concatenate(parts)
