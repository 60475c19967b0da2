"""Saved state as named arrays: every stateful class has `state_dict()` and `load_state_dict(state)`."""

from __future__ import annotations

from typing import Dict, Mapping, TypeVar

import numpy as np

from embodied_active_learning.errors import CorruptFileError

StateDict = Dict[str, np.ndarray]
_Value = TypeVar("_Value")


def add_prefix(prefix: str, state: Mapping[str, _Value]) -> Dict[str, _Value]:
    """Return the state of a part under names of the whole, such as `samples/states`."""
    return {f"{prefix}/{name}": value for name, value in state.items()}


def select_prefix(prefix: str, state: Mapping[str, _Value]) -> Dict[str, _Value]:
    """Return the state of one part of a whole, without the prefix."""
    start = f"{prefix}/"
    return {name[len(start) :]: value for name, value in state.items() if name.startswith(start)}


def matching_arrays(state: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> StateDict:
    """Return copies of the expected arrays from a saved state; other arrays are ignored.

    Args:
        state: the saved state.
        expected: arrays with the required names, types and shapes; an axis of length 0 accepts any length.

    Raises:
        CorruptFileError: an array is missing or has another type or shape.
    """
    arrays = {}
    for name, like in expected.items():
        array = state.get(name)
        if array is None:
            raise CorruptFileError(f"saved state has no array {name!r}: it was written by another version")
        shape_fits = array.ndim == like.ndim and all(n in (0, m) for n, m in zip(like.shape, array.shape))
        if not shape_fits or array.dtype != like.dtype:
            raise CorruptFileError(
                f"saved array {name!r} is {array.dtype} {array.shape}, this configuration needs "
                f"{like.dtype} {like.shape}"
            )
        arrays[name] = array.copy()
    return arrays
