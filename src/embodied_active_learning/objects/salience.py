"""What stands out from the bare table in an image."""

from __future__ import annotations

import numpy as np

_BEGIN = 4.0
"""Distance from the table's colour, in standard deviations, at which a pixel begins to stand out."""
_FULL = 8.0
"""... and from which on it fully does."""
_NOISE = 2.0
"""Least standard deviation of the table's colour, grey levels: a plain table has none."""
_STRIDE = 6
_INLIERS = 0.9


class Background:
    """The colours of the bare table: a Gaussian, fitted robustly because an object's edge may be in view."""

    def __init__(self, images: np.ndarray) -> None:
        """Fit to images (N, H, W, 3) uint8 that show mostly table."""
        pixels = images[:, ::_STRIDE, ::_STRIDE].reshape(-1, 3).astype(np.float64)
        self._colour = np.median(pixels, axis=0)
        deviations = pixels - self._colour
        size = np.abs(deviations).sum(axis=1)
        inliers = deviations[size <= np.quantile(size, _INLIERS)]
        covariance = inliers.T @ inliers / len(inliers) + _NOISE**2 * np.eye(3)
        self._whitening = np.linalg.cholesky(np.linalg.inv(covariance))

    def salience(self, image: np.ndarray) -> np.ndarray:
        """How much each pixel of an image (H, W, 3) uint8 stands out, 0 to 1. -> (H, W)."""
        distance = np.linalg.norm((image - self._colour) @ self._whitening, axis=-1)
        return np.clip((distance - _BEGIN) / (_FULL - _BEGIN), 0.0, 1.0)
