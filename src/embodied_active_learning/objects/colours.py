"""Colour features that change little with the light, and the colours of the table.

A feature is (log luminance, red and green share of the colour). A change of brightness adds a constant to the first
component and leaves the others, so light can be corrected where images are compared; so can the white balance. Dark
pixels are an exception: constants keep their features stable, see log_luminance and dark_factor. Shares are multiplied
by three: a small relative change of one channel is then about as large in either kind of component.
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
"""Added to luminance and to the sum of channels (1 and 3 are white), so that dark pixels have stable features."""
_MIN_LUMINANCE = 0.004
"""Smallest luminance (1 is white) for which features are corrected: one level in each channel."""
_LEVELS: np.ndarray = np.arange(_WHITE + 1, dtype=np.float32)
_LOG_LUMINANCE = np.log(_LEVELS / _WHITE + _DARK_LUMINANCE)
_SHARE: np.ndarray = (3.0 / (_LEVELS + 255.0 * _DARK_COLOUR)).astype(np.float32)
_MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""
_CLUSTERS = 8
_FIT_PIXELS = 8000
_MIN_SHARE = 0.005
"""Share of a place's pixels from which a colour belongs to it."""
_STRIDE = 5
_NOISE = 0.03
"""Smallest standard deviation of a table colour, in features: a plain table has none."""
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
    """Value (256,) uint8 whose mean under this noise, cut off at 0 and 255, is 0, 1, ... 255."""
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
    """Squared distance (...) of the three shares, given the change of red and green (..., 2): blue is the rest."""
    red, green = change[..., 0], change[..., 1]
    return red**2 + green**2 + (red + green) ** 2


def colours_of(features: np.ndarray) -> np.ndarray:
    """Return the colours (..., 3) of features (..., 3), between 0 and 255 but for impossible features; not rounded."""
    total = _WHITE * np.maximum(np.exp(features[..., 0]) - _DARK_LUMINANCE, 0.0)
    shown = features[..., 1:] * ((total + 255.0 * _DARK_COLOUR) / 3.0)[..., None]
    return np.concatenate([shown, (total - shown.sum(axis=-1))[..., None]], axis=-1)


def luminance_of(features: np.ndarray) -> np.ndarray:
    """Return the luminance (...) of features (..., 3): 1 is white, the least is one level in each channel."""
    return np.maximum(np.exp(features[..., 0]) - _DARK_LUMINANCE, _MIN_LUMINANCE)


def log_luminance(luminance: np.ndarray) -> np.ndarray:
    """Return the first feature of pixels with a luminance: its logarithm, but for what is added to dark pixels."""
    return np.asarray(np.log(luminance + _DARK_LUMINANCE))


def dark_factor(luminance: np.ndarray) -> np.ndarray:
    """Return the factor by which what is added to dark pixels lowers the shares of pixels with a luminance."""
    return np.asarray(luminance / (luminance + _DARK_COLOUR / 3.0))


def balance_jacobian(features: np.ndarray) -> np.ndarray:
    """Return the Jacobian (..., 2, 2) of the red and green shares of features (..., 3) under white balance.

    The variables are the log gains of red and of green relative to blue. White balance multiplies channels, so it
    moves the share of a channel that is already dark little.
    """
    shares = features[..., 1:]
    diagonal = shares[..., None] * np.eye(2, dtype=np.float32)
    return np.asarray(diagonal - shares[..., :, None] * shares[..., None, :] / 3.0)


class TableColours:
    """The colours of the bare table: clusters, each with its covariance."""

    def __init__(self, places: Sequence[np.ndarray], min_share: float = 0.0) -> None:
        """Fit to features (N, 3) of pixels around several places of the table.

        Colours that only one place shows are left out: they may be those of an object that reaches far.

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
        fingerprints: All of its set; what is near the centre of an object among them is no table.
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
