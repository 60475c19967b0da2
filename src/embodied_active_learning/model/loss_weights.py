"""The weights beta and gamma of the loss, as functions of entropy and coverage. Paper, Alg. 1, line 13."""

from __future__ import annotations

import math
import sys
from collections import deque
from typing import Any, Deque, Dict, Tuple

import numpy as np

from embodied_active_learning.config import ObjectiveConfig


def beta_from_log_std(log_std: np.ndarray, coverage: float, chi: float, beta_max: float) -> float:
    """Return the weight of the KL divergence. Paper, Alg. 1, line 13, clamped to beta_max.

    log10 beta = -log10 min(h / max h) - chi, with h = std^k (Paper, Eq. 29, with the entropy of one pixel).

    Args:
        log_std: (S,) of the decoder at workspace samples.
        coverage: Workspace coverage k (Paper, Alg. 1, line 8).
        chi: Regularisation scale.
        beta_max: Upper limit.
    """
    spread = coverage * float(np.max(log_std) - np.min(log_std))
    exponent = min(spread / math.log(10.0) - chi, sys.float_info.max_10_exp)
    return min(10.0**exponent, beta_max)


def gamma_from_coverage(coverage: float, weight: float) -> float:
    """Return the weight of the conditional reconstruction, weight * k. Paper, Alg. 1, line 13: 0.1 k."""
    return weight * coverage


class LossWeights:
    """beta and gamma, averaged over the last evaluations so that a single outlier does not disturb training."""

    def __init__(self, config: ObjectiveConfig) -> None:
        self._config = config
        self._window: Deque[Tuple[float, float]] = deque(maxlen=config.schedule_window)
        self.coverage = 0.0
        self.log_std_min = 0.0
        self.log_std_max = 0.0

    @property
    def beta(self) -> float:
        """Mean over the window; before the first evaluation the smallest possible value, 10^-chi."""
        if not self._window:
            return beta_from_log_std(np.zeros(1), 0.0, self._config.chi, self._config.beta_max)
        return sum(beta for beta, _ in self._window) / len(self._window)

    @property
    def gamma(self) -> float:
        """Mean over the window; 0 before the first evaluation."""
        return sum(gamma for _, gamma in self._window) / max(len(self._window), 1)

    def evaluate(self, log_std: np.ndarray, coverage: float) -> None:
        """Add an evaluation: log std at workspace samples (S,) and coverage k. Non-finite input changes nothing."""
        if not (math.isfinite(coverage) and np.all(np.isfinite(log_std))):
            return
        config = self._config
        beta = beta_from_log_std(log_std, coverage, config.chi, config.beta_max)
        self._window.append((beta, gamma_from_coverage(coverage, config.gamma_weight)))
        self.coverage = float(coverage)
        self.log_std_min, self.log_std_max = float(np.min(log_std)), float(np.max(log_std))

    def state_dict(self) -> Dict[str, Any]:
        """Return the state as plain numbers and lists."""
        return {
            "window": [list(entry) for entry in self._window],
            "coverage": self.coverage,
            "log_std_min": self.log_std_min,
            "log_std_max": self.log_std_max,
        }

    def load_state_dict(self, state: Dict[str, Any]) -> None:
        """Restore state_dict()."""
        self._window.clear()
        self._window.extend((float(beta), float(gamma)) for beta, gamma in state["window"])
        self.coverage = float(state["coverage"])
        self.log_std_min, self.log_std_max = float(state["log_std_min"]), float(state["log_std_max"])
