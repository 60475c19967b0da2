"""Mean-shift clustering by scikit-learn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sklearn.cluster import MeanShift


def mean_shift(points: np.ndarray, bandwidth: float, **settings: Any) -> MeanShift:
    """Cluster points (N, D) with a bandwidth in their units; settings: other arguments of MeanShift."""
    # A slow import (1.6 s of processor time), which a trainer with a fixed number of steps never needs.
    from sklearn.cluster import MeanShift  # noqa: PLC0415

    return MeanShift(bandwidth=bandwidth, **settings).fit(points)
