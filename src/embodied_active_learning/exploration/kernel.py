"""The coverage kernel psi(s|x), and the workspace coverage k computed from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np
from scipy.special import ndtr

from embodied_active_learning.config import Config

_CHUNK = 256  # states at a time: their exponents at 1000 samples fit into the cache


def kernel_variance(samples: int, dimensions: int) -> float:
    """Return the authors' kernel variance, normalised units: 0.057588 for 1000 samples in 3 dimensions.

    It is the radius of a ball with 0.1/S of the workspace's volume, although it is used as a variance.
    """
    unit_ball = math.pi ** (dimensions / 2) / math.gamma(dimensions / 2 + 1)
    return (0.1 / samples * 2**dimensions / unit_ball) ** (1 / dimensions)


@dataclass(frozen=True)
class CoverageKernel:
    """psi(s|x) = exp(-|s - x|^2 / (2 variance)) / mass(x), normalised units. Paper, Sec. 2.3, below Eq. 8.

    mass(x) is the share of the Gaussian inside [-box, box]^D if `normalise` is set, else 1.

    Exponents are computed as one product of feature vectors, s.x/v - |s|^2/2v - |x|^2/2v - log mass(x), in single
    precision; for states in the workspace the relative error is about 1e-5.
    """

    variance: float
    box: float = 1.0
    normalise: bool = False

    @classmethod
    def from_config(cls, config: Config) -> CoverageKernel:
        """Return the kernel of a run."""
        exploration = config.exploration
        variance = exploration.kernel_variance or kernel_variance(exploration.samples, config.workspace.box().size)
        return cls(variance, exploration.sample_box, config.planner.normalise_kernels)

    def __call__(self, samples: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Return the kernels (N, S) float32 of states (N, D) at samples (S, D)."""
        return np.exp(self.state_features(states) @ self.sample_features(samples).T)

    def sample_features(self, samples: np.ndarray) -> np.ndarray:
        """Return features (S, D + 2) float32 of samples (S, D), the right factor of the exponents."""
        energy = -0.5 / self.variance * np.sum(np.square(samples), axis=-1, keepdims=True)
        return np.concatenate([samples, np.ones_like(energy), energy], axis=-1).astype(np.float32)

    def state_features(self, states: np.ndarray) -> np.ndarray:
        """Return features (..., D + 2) float32 of visited or planned states (..., D), the left factor."""
        energy = -0.5 / self.variance * np.sum(np.square(states), axis=-1) - self.log_mass(states)
        energy = energy[..., np.newaxis]
        return np.concatenate([states / self.variance, energy, np.ones_like(energy)], axis=-1).astype(np.float32)

    def log_mass(self, states: np.ndarray) -> np.ndarray:
        """Return the log of the Gaussian's mass inside the box (...) for states (..., D).

        States outside the box count as on its border, so that a stray measurement does not outweigh all others.
        """
        if not self.normalise:
            return np.zeros(np.shape(states)[:-1])
        upper, lower = self._distances(states)
        return np.sum(np.log(ndtr(upper) - ndtr(lower)), axis=-1)

    def log_mass_gradient(self, states: np.ndarray) -> np.ndarray:
        """Return the gradient (..., D) of `log_mass` by the states (..., D)."""
        if not self.normalise:
            return np.zeros(np.shape(states))
        upper, lower = self._distances(states)
        density = (np.exp(-0.5 * lower**2) - np.exp(-0.5 * upper**2)) / math.sqrt(2.0 * math.pi * self.variance)
        return np.where(np.abs(states) <= self.box, density / (ndtr(upper) - ndtr(lower)), 0.0)

    def _distances(self, states: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Signed distances to the upper and lower border, in standard deviations."""
        std = math.sqrt(self.variance)
        inside = np.clip(states, -self.box, self.box)
        return (self.box - inside) / std, (-self.box - inside) / std


def workspace_coverage(samples: np.ndarray, states: np.ndarray, variance: float, authors: bool = False) -> float:
    """Return the workspace coverage k = 1/S sum_i max_x psi(s_i|x), between 0 and 1. Paper, Alg. 1, line 8.

    Trainer and planner share this definition.

    Args:
        samples: (S, D) normalised workspace samples s_i.
        states: (N, D) normalised visited states x.
        variance: of the kernel, which is not normalised here: coverage measures proximity, not duration.
        authors: use the variant of the authors' controller, see `mean_coverage`.
    """
    return mean_coverage(largest_kernel(samples, states, variance), samples, authors)


def largest_kernel(samples: np.ndarray, states: np.ndarray, variance: float) -> np.ndarray:
    """Return max_x psi(s_i|x) (S,) over states (N, D) at samples (S, D); 0 without states."""
    kernel = CoverageKernel(variance)
    features = kernel.sample_features(np.asarray(samples)).T
    largest: np.ndarray = np.full(len(samples), -np.inf, dtype=np.float32)
    for start in range(0, len(states), _CHUNK):
        exponents = kernel.state_features(np.asarray(states[start : start + _CHUNK])) @ features
        np.maximum(largest, exponents.max(axis=0), out=largest)
    return np.exp(np.minimum(largest, 0.0, dtype=np.float64))


def mean_coverage(largest: np.ndarray, samples: np.ndarray, authors: bool = False) -> float:
    """Return the coverage k from the largest kernel (S,) at each sample (S, D).

    authors: divide by the maximum over the samples, and count samples outside the workspace as covered.
    """
    if authors:
        largest = largest / max(float(np.max(largest)), np.finfo(np.float64).tiny)
        largest = np.where(np.all(np.abs(samples) <= 1.0, axis=1), largest, 1.0)
    return float(np.mean(largest))
