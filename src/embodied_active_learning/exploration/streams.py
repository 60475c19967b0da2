"""Random generators: one seed for a run, and a stream of its own for each purpose, so that none disturbs another."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What the random numbers are for."""

    SAMPLES = 101
    EXPLORER = 102
    EVALUATION = 103


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """The generator of one stream of a run's seed."""
    return np.random.default_rng(np.random.SeedSequence([seed, int(stream)]))
