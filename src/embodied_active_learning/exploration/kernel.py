"""The coverage kernel: a Gaussian around each visited state, and its mass inside the box that samples are drawn in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np
from scipy.special import ndtr

from embodied_active_learning.config import Config


def kernel_variance(samples: int, dimensions: int) -> float:
    """Variance of the kernel, normalised units: the authors' rule, the radius of a ball of 0.1/S of the workspace.

    1000 samples in 3 dimensions -> 0.057588; 2000 -> 0.045708. It is a length used as a variance; results depend on it.
    """
    unit_ball = math.pi ** (dimensions / 2) / math.gamma(dimensions / 2 + 1)
    return (0.1 / samples * 2**dimensions / unit_ball) ** (1 / dimensions)


@dataclass(frozen=True)
class CoverageKernel:
    """psi(s|x) = exp(-sum (s - x)^2 / 2 variance) / mass(x), normalised units (paper, Sec. 2.3).

    mass(x) is the share of the Gaussian inside [-box, box]^D where normalise is set, else 1. Without it most of a
    corner state's kernel falls outside the samples, so that standing in a corner costs nothing and becomes a trap.

    Exponents come from one product of feature vectors, s.x/v - |s|^2/2v - |x|^2/2v - log mass(x), in single precision:
    for states within the workspace the kernel is right to about 1e-5 of its value.
    """

    variance: float
    box: float = 1.0
    normalise: bool = False

    @classmethod
    def from_config(cls, config: Config) -> CoverageKernel:
        """The kernel of a run."""
        exploration = config.exploration
        variance = exploration.kernel_variance or kernel_variance(exploration.samples, config.workspace.box().size)
        return cls(variance, exploration.sample_box, config.planner.normalise_kernels)

    def __call__(self, samples: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Kernels of states (N, D) at samples (S, D) -> (N, S) float32."""
        return np.exp(self.state_features(states) @ self.sample_features(samples).T)

    def sample_features(self, samples: np.ndarray) -> np.ndarray:
        """Samples (S, D) -> (S, D + 2) float32, to be multiplied with state_features."""
        energy = -0.5 / self.variance * np.sum(np.square(samples), axis=-1, keepdims=True)
        return np.concatenate([samples, np.ones_like(energy), energy], axis=-1).astype(np.float32)

    def state_features(self, states: np.ndarray) -> np.ndarray:
        """Visited or planned states (..., D) -> (..., D + 2) float32."""
        energy = -0.5 / self.variance * np.sum(np.square(states), axis=-1) - self.log_mass(states)
        energy = energy[..., np.newaxis]
        return np.concatenate([states / self.variance, energy, np.ones_like(energy)], axis=-1).astype(np.float32)

    def log_mass(self, states: np.ndarray) -> np.ndarray:
        """Log of the mass inside the box. states: (..., D) -> (...).

        A state beyond the box counts as at its border, so that a stray measurement does not outweigh all others.
        """
        if not self.normalise:
            return np.zeros(np.shape(states)[:-1])
        upper, lower = self._distances(states)
        return np.sum(np.log(ndtr(upper) - ndtr(lower)), axis=-1)

    def log_mass_gradient(self, states: np.ndarray) -> np.ndarray:
        """Gradient of log_mass. states: (..., D) -> (..., D)."""
        if not self.normalise:
            return np.zeros(np.shape(states))
        upper, lower = self._distances(states)
        slope = (np.exp(-0.5 * lower**2) - np.exp(-0.5 * upper**2)) / math.sqrt(2.0 * math.pi * self.variance)
        return np.where(np.abs(states) <= self.box, slope / (ndtr(upper) - ndtr(lower)), 0.0)

    def _distances(self, states: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Signed distances to the upper and lower limits, in standard deviations."""
        std = math.sqrt(self.variance)
        inside = np.clip(states, -self.box, self.box)
        return (self.box - inside) / std, (-self.box - inside) / std
