"""Evenly spread parts of sequences that are too long to be processed or shown completely."""

from __future__ import annotations

import numpy as np


def spread_indices(count: int, max_count: int) -> np.ndarray:
    """Return at most `max_count` evenly spread indices below `count`, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, max_count)).astype(int)) if count else np.empty(0, int)
