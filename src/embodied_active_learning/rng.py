"""Random generators: one seed for a run, and a stream of its own for each purpose, so that none disturbs another."""

from __future__ import annotations

from enum import IntEnum
from typing import Tuple

import numpy as np


class Stream(IntEnum):
    """What the random numbers are for."""

    SAMPLES = 101
    EXPLORER = 102
    EVALUATION = 103
    CLUSTERING = 104
    STORED_VIEWS = 105


def resumed_seed(seed: int, visited: int) -> int:
    """The seed of a run that goes on after so many observations: its own, so that it does not repeat its draws."""
    return int(np.random.SeedSequence([seed, visited]).generate_state(1)[0]) if visited else seed


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """The generator of one stream of a run's seed."""
    return np.random.default_rng(np.random.SeedSequence([seed, int(stream)]))


def generator_state(random: np.random.Generator) -> np.ndarray:
    """(6,) uint64: everything that decides what a generator will draw."""
    state = random.bit_generator.state
    words = [*_halves(state["state"]["state"]), *_halves(state["state"]["inc"]), state["has_uint32"], state["uinteger"]]
    return np.array(words, dtype=np.uint64)


def set_generator_state(random: np.random.Generator, words: np.ndarray) -> None:
    """Let a generator draw what the one drew whose words (6,) these are."""
    high, low, inc_high, inc_low, has_uint32, uinteger = map(int, words)
    state = random.bit_generator.state
    state["state"] = {"state": high << 64 | low, "inc": inc_high << 64 | inc_low}
    state["has_uint32"], state["uinteger"] = has_uint32, uinteger
    random.bit_generator.state = state


def _halves(number: int) -> Tuple[int, int]:
    """A number of 128 bits as two of 64, the higher one first."""
    return number >> 64, number & (2**64 - 1)
