"""What a real robot adds to a clean simulation.

Each draw follows from the seed and the time alone, so that a simulation that is put back goes on as it did.
"""

from __future__ import annotations

import math

import numpy as np

from embodied_active_learning.simulation.world import Disturbances

_DRIFT_TIME = 30.0  # s in which the brightness forgets what it was
_WAVES = 64  # of which the drift is made
_STREAM = 0xD157  # keeps these draws apart from others made with the same seed
_DRIFT, _ACTUATION, _IMAGE = range(3)


class Disturbance:
    """Draws noise for commands and images; draws nothing, and changes nothing, where its strength is zero."""

    def __init__(self, strength: Disturbances, seed: int) -> None:
        self._strength = strength
        self._seed = seed
        random = self._generator(_DRIFT)
        # A sum of waves whose frequencies are Cauchy distributed is correlated over time as exp(-|t| / drift time).
        self._frequencies = np.tan(math.pi * (random.random(_WAVES) - 0.5)) / _DRIFT_TIME  # rad/s
        self._phases = random.uniform(0.0, 2.0 * math.pi, _WAVES)

    def actuation(self, time: float) -> np.ndarray:
        """(3,) m/s, m/s, rad/s by which the arm misses a velocity that is commanded at a time, s."""
        noise = np.asarray(self._strength.actuation_noise)
        return noise * self._generator(_ACTUATION, time).standard_normal(3) if noise.any() else noise

    def image(self, image: np.ndarray, time: float) -> np.ndarray:
        """An image (H, W, 3) uint8 as a real camera would give it at a time, s."""
        if self._strength.brightness_drift == 0.0 and self._strength.image_noise == 0.0:
            return image
        levels = image * (1.0 + self._brightness(time))
        if self._strength.image_noise > 0.0:
            levels += self._strength.image_noise * self._generator(_IMAGE, time).standard_normal(image.shape)
        return np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)

    def _brightness(self, time: float) -> float:
        """Relative brightness error at a time: it wanders, and keeps its standard deviation."""
        waves = np.cos(self._frequencies * time + self._phases)
        return self._strength.brightness_drift * math.sqrt(2.0 / _WAVES) * float(waves.sum())

    def _generator(self, purpose: int, time: float = 0.0) -> np.random.Generator:
        return np.random.default_rng([_STREAM, self._seed, purpose, round(1e6 * time)])
