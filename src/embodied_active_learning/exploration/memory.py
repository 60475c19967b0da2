"""What an exploration remembers, as named arrays that a file can hold, and as parts that fill each other's gaps."""

from __future__ import annotations

from typing import Dict, Mapping

import numpy as np

from embodied_active_learning.errors import CorruptFileError

Memory = Dict[str, np.ndarray]


def part(memory: Mapping[str, np.ndarray], name: str) -> Memory:
    """The arrays of one part, by the names that the part gave them."""
    prefix = f"{name}/"
    return {key[len(prefix) :]: array for key, array in memory.items() if key.startswith(prefix)}


def as_part(name: str, memory: Mapping[str, np.ndarray]) -> Memory:
    """The arrays of a part, by names that tell of which part they are."""
    return {f"{name}/{key}": array for key, array in memory.items()}


def recall(memory: Mapping[str, np.ndarray], like: Mapping[str, np.ndarray]) -> Memory:
    """Copies of the arrays that `like` has. Raises CorruptFileError naming one that is missing or of another kind.

    An axis of length 0 in `like` may have any length.
    """
    recalled = {}
    for name, expected in like.items():
        array = memory.get(name)
        if array is None:
            raise CorruptFileError(f"the planner's memory lacks {name}: it is not of this version")
        fits = array.ndim == expected.ndim and all(n in (0, m) for n, m in zip(expected.shape, array.shape))
        if not fits or array.dtype != expected.dtype:
            raise CorruptFileError(
                f"the planner's memory holds {name} as {array.dtype} {array.shape}, this configuration makes it "
                f"{expected.dtype} {expected.shape}"
            )
        recalled[name] = array.copy()
    return recalled
