"""Foreground detection: which pixels of an image differ from the bare table."""

from __future__ import annotations

import numpy as np

_FOREGROUND_BEGINS = 4.0
"""Mahalanobis distance from the table's colour up to which a pixel is background (salience 0)."""
_FOREGROUND_CERTAIN = 8.0
"""Mahalanobis distance from which on a pixel is foreground (salience 1)."""
_MIN_STD = 2.0
"""Standard deviation [grey levels] added to the table's colour: that of a plain table may be zero."""
_STRIDE = 6
"""Stride of the pixels from which the table's colour is sampled."""
_INLIERS = 0.8
"""Share of the sampled pixels that the covariance is fitted to; the rest may belong to prints or to an object."""


class Background:
    """Gaussian colour model of the bare table, fitted robustly.

    Attributes:
        colour: (3,) the table's median colour, 0 to 255.
    """

    def __init__(self, images: np.ndarray) -> None:
        """Fit to images (N, H, W, 3) uint8 that show mostly table."""
        pixels: np.ndarray = images[:, ::_STRIDE, ::_STRIDE].reshape(-1, 3).astype(np.float64)
        self.colour = np.median(pixels, axis=0)
        deviations = pixels - self.colour
        size = np.abs(deviations).sum(axis=1)
        inliers = deviations[size <= np.quantile(size, _INLIERS)]
        covariance = inliers.T @ inliers / len(inliers) + _MIN_STD**2 * np.eye(3)
        self._whitening = np.linalg.cholesky(np.linalg.inv(covariance))

    def salience(self, image: np.ndarray) -> np.ndarray:
        """Return the salience of each pixel of an image (H, W, 3) uint8: (H, W), 0 (table) to 1 (foreground)."""
        distance = np.linalg.norm((image - self.colour) @ self._whitening, axis=-1)
        return np.clip((distance - _FOREGROUND_BEGINS) / (_FOREGROUND_CERTAIN - _FOREGROUND_BEGINS), 0.0, 1.0)
