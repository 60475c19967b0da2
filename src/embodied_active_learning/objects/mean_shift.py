"""Mean-shift clustering by scikit-learn."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class PointClusters(NamedTuple):
    """Clusters of points.

    Attributes:
        centres: (C, D) of the clusters.
        labels: (N,) index of each point's cluster; -1 for a point that belongs to none.
    """

    centres: np.ndarray
    labels: np.ndarray


def mean_shift(points: np.ndarray, bandwidth: float, **settings: Any) -> PointClusters:
    """Cluster points (N, D) with a bandwidth in their units; settings: other arguments of scikit-learn's MeanShift."""
    # A slow import (1.6 s of processor time), which a trainer with a fixed number of steps never needs.
    from sklearn.cluster import MeanShift  # noqa: PLC0415

    fitted = MeanShift(bandwidth=bandwidth, **settings).fit(points)
    return PointClusters(fitted.cluster_centers_, fitted.labels_)
