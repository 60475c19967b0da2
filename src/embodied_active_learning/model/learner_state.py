"""The learner's state as named tensors and plain counters, as checkpoints store it."""

from __future__ import annotations

from typing import Any, Dict, Iterable, Iterator, Mapping, NamedTuple, Optional, Tuple

import torch

from embodied_active_learning.errors import ConfigError, CorruptFileError
from embodied_active_learning.model.optimiser import copy_to_cpu
from embodied_active_learning.state_dict import add_prefix, select_prefix

NETWORK = "network"
ADAM = "adam"
PREVIOUS = "previous_replica"
"""Prefixes of tensor names; PREVIOUS: of the replica of the previous refresh."""


class LearnerState(NamedTuple):
    """Everything that a resumed learner needs: tensors on the CPU, and counters that JSON can hold."""

    tensors: Dict[str, torch.Tensor]
    counters: Dict[str, Any]

    def non_finite(self) -> Optional[str]:
        """Return the name of the first tensor with a value that is not finite, or None."""
        return next((name for name, tensor in self.tensors.items() if not bool(tensor.isfinite().all())), None)


def copy_with_prefix(prefix: str, tensors: Mapping[str, torch.Tensor]) -> Dict[str, torch.Tensor]:
    """Return copies of the tensors on the CPU, with prefixed names."""
    return add_prefix(prefix, {name: copy_to_cpu(tensor) for name, tensor in tensors.items()})


def without_prefix(prefix: str, tensors: Mapping[str, torch.Tensor]) -> Dict[str, torch.Tensor]:
    """Return the tensors whose names do not have the prefix."""
    return {name: tensor for name, tensor in tensors.items() if not name.startswith(f"{prefix}/")}


def network_weights(tensors: Mapping[str, torch.Tensor]) -> Dict[str, torch.Tensor]:
    """Return the network's weights among a checkpoint's tensors, by the network's own names."""
    return select_prefix(NETWORK, tensors)


def pack(tensors: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """Return all elements of the tensors as one vector (P,) float32 on the CPU: a copy."""
    return torch.cat([tensor.detach().reshape(-1).to("cpu", torch.float32) for tensor in tensors.values()])


def unpack(vector: torch.Tensor, like: Mapping[str, torch.Tensor]) -> Iterator[Tuple[torch.Tensor, torch.Tensor]]:
    """Yield each of the tensors that pack() was given, with its elements in the vector (P,), in its shape."""
    parts = vector.split([tensor.numel() for tensor in like.values()])
    for tensor, part in zip(like.values(), parts):
        yield tensor, part.reshape(tensor.shape)


def require_keys(mapping: Mapping[str, Any], keys: Iterable[str]) -> None:
    """Raise CorruptFileError for the first missing key."""
    for key in keys:
        if key not in mapping:
            raise CorruptFileError(f"incomplete checkpoint: {key} is missing; delete the file")


def require_shapes(tensors: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]) -> None:
    """Raise CorruptFileError for a missing tensor, ConfigError for one more, or of another shape, than expected."""
    require_keys(tensors, expected)
    for key in tensors:
        if key not in expected:
            raise ConfigError(
                f"checkpoint of another model: this configuration has no {key}; use the configuration that the session "
                "was recorded with"
            )
    for key, tensor in expected.items():
        if tensors[key].shape != tensor.shape:
            raise ConfigError(
                f"checkpoint of another model: {key} is {tuple(tensors[key].shape)}, this configuration needs"
                f" {tuple(tensor.shape)}; use the configuration that the session was recorded with"
            )
