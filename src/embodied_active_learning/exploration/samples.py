"""Workspace samples with the time-average statistics of the visited states at each of them."""

from __future__ import annotations

from typing import Mapping, Sequence, Tuple, Union

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.exploration.kernel import CoverageKernel, mean_coverage
from embodied_active_learning.rng import Stream, generator, generator_state, set_generator_state
from embodied_active_learning.state_dict import StateDict, matching_arrays

_BLOCK = 2**18  # kernels at a time: their values fit into a core's cache
States = Union[np.ndarray, Sequence[np.ndarray]]


class History:
    """Visited states (N, D), normalised, oldest first, with their kernel features."""

    def __init__(self, kernel: CoverageKernel, dimensions: int, visited: States = ()) -> None:
        """Start with the states visited in an earlier run, if any."""
        self._gaussian = CoverageKernel(kernel.variance)
        self._kernel = kernel
        self._count = 0
        capacity = max(1024, 2 * len(visited))
        self._states: np.ndarray = np.empty((capacity, dimensions))
        self._features: np.ndarray = np.empty((capacity, dimensions + 2), dtype=np.float32)
        self._weights: np.ndarray = np.empty(capacity, dtype=np.float32)
        for state in visited:
            self.append(state)

    def __len__(self) -> int:
        """Return the number of visited states."""
        return self._count

    @property
    def states(self) -> np.ndarray:
        """Visited states (N, D), normalised; a copy."""
        return self._states[: self._count].copy()

    def append(self, state: np.ndarray) -> None:
        """Add a visited state (D,).

        Raises:
            ObservationError: the state is not D finite numbers.
        """
        state = np.asarray(state, dtype=np.float64)
        if state.shape != self._states.shape[1:] or not np.all(np.isfinite(state)):
            raise ObservationError(
                f"invalid visited state {state.tolist()}: expected {self._states.shape[1]} finite numbers; check tf "
                "and the arm"
            )
        if self._count == len(self._states):
            self._grow()
        self._states[self._count] = state
        self._features[self._count] = self._gaussian.state_features(state)
        self._weights[self._count] = np.exp(-self._kernel.log_mass(state))
        self._count += 1

    def kernels(self, features: np.ndarray, since: int = 0) -> Tuple[np.ndarray, np.ndarray]:
        """Return the kernel sum (S,) and the largest Gaussian (S,) of the visited states at samples.

        The sum uses normalised kernels if so configured, the largest value never: coverage measures proximity.

        Args:
            features: (S, D + 2) kernel features of the samples.
            since: index of the first visited state to include.
        """
        total, largest = np.zeros(len(features)), np.zeros(len(features))
        step = max(1, _BLOCK // max(1, len(features)))
        for begin in range(since, self._count, step):
            block = slice(begin, min(begin + step, self._count))
            gaussian = features @ self._features[block].T
            np.exp(gaussian, out=gaussian)
            total += gaussian @ self._weights[block]
            np.maximum(largest, gaussian.max(axis=1), out=largest)
        return total, np.minimum(largest, 1.0)

    def _grow(self) -> None:
        """Double the capacity."""
        self._states, self._features, self._weights = (
            np.concatenate([array, np.empty_like(array)]) for array in (self._states, self._features, self._weights)
        )


class WorkspaceSamples:
    """S states drawn uniformly from the workspace (Paper, Alg. 1, line 5) and the kernel sum of all visited states.

    The sums are updated recursively: a visit costs O(S), a refresh O(fresh samples x visited states).
    """

    def __init__(self, config: Config, visited: States = ()) -> None:
        """Draw the samples.

        Args:
            config: the configuration.
            visited: (N, D) normalised states visited in an earlier run.
        """
        exploration, axes = config.exploration, config.workspace.box().size
        self.kernel = CoverageKernel.from_config(config)
        self._history = History(self.kernel, axes, visited)
        self._exploration = exploration
        self._random = generator(exploration.seed, Stream.SAMPLES)
        self._states: np.ndarray = np.empty((exploration.samples, axes))
        self._features: np.ndarray = np.empty((exploration.samples, axes + 2), dtype=np.float32)
        self._visitation: np.ndarray = np.empty(exploration.samples)
        self._largest: np.ndarray = np.empty(exploration.samples)
        self._oldest = 0
        self._draw(np.arange(exploration.samples))

    @property
    def states(self) -> np.ndarray:
        """Samples (S, D), normalised; a copy."""
        return self._states.copy()

    @property
    def features(self) -> np.ndarray:
        """Kernel features (S, D + 2) float32 of the samples; a copy."""
        return self._features.copy()

    @property
    def visited(self) -> np.ndarray:
        """Visited states (N, D), normalised, oldest first; a copy."""
        return self._history.states

    @property
    def visitation(self) -> np.ndarray:
        """Kernel sums (S,) sum_t psi(s_i|x_t) over the visited states: the unnormalised d(s).

        Paper, Eq. 8 and Alg. 1, line 10, there including the planned states.
        """
        return self._visitation.copy()

    @property
    def coverage(self) -> float:
        """Workspace coverage k of the visited states, between 0 and 1. Paper, Alg. 1, line 8."""
        return mean_coverage(self._largest, self._states, self._exploration.authors_coverage)

    def visit(self, state: np.ndarray) -> None:
        """Add a visited state (D,), normalised.

        Raises:
            ObservationError: the state is not D finite numbers.
        """
        self._history.append(state)
        visitation, largest = self._history.kernels(self._features, since=len(self._history) - 1)
        self._visitation += visitation
        np.maximum(self._largest, largest, out=self._largest)

    def refresh(self) -> None:
        """Draw the oldest `fresh_samples` samples again, at most all.

        Called once a step, this replaces all samples within S / fresh_samples steps.
        """
        size = len(self._states)
        fresh = min(self._exploration.fresh_samples, size)
        self._draw((self._oldest + np.arange(fresh)) % size)
        self._oldest = (self._oldest + fresh) % size

    def state_dict(self) -> StateDict:
        """Return copies of everything but the visited states that determines the next samples and sums."""
        return {
            "states": self._states.copy(),
            "features": self._features.copy(),
            "visitation": self._visitation.copy(),
            "largest": self._largest.copy(),
            "oldest": np.array([self._oldest]),
            "generator": generator_state(self._random),
        }

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue exactly like the samples that returned this state after the same visited states.

        Raises:
            CorruptFileError: the state does not fit; nothing is changed.
        """
        arrays = matching_arrays(state, self.state_dict())
        self._states, self._features = arrays["states"], arrays["features"]
        self._visitation, self._largest = arrays["visitation"], arrays["largest"]
        self._oldest = int(arrays["oldest"][0]) % len(self._states)
        set_generator_state(self._random, arrays["generator"])

    def _draw(self, indices: np.ndarray) -> None:
        """Draw these samples again, and sum the kernels of all visited states at them."""
        box = self._exploration.sample_box
        self._states[indices] = self._random.uniform(-box, box, (len(indices), self._states.shape[1]))
        self._features[indices] = self.kernel.sample_features(self._states[indices])
        self._visitation[indices], self._largest[indices] = self._history.kernels(self._features[indices])
