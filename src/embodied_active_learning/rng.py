"""Random generators: one seed per run, and an independent stream per purpose."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Dict, Tuple

import numpy as np


class Stream(IntEnum):
    """Purpose of a random stream."""

    SAMPLES = 101
    EXPLORER = 102
    CLUSTERING = 104
    STORED_VIEWS = 105
    BATCHES = 201
    STATES = 202
    SUBSET = 203
    WORKER = 204


def resumed_seed(seed: int, visited: int) -> int:
    """Return the seed of a run that resumes after a number of observations; it differs, to not repeat earlier draws."""
    return int(np.random.SeedSequence([seed, visited]).generate_state(1)[0]) if visited else seed


def seed_sequence(seed: int, stream: Stream, *key: int) -> np.random.SeedSequence:
    """Return the seeds of a stream, or of the part of it that a key names."""
    return np.random.SeedSequence([seed, int(stream), *key])


def generator(seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """Return the generator of a stream, or of the part of it that a key names."""
    return np.random.default_rng(seed_sequence(seed, stream, *key))


def generator_state(random: np.random.Generator) -> np.ndarray:
    """Return the complete state of a generator as (6,) uint64."""
    state = random.bit_generator.state
    words = [*_halves(state["state"]["state"]), *_halves(state["state"]["inc"]), state["has_uint32"], state["uinteger"]]
    return np.array(words, dtype=np.uint64)


def set_generator_state(random: np.random.Generator, words: np.ndarray) -> None:
    """Set the state of a generator. words: (6,) result of generator_state."""
    high, low, inc_high, inc_low, has_uint32, uinteger = map(int, words)
    state: Dict[str, Any] = dict(random.bit_generator.state)
    state["state"] = {"state": high << 64 | low, "inc": inc_high << 64 | inc_low}
    state["has_uint32"], state["uinteger"] = has_uint32, uinteger
    random.bit_generator.state = state


def _halves(number: int) -> Tuple[int, int]:
    """Split a 128-bit number into two of 64 bits, the higher one first."""
    return number >> 64, number & (2**64 - 1)
