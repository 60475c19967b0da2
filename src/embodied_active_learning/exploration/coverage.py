"""Workspace coverage k: how much of the workspace has been seen (paper, Alg. 1, line 8)."""

from __future__ import annotations

import numpy as np

from embodied_active_learning.exploration.kernel import CoverageKernel

CHUNK = 256  # visited states at a time: their exponents at 1000 samples stay in the cache


def workspace_coverage(samples: np.ndarray, states: np.ndarray, variance: float, authors: bool = False) -> float:
    """Coverage k in [0, 1]: mean over samples of the largest kernel of any state. samples: (S, D), states: (N, D).

    Trainer and planner share it. authors: the variant of the authors' controller, see mean_coverage.
    """
    return mean_coverage(largest_kernel(samples, states, variance), samples, authors)


def largest_kernel(samples: np.ndarray, states: np.ndarray, variance: float) -> np.ndarray:
    """Largest kernel of any state at each sample, 0 without states. samples: (S, D), states: (N, D) -> (S,)."""
    kernel = CoverageKernel(variance)
    features = kernel.sample_features(np.asarray(samples)).T
    largest = np.full(len(samples), -np.inf, dtype=np.float32)
    for start in range(0, len(states), CHUNK):
        exponents = kernel.state_features(np.asarray(states[start : start + CHUNK])) @ features
        np.maximum(largest, exponents.max(axis=0), out=largest)
    return np.exp(np.minimum(largest, 0.0, dtype=np.float64))


def mean_coverage(largest: np.ndarray, samples: np.ndarray, authors: bool = False) -> float:
    """Coverage k from the largest kernel (S,) at each sample (S, D).

    authors: divide by the largest of all, and count samples outside the workspace as seen (docs/method.md, section 4).
    """
    if authors:
        largest = largest / max(float(np.max(largest)), np.finfo(np.float64).tiny)
        largest = np.where(np.all(np.abs(samples) <= 1.0, axis=1), largest, 1.0)
    return float(np.mean(largest))
