"""What a real robot adds to a clean simulation, drawn from one seed."""

from __future__ import annotations

import math

import numpy as np

from embodied_active_learning.simulation.world import Disturbances

_DRIFT_TIME = 30.0  # s in which the brightness forgets what it was
_STREAM = 0xD157  # keeps these draws apart from others made with the same seed


class Disturbance:
    """Draws noise for commands and images; draws nothing, and changes nothing, where its strength is zero."""

    def __init__(self, strength: Disturbances, seed: int) -> None:
        self._strength = strength
        self._generator = np.random.default_rng([_STREAM, seed])
        self._drift = strength.brightness_drift * self._generator.standard_normal()
        self._drifted_at = 0.0

    def actuation(self) -> np.ndarray:
        """(3,) m/s, m/s, rad/s by which the arm misses a commanded velocity."""
        noise = np.asarray(self._strength.actuation_noise)
        return noise * self._generator.standard_normal(3) if noise.any() else noise

    def image(self, image: np.ndarray, time: float) -> np.ndarray:
        """An image (H, W, 3) uint8 as a real camera would give it at a time, s."""
        if self._strength.brightness_drift == 0.0 and self._strength.image_noise == 0.0:
            return image
        levels = image * (1.0 + self._brightness(time))
        if self._strength.image_noise > 0.0:
            levels += self._strength.image_noise * self._generator.standard_normal(image.shape)
        return np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)

    def _brightness(self, time: float) -> float:
        """Relative brightness error at a time: it wanders, and keeps its standard deviation."""
        kept = math.exp((self._drifted_at - time) / _DRIFT_TIME)
        fresh = self._strength.brightness_drift * math.sqrt(1.0 - kept**2)
        if fresh > 0.0:
            self._drift = kept * self._drift + fresh * self._generator.standard_normal()
            self._drifted_at = time
        return self._drift
