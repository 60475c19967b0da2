"""Random generators: one seed for a run, and a stream of its own for each purpose, so that none disturbs another."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What the random numbers are for."""

    SAMPLES = 101
    EXPLORER = 102
    EVALUATION = 103
    CLUSTERING = 104


def continued_seed(seed: int, visited: int) -> int:
    """The seed of a run that goes on after so many observations: its own, so that it does not repeat its draws."""
    return int(np.random.SeedSequence([seed, visited]).generate_state(1)[0]) if visited else seed


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """The generator of one stream of a run's seed."""
    return np.random.default_rng(np.random.SeedSequence([seed, int(stream)]))
