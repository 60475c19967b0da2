"""The plans compared at each improvement: the adjoint update on every window of the horizon, and random ones."""

from __future__ import annotations

from typing import Tuple

import numpy as np

LONGEST_WINDOW = 5  # steps, as in the authors' search for the time of application


def update_windows(horizon: int) -> np.ndarray:
    """Every window of 1 to LONGEST_WINDOW steps, and the whole horizon -> (W, horizon) bool."""
    windows = [
        [begin <= t < begin + length for t in range(horizon)]
        for begin in range(horizon)
        for length in range(1, min(LONGEST_WINDOW, horizon - begin) + 1)
    ]
    return np.array([*windows, [True] * horizon])


def window_candidates(controls: np.ndarray, update: np.ndarray, windows: np.ndarray) -> np.ndarray:
    """The plan with its update in one window each. controls, update: (H, D), windows: (W, H) -> (W, H, D).

    A window holds the update of its first step throughout; the last one, the whole horizon, takes every step's own.
    """
    held = update[np.argmax(windows, axis=1)][:, np.newaxis]
    candidates = np.where(windows[..., np.newaxis], held, controls)
    candidates[-1] = update
    return candidates


def random_candidates(random: np.random.Generator, shape: Tuple[int, int, int], limit: float) -> np.ndarray:
    """Plans of two random constant controls, switched at a random step -> shape (B, H, D), within +-limit."""
    count, horizon, axes = shape
    switch = random.integers(1, horizon, (count, 1))
    first, second = random.uniform(-limit, limit, (2, count, 1, axes))
    return np.where((np.arange(horizon) < switch)[..., np.newaxis], first, second)
