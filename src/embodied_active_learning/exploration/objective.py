"""What a plan is worth: the KL-ergodic measure it would lead to, plus the barrier, and the gradient of both."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.exploration.barrier import Barrier
from embodied_active_learning.exploration.dynamics import Rollout
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.exploration.target import FLOOR, normalise


class ErgodicObjective:
    """J = D_KL(h || d) + sum of barriers, with d over all visited states and the H planned ones (paper, Sec. 2.3)."""

    def __init__(self, target: np.ndarray, samples: WorkspaceSamples, barrier: Barrier) -> None:
        """Fix everything that no plan changes. target: (S,), at the samples as they are now."""
        if np.shape(target) != samples.visitation.shape or not np.all(np.isfinite(target)):
            raise EmbodiedActiveLearningError(
                f"the target of shape {np.shape(target)} is not one finite number for each of the"
                f" {samples.visitation.size} samples: evaluate it at the samples of this step"
            )
        self._share = normalise(target)
        self._entropy = float(np.sum(self._share * np.log(self._share)))
        self._samples = samples
        self._features = np.ascontiguousarray(samples.features.T)
        self._visitation = samples.visitation
        self._barrier = barrier

    @property
    def scale(self) -> float:
        """The largest visitation over the largest share of the target: turns dJ/du into the authors' update."""
        return max(float(np.max(self._visitation)), 1.0) / float(np.max(self._share))

    def cost(self, rollout: Rollout) -> np.ndarray:
        """J of each plan, (B,) nats."""
        features = self._samples.kernel.state_features(rollout.positions)
        kernel = np.empty((len(features), self._features.shape[1]), dtype=np.float32)
        planned = np.zeros_like(kernel)
        # one step at a time: the kernels of all plans at one step fit into the cache, those of all steps do not
        for t in range(features.shape[1]):
            np.dot(np.ascontiguousarray(features[:, t]), self._features, out=kernel)
            planned += np.exp(kernel, out=kernel)
        divergence = self._entropy - np.log(normalise(self._visitation + planned)) @ self._share
        return divergence + self._barrier.cost(rollout.positions, rollout.velocities)

    def gradient(self, rollout: Rollout) -> Tuple[np.ndarray, np.ndarray]:
        """Gradient of J by the positions and by the velocities of one plan, (1, H, D) each."""
        kernel = self._samples.kernel
        positions = rollout.positions[0]
        psi = np.exp(kernel.state_features(positions) @ self._features)
        weighted = psi * self._by_visitation(self._visitation + psi.sum(axis=0))
        total = weighted.sum(axis=1, keepdims=True)
        pull = (weighted @ self._samples.states - positions * total) / kernel.variance
        by_position = pull - total * kernel.log_mass_gradient(positions)
        barrier_position, barrier_velocity = self._barrier.gradient(rollout.positions, rollout.velocities)
        return by_position + barrier_position, barrier_velocity

    def _by_visitation(self, visitation: np.ndarray) -> np.ndarray:
        """Derivative of D_KL by the unnormalised visitation at each sample, (S,). The floor is left out of it.

        Where the floor holds, J is flat; the derivative of the measure without floor points there nevertheless, which
        is what draws the arm to places it has never been near.
        """
        total = max(float(np.sum(visitation)), np.finfo(np.float32).tiny)
        return 1.0 / total - self._share / np.maximum(visitation, FLOOR * total)
