"""Disturbances of a real robot: actuation noise, image noise and brightness drift.

Each draw depends on the seed and the time only, so that a restored simulation repeats it.
"""

from __future__ import annotations

import math

import numpy as np

from embodied_active_learning.simulation.world_settings import Disturbances

_DRIFT_TIME = 30.0  # s, correlation time of the brightness
_WAVES = 64  # that make up the drift
_STREAM = 0xD157  # separates these draws from others with the same seed
_DRIFT, _ACTUATION, _IMAGE = range(3)


class Disturbance:
    """Noise for commands and images; no effect where its strength is zero."""

    def __init__(self, strength: Disturbances, seed: int) -> None:
        self._strength = strength
        self._seed = seed
        random = self._generator(_DRIFT)
        # A sum of waves whose frequencies are Cauchy distributed is correlated over time as exp(-|t| / drift time).
        self._frequencies = np.tan(math.pi * (random.random(_WAVES) - 0.5)) / _DRIFT_TIME  # rad/s
        self._phases = random.uniform(0.0, 2.0 * math.pi, _WAVES)

    def actuation(self, time: float) -> np.ndarray:
        """Return the velocity error (3,) [m/s, m/s, rad/s] of a command at a time [s]."""
        noise = np.asarray(self._strength.actuation_noise)
        return noise * self._generator(_ACTUATION, time).standard_normal(3) if noise.any() else noise

    def image(self, image: np.ndarray, time: float) -> np.ndarray:
        """Return an image (H, W, 3) uint8 with the disturbances at a time [s]."""
        if self._strength.brightness_drift == 0.0 and self._strength.image_noise == 0.0:
            return image
        levels = image * (1.0 + self._brightness(time))
        if self._strength.image_noise > 0.0:
            levels += self._strength.image_noise * self._generator(_IMAGE, time).standard_normal(image.shape)
        return np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)

    def _brightness(self, time: float) -> float:
        """Return the relative brightness error at a time; stationary with constant standard deviation."""
        waves = np.cos(self._frequencies * time + self._phases)
        return self._strength.brightness_drift * math.sqrt(2.0 / _WAVES) * float(waves.sum())

    def _generator(self, purpose: int, time: float = 0.0) -> np.random.Generator:
        return np.random.default_rng([_STREAM, self._seed, purpose, round(1e6 * time)])
