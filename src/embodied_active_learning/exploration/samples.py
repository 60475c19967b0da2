"""Workspace samples, and at each of them how long and how closely the arm has been there."""

from __future__ import annotations

from typing import Mapping, Sequence

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.coverage import mean_coverage
from embodied_active_learning.exploration.history import History
from embodied_active_learning.exploration.kernel import CoverageKernel
from embodied_active_learning.exploration.memory import Memory, recall
from embodied_active_learning.rng import Stream, generator, generator_state, set_generator_state


class WorkspaceSamples:
    """S states drawn uniformly from the workspace, with the kernel sum of all visited states at each.

    The sums are kept recursively: visiting a state costs O(S), a refresh O(fresh samples x visited states).
    """

    def __init__(self, config: Config, visited: Sequence[np.ndarray] = (), stream: Stream = Stream.SAMPLES) -> None:
        """Draw the samples. visited: (N, D) normalised states of an earlier run to go on from."""
        exploration, axes = config.exploration, config.workspace.box().size
        self.kernel = CoverageKernel.from_config(config)
        self._history = History(self.kernel, axes, visited)
        self._exploration = exploration
        self._random = generator(exploration.seed, stream)
        self._states = np.empty((exploration.samples, axes))
        self._features = np.empty((exploration.samples, axes + 2), dtype=np.float32)
        self._visitation = np.empty(exploration.samples)
        self._largest = np.empty(exploration.samples)
        self._oldest = 0
        self._draw(np.arange(exploration.samples))

    @property
    def states(self) -> np.ndarray:
        """(S, D) normalised samples. A copy: it stays what it is when samples are refreshed."""
        return self._states.copy()

    @property
    def features(self) -> np.ndarray:
        """(S, D + 2) float32 kernel features of the samples, a copy."""
        return self._features.copy()

    @property
    def visited(self) -> np.ndarray:
        """(N, D) normalised states visited so far, oldest first."""
        return self._history.states

    @property
    def visitation(self) -> np.ndarray:
        """(S,) kernel sums of the visited states: the time average d(s) before normalisation (paper, Sec. 2.3)."""
        return self._visitation.copy()

    @property
    def coverage(self) -> float:
        """Workspace coverage k of the visited states."""
        return mean_coverage(self._largest, self._states, self._exploration.authors_coverage)

    def visitation_with(self, planned: np.ndarray) -> np.ndarray:
        """The visitation (S,) as it will be after the planned states (H, D): the authors' d(s)."""
        return self._visitation + self.kernel(self._states, planned).sum(axis=0, dtype=np.float64)

    def visit(self, state: np.ndarray) -> None:
        """Count one more visited state (D,), normalised. Raises ObservationError when it is not finite numbers."""
        self._history.append(state)
        visitation, largest = self._history.kernels(self._features, since=len(self._history) - 1)
        self._visitation += visitation
        np.maximum(self._largest, largest, out=self._largest)

    def refresh(self) -> None:
        """Draw the oldest `fresh_samples` samples anew: with one call per step, all within S / fresh_samples steps."""
        size, fresh = len(self._states), self._exploration.fresh_samples
        self._draw((self._oldest + np.arange(fresh)) % size)
        self._oldest = (self._oldest + fresh) % size

    def memory(self) -> Memory:
        """Copies of everything but the visited states that decides what it answers next."""
        return {
            "states": self._states.copy(),
            "features": self._features.copy(),
            "visitation": self._visitation.copy(),
            "largest": self._largest.copy(),
            "oldest": np.array([self._oldest]),
            "generator": generator_state(self._random),
        }

    def recall(self, memory: Mapping[str, np.ndarray]) -> None:
        """Go on as the samples did whose memory this is, after the same visited states.

        Raises CorruptFileError when it does not fit; then nothing is changed.
        """
        recalled = recall(memory, self.memory())
        self._states, self._features = recalled["states"], recalled["features"]
        self._visitation, self._largest = recalled["visitation"], recalled["largest"]
        self._oldest = int(recalled["oldest"][0]) % len(self._states)
        set_generator_state(self._random, recalled["generator"])

    def _draw(self, which: np.ndarray) -> None:
        """Draw the samples of these indices, and sum up all visited states at them."""
        box = self._exploration.sample_box
        self._states[which] = self._random.uniform(-box, box, (len(which), self._states.shape[1]))
        self._features[which] = self.kernel.sample_features(self._states[which])
        self._visitation[which], self._largest[which] = self._history.kernels(self._features[which])
