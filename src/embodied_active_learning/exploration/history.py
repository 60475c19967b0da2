"""The states the arm has visited, and their kernels at any samples."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.exploration.kernel import CoverageKernel

BLOCK = 2**18  # kernels at a time: what stays in a core's cache


class History:
    """Visited states (N, D), normalised, oldest first, with what their kernels are made of."""

    def __init__(self, kernel: CoverageKernel, dimensions: int, visited: Sequence[np.ndarray] = ()) -> None:
        """Begin with the states visited in an earlier run, if any."""
        self._gaussian = CoverageKernel(kernel.variance)
        self._kernel = kernel
        self._count = 0
        capacity = max(1024, 2 * len(visited))
        self._states = np.empty((capacity, dimensions))
        self._features = np.empty((capacity, dimensions + 2), dtype=np.float32)
        self._weights = np.empty(capacity, dtype=np.float32)
        for state in visited:
            self.append(state)

    def __len__(self) -> int:
        """Number of visited states."""
        return self._count

    @property
    def states(self) -> np.ndarray:
        """(N, D) normalised."""
        return self._states[: self._count].copy()

    def append(self, state: np.ndarray) -> None:
        """Add a state (D,). Raises ObservationError when it is not finite numbers."""
        state = np.asarray(state, dtype=np.float64)
        if state.shape != self._states.shape[1:] or not np.all(np.isfinite(state)):
            raise ObservationError(
                f"visited state {state.tolist()} is not {self._states.shape[1]} finite numbers: check tf and the arm"
            )
        if self._count == len(self._states):
            self._grow()
        self._states[self._count] = state
        self._features[self._count] = self._gaussian.state_features(state)
        self._weights[self._count] = np.exp(-self._kernel.log_mass(state))
        self._count += 1

    def kernels(self, features: np.ndarray, since: int = 0) -> Tuple[np.ndarray, np.ndarray]:
        """Sum of the kernels, and largest Gaussian, of the states from number `since` on, at samples.

        features: (S, D + 2) of the samples -> (S,), (S,). The sum divides by the mass where the kernel does, the
        largest value never: coverage asks how close the arm has been, not for how long.
        """
        total, largest = np.zeros(len(features)), np.zeros(len(features))
        step = max(1, BLOCK // max(1, len(features)))
        for begin in range(since, self._count, step):
            block = slice(begin, min(begin + step, self._count))
            gaussian = features @ self._features[block].T
            np.exp(gaussian, out=gaussian)
            total += gaussian @ self._weights[block]
            np.maximum(largest, gaussian.max(axis=1), out=largest)
        return total, np.minimum(largest, 1.0)

    def _grow(self) -> None:
        self._states, self._features, self._weights = (
            np.concatenate([array, np.empty_like(array)]) for array in (self._states, self._features, self._weights)
        )
