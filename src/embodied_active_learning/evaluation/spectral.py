"""The spectral ergodic metric of planar trajectories, and densities on the unit square to cover.

G. Mathew, I. Mezic: Metrics for ergodicity and design of ergodic dynamics for multi-agent systems. Physica D 240, 2011.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict

import numpy as np

GRID = 100
"""Cells of the unit square in each direction, over which densities are integrated."""
COEFFICIENTS = 20
"""Cosine coefficients in each direction."""
_KERNEL_STD = 0.05  # of the unit square, for the KL measure
_FLOOR = 1e-12
Density = Callable[[np.ndarray], np.ndarray]


def three_gaussians(points: np.ndarray) -> np.ndarray:
    """Return the density (N,), not normalised, of a mixture of three Gaussians at points (N, 2) of the unit square."""
    total = np.zeros(len(points))
    for weight, mean, covariance in (
        (0.5, (0.35, 0.38), ((0.01, 0.004), (0.004, 0.01))),
        (0.2, (0.68, 0.25), ((0.005, -0.003), (-0.003, 0.005))),
        (0.3, (0.56, 0.64), ((0.008, 0.0), (0.0, 0.004))),
    ):
        offset, inverse = points - np.array(mean), np.linalg.inv(covariance)
        exponent = -0.5 * np.einsum("ni,ij,nj->n", offset, inverse, offset)
        total += weight * np.sqrt(np.linalg.det(inverse)) * np.exp(exponent)
    return total


def uniform(points: np.ndarray) -> np.ndarray:
    """Return a constant density (N,) at points (N, 2)."""
    return np.ones(len(points))


DENSITIES: Dict[str, Density] = {"three Gaussians": three_gaussians, "uniform": uniform}


def grid_points(cells: int = GRID) -> np.ndarray:
    """Return the centres (cells^2, 2) of a grid over the unit square."""
    centres = (np.arange(cells) + 0.5) / cells
    return np.stack(np.meshgrid(centres, centres, indexing="ij"), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class SpectralMetric:
    """Weighted distance between the cosine coefficients of a trajectory and of a density.

    Attributes:
        target: (K, K) coefficients of the density.
        weights: (K, K) weights (1 + |k|^2)^(-3/2).
        norms: (K, K) norms of the basis functions.
    """

    target: np.ndarray
    weights: np.ndarray
    norms: np.ndarray

    @classmethod
    def of(cls, density: Density, count: int = COEFFICIENTS) -> SpectralMetric:
        """Return the metric for a density on the unit square."""
        k = np.arange(count)
        norm = np.where(k == 0, 1.0, np.sqrt(0.5))
        weights = (1.0 + k[:, np.newaxis] ** 2 + k**2) ** -1.5
        norms = np.outer(norm, norm)
        points = grid_points()
        values = density(points)
        x, y = _cosines(points[:, 0], count), _cosines(points[:, 1], count)
        target = (x * (values / values.sum())[:, np.newaxis]).T @ y / norms
        return cls(target, weights, norms)

    def coefficients(self, positions: np.ndarray) -> np.ndarray:
        """Return the coefficients (K, K) of the time average of positions (N, 2)."""
        count = len(self.target)
        return _cosines(positions[:, 0], count).T @ _cosines(positions[:, 1], count) / (self.norms * len(positions))

    def value(self, positions: np.ndarray) -> float:
        """Return the squared distance of positions (N, 2) from the density; 0 is a perfect match."""
        return float(np.sum(self.weights * (self.coefficients(positions) - self.target) ** 2))

    def gradient(self, positions: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """Return the gradients (N, 2), by each position, of the basis functions weighted with factors (K, K)."""
        count, scaled = len(self.target), factors / self.norms
        k = np.pi * np.arange(count)
        x, y = _cosines(positions[:, 0], count), _cosines(positions[:, 1], count)
        along_x, along_y = (-k * np.sin(np.outer(positions[:, axis], k)) for axis in (0, 1))
        return np.stack([np.sum(along_x @ scaled * y, axis=1), np.sum(x @ scaled * along_y, axis=1)], axis=1)


def kl_measure(positions: np.ndarray, density: Density) -> float:
    """Return D_KL(h || d) [nat] between a density and the time average d of positions (N, 2).

    d is smoothed by Gaussian kernels of 0.05 of the unit square that are divided by their mass inside. Paper, Eq. 8.
    """
    points = grid_points(GRID // 2)
    wanted = density(points)
    wanted = np.maximum(wanted / wanted.sum(), _FLOOR)
    centres = points.reshape(GRID // 2, GRID // 2, 2)[0, :, 1]
    x, y = (_kernels(positions[:, axis], centres) for axis in (0, 1))
    spent = np.maximum((x.T @ y).ravel() / len(positions), _FLOOR)
    return float(np.sum(wanted * np.log(wanted / spent)))


def _kernels(values: np.ndarray, centres: np.ndarray) -> np.ndarray:
    kernel = np.exp(-0.5 * (values[:, np.newaxis] - centres) ** 2 / _KERNEL_STD**2)
    return kernel / kernel.sum(axis=1, keepdims=True)


def _cosines(values: np.ndarray, count: int) -> np.ndarray:
    return np.cos(np.pi * np.outer(values, np.arange(count)))
