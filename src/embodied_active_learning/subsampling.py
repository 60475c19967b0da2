"""Evenly spread parts of sequences that are too long to be processed or shown completely."""

from __future__ import annotations

import numpy as np


def spread_indices(count: int, most: int) -> np.ndarray:
    """Return at most `most` evenly spread indices below `count`, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)) if count else np.empty(0, int)
