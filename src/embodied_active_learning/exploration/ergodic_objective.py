"""The planning objective: the target h, the KL-ergodic measure D_KL(h || d), the barrier, and their gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple, Union

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import EmbodiedActiveLearningError
from embodied_active_learning.exploration.dynamics import Rollout
from embodied_active_learning.exploration.samples import WorkspaceSamples

FLOOR = 1e-6  # smallest share of a sample, the authors' value: bounds the measure and keeps logarithms finite


def target_distribution(log_std: np.ndarray, coverage: float) -> np.ndarray:
    """Return the conditional-entropy target h(s) = exp(H[p(y|z,s)])^k, summing to 1. Paper, Eq. 29; Alg. 1, line 9.

    H is the entropy of one pixel value, ln std(s) + 0.5 ln(2 pi e), hence h(s) is proportional to std(s)^k.

    Args:
        log_std: (S,) log standard deviation of the image predicted at each sample.
        coverage: workspace coverage k.

    Returns:
        (S,) target distribution over the samples.

    Raises:
        EmbodiedActiveLearningError: a log standard deviation is not finite.
    """
    log_std = np.asarray(log_std, dtype=np.float64)
    invalid = np.count_nonzero(~np.isfinite(log_std))
    if invalid:
        raise EmbodiedActiveLearningError(
            f"conditional entropy not finite at {invalid} of {log_std.size} samples: the model has diverged; lower "
            "training/learning_rate"
        )
    return normalise(np.exp(coverage * (log_std - log_std.max())))


def uniform_distribution(count: int) -> np.ndarray:
    """Return the uniform distribution (count,), the target before anything was learned."""
    return np.full(count, 1.0 / count)


def normalise(weights: np.ndarray) -> np.ndarray:
    """Return distributions (..., S) from weights (..., S): divided by the sum, at least FLOOR, summing to 1.

    Weights that are all zero give the uniform distribution.
    """
    total = np.sum(weights, axis=-1, keepdims=True)
    shares = np.maximum(weights / np.where(total > 0.0, total, 1.0), FLOOR)
    return shares / np.sum(shares, axis=-1, keepdims=True)


def kl_ergodic(target: np.ndarray, visitation: np.ndarray) -> float:
    """Return the KL-ergodic measure D_KL(h || d) = sum_i h_i ln(h_i / d_i) [nat]. Paper, Sec. 2.3.

    Args:
        target: (S,) h, of any scale.
        visitation: (S,) kernel sums of the visited states, or of visited and planned ones, of any scale.
    """
    share, average = normalise(target), normalise(visitation)
    return float(np.sum(share * np.log(share / average)))


@dataclass(frozen=True)
class Barrier:
    """b(x) = weight * sum max(0, |x| - (limit - margin))^power over positions and velocities. Paper, Appendix, Control.

    A soft barrier: 0.0005 at the limit with the default weight. The dynamics clamp whatever it does not prevent.
    """

    weight: float
    power: float
    position_start: float  # normalised
    velocity_start: np.ndarray  # (D,) velocity units

    @classmethod
    def from_config(cls, config: Config) -> Barrier:
        """Return the configured barrier; as in the authors' code, positions and velocities share one margin."""
        planner = config.planner
        velocity_start = np.maximum(np.asarray(planner.velocity_limits) - planner.barrier_margin, 0.0)
        return cls(planner.barrier_weight, planner.barrier_power, 1.0 - planner.barrier_margin, velocity_start)

    def cost(self, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        """Return the barrier (...) summed over the steps of each plan, from (..., H, D) positions and velocities."""
        excess = _excess(positions, self.position_start) ** self.power
        excess += _excess(velocities, self.velocity_start) ** self.power
        return self.weight * np.sum(excess, axis=(-2, -1))

    def gradient(self, positions: np.ndarray, velocities: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return the gradients of the cost by positions and by velocities, (..., H, D) each."""
        return self._gradient(positions, self.position_start), self._gradient(velocities, self.velocity_start)

    def _gradient(self, values: np.ndarray, start: Union[float, np.ndarray]) -> np.ndarray:
        excess = _excess(values, start)
        # With power 1, 0^0 = 1 would give a gradient where there is no excess.
        powers = np.where(excess > 0.0, excess ** (self.power - 1.0), 0.0)
        return self.weight * self.power * np.sign(values) * powers


def _excess(values: np.ndarray, start: Union[float, np.ndarray]) -> np.ndarray:
    return np.maximum(np.abs(values) - start, 0.0)


class ErgodicObjective:
    """J = D_KL(h || d) + sum_t b(x_t), with d over all visited states and the H planned ones. Paper, Sec. 2.3."""

    def __init__(self, target: np.ndarray, samples: WorkspaceSamples, barrier: Barrier) -> None:
        """Precompute everything that does not depend on the plan.

        Args:
            target: (S,) h at the samples in their present state.
            samples: the workspace samples.
            barrier: the barrier b.

        Raises:
            EmbodiedActiveLearningError: the target is not one finite number per sample.
        """
        visitation = samples.visitation
        if np.shape(target) != visitation.shape or not np.all(np.isfinite(target)):
            raise EmbodiedActiveLearningError(
                f"invalid target of shape {np.shape(target)}: expected one finite number for each of the "
                f"{visitation.size} samples; evaluate it at the samples of this step"
            )
        self._share = normalise(target)
        self._negative_entropy = float(np.sum(self._share * np.log(self._share)))
        self._samples = samples
        self._features = np.ascontiguousarray(samples.features.T)
        self._visitation = visitation
        self._barrier = barrier

    @property
    def scale(self) -> float:
        """Largest visitation over largest target share: the factor from dJ/du to the authors' control update."""
        return max(float(np.max(self._visitation)), 1.0) / float(np.max(self._share))

    def cost(self, rollout: Rollout) -> np.ndarray:
        """Return J (B,) [nat] of each plan."""
        features = self._samples.kernel.state_features(rollout.positions)
        kernel: np.ndarray = np.empty((len(features), self._features.shape[1]), dtype=np.float32)
        planned = np.zeros_like(kernel)
        # One step at a time: the kernels of all plans at one step fit into the cache, those of all steps do not.
        for t in range(features.shape[1]):
            np.dot(np.ascontiguousarray(features[:, t]), self._features, out=kernel)
            planned += np.exp(kernel, out=kernel)
        divergence = self._negative_entropy - np.log(normalise(self._visitation + planned)) @ self._share
        return divergence + self._barrier.cost(rollout.positions, rollout.velocities)

    def gradient(self, rollout: Rollout) -> Tuple[np.ndarray, np.ndarray]:
        """Return the gradients of J by the positions and by the velocities of one plan, (1, H, D) each.

        With q_i = sum_t psi(s_i|x_t) and Q = sum_i q_i:
            dJ/dx_t = sum_i (1 / Q - h_i / q_i) dpsi(s_i|x_t)/dx_t + db/dx_t
        """
        kernel = self._samples.kernel
        positions = rollout.positions[0]
        psi = np.exp(kernel.state_features(positions) @ self._features)
        weighted = psi * self._visitation_gradient(self._visitation + psi.sum(axis=0))
        total = weighted.sum(axis=1, keepdims=True)
        attraction = (weighted @ self._samples.states - positions * total) / kernel.variance
        by_position = attraction - total * kernel.log_mass_gradient(positions)
        barrier_position, barrier_velocity = self._barrier.gradient(rollout.positions, rollout.velocities)
        return by_position + barrier_position, barrier_velocity

    def _visitation_gradient(self, visitation: np.ndarray) -> np.ndarray:
        """Derivative (S,) of D_KL by the unnormalised visitation, ignoring the floor of d.

        With the floor, J would be flat far from all visited states; without it, the gradient attracts the arm there.
        """
        total = max(float(np.sum(visitation)), float(np.finfo(np.float32).tiny))
        return 1.0 / total - self._share / np.maximum(visitation, FLOOR * total)
