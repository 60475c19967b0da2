"""Workspace samples, and at each of them how long and how closely the arm has been there."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.exploration.coverage import CHUNK, largest_kernel, mean_coverage
from embodied_active_learning.exploration.kernel import CoverageKernel
from embodied_active_learning.exploration.streams import Stream, generator


class WorkspaceSamples:
    """S states drawn uniformly from the workspace, with the kernel sum of all visited states at each.

    The sums are kept recursively: visiting a state costs O(S), a refresh O(fresh samples x visited states).
    """

    def __init__(self, config: Config, visited: Sequence[np.ndarray] = (), stream: Stream = Stream.SAMPLES) -> None:
        """Draw the samples. visited: (N, D) normalised states of an earlier run to go on from."""
        self.kernel = CoverageKernel.from_config(config)
        self._exploration = config.exploration
        self._random = generator(config.exploration.seed, stream)
        size, dimensions = config.exploration.samples, config.workspace.box().size
        self._visited = np.empty((max(1024, 2 * len(visited)), dimensions))
        self._count = 0
        for state in visited:
            self._append(state)
        self._states = np.empty((size, dimensions))
        self._features = np.empty((size, dimensions + 2), dtype=np.float32)
        self._visitation = np.empty(size)
        self._largest = np.empty(size)
        self._oldest = 0
        self._draw(np.arange(size))

    @property
    def states(self) -> np.ndarray:
        """(S, D) normalised samples. A copy: it stays what it is when samples are refreshed."""
        return self._states.copy()

    @property
    def features(self) -> np.ndarray:
        """(S, D + 2) float32 kernel features of the samples."""
        return self._features

    @property
    def visited(self) -> np.ndarray:
        """(N, D) normalised states visited so far, oldest first."""
        return self._visited[: self._count].copy()

    @property
    def visitation(self) -> np.ndarray:
        """(S,) sum over visited states of their kernels: the time average d(s) before normalisation (paper, Eq. 3)."""
        return self._visitation.copy()

    @property
    def coverage(self) -> float:
        """Workspace coverage k of the visited states."""
        return mean_coverage(self._largest, self._states, self._exploration.authors_coverage)

    def visitation_with(self, planned: np.ndarray) -> np.ndarray:
        """The visitation (S,) as it will be after the planned states (H, D), the authors' d(s)."""
        return self._visitation + self.kernel(self._states, planned).sum(axis=0, dtype=np.float64)

    def visit(self, state: np.ndarray) -> None:
        """Count one more visited state (D,), normalised. Raises ObservationError when it is not finite numbers."""
        state = self._append(state)
        self._visitation += self.kernel(self._states, state)[0]
        np.maximum(self._largest, largest_kernel(self._states, state, self.kernel.variance), out=self._largest)

    def refresh(self) -> None:
        """Draw the oldest `fresh_samples` samples anew; called once per step, all are new after S / fresh_samples steps."""
        size, fresh = len(self._states), self._exploration.fresh_samples
        self._draw((self._oldest + np.arange(fresh)) % size)
        self._oldest = (self._oldest + fresh) % size

    def _append(self, state: np.ndarray) -> np.ndarray:
        state = np.asarray(state, dtype=np.float64)
        if state.shape != self._visited.shape[1:] or not np.all(np.isfinite(state)):
            raise ObservationError(f"visited state {state.tolist()} is not {self._visited.shape[1]} finite numbers")
        if self._count == len(self._visited):
            self._visited = np.concatenate([self._visited, np.empty_like(self._visited)])
        self._visited[self._count] = state
        self._count += 1
        return state[np.newaxis]

    def _draw(self, which: np.ndarray) -> None:
        """Draw the samples of these indices, and sum up all visited states at them."""
        box = self._exploration.sample_box
        states = self._random.uniform(-box, box, (len(which), self._states.shape[1]))
        self._states[which] = states
        self._features[which] = self.kernel.sample_features(states)
        visited = self._visited[: self._count]
        visitation = np.zeros(len(which))
        for start in range(0, self._count, CHUNK):
            visitation += self.kernel(states, visited[start : start + CHUNK]).sum(axis=0, dtype=np.float64)
        self._visitation[which] = visitation
        self._largest[which] = largest_kernel(states, visited, self.kernel.variance)
