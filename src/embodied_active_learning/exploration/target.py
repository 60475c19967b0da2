"""Where to spend time: the conditional-entropy target distribution, and how far the arm's time average is from it."""

from __future__ import annotations

import numpy as np

from embodied_active_learning.errors import EmbodiedActiveLearningError

FLOOR = 1e-6  # smallest share of one sample, as the authors have it: bounds the measure, and log never sees zero


def target_distribution(log_std: np.ndarray, coverage: float) -> np.ndarray:
    """h(s) ~ exp(entropy)^k = std(s)^k over workspace samples, summing to 1. log_std: (S,) -> (S,).

    Paper, Sec. 4, control formulation. The entropy is that of one pixel, so that exp(entropy) is proportional to the
    predicted standard deviation.
    """
    log_std = np.asarray(log_std, dtype=np.float64)
    bad = np.count_nonzero(~np.isfinite(log_std))
    if bad:
        raise EmbodiedActiveLearningError(
            f"the conditional entropy of {bad} of {log_std.size} samples is not finite: the model has diverged:"
            " delete the newest file in the session's checkpoints/, and resume"
        )
    return normalise(np.exp(coverage * (log_std - log_std.max())))


def flat_distribution(count: int) -> np.ndarray:
    """The target before anything was learned: the same everywhere. -> (count,), summing to 1."""
    return np.full(count, 1.0 / count)


def normalise(weights: np.ndarray) -> np.ndarray:
    """Weights (..., S) -> distributions (..., S): divided by their sum, floored at FLOOR, and summing to 1 again.

    All-zero weights (no state visited yet) give the flat distribution.
    """
    total = np.sum(weights, axis=-1, keepdims=True)
    shares = np.maximum(weights / np.where(total > 0.0, total, 1.0), FLOOR)
    return shares / np.sum(shares, axis=-1, keepdims=True)


def kl_ergodic(target: np.ndarray, visitation: np.ndarray) -> float:
    """KL-ergodic measure D_KL(h || d), nats: 0 when time was spent as the target asks. Paper, Sec. 2.3.

    target: (S,) h; visitation: (S,) kernel sums of the visited states, or of visited and planned ones, any scale.
    """
    share, average = normalise(target), normalise(visitation)
    return float(np.sum(share * np.log(share / average)))
