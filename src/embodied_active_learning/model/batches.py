"""Mini-batches from the growing store of observations, on the device where the model lives."""

from __future__ import annotations

from typing import Optional, Protocol

import numpy as np
import torch

from embodied_active_learning.model.objective import Batch


class Observations(Protocol):
    """What the learner needs of a store: rows are only ever appended, and the arrays may move when it grows."""

    states: np.ndarray  # (N, D) float32, normalised
    images: np.ndarray  # (N, H, W, 3) uint8

    def __len__(self) -> int:
        """Number of observations N."""
        ...


class BatchReader:
    """Gathers observations by index; with `keep`, images stay on the device so that a batch costs no transfer."""

    def __init__(self, observations: Observations, device: torch.device, keep: bool) -> None:
        self._observations = observations
        self._device = device
        self._keep = keep
        self._buffer = np.empty(0, np.uint8)
        self._cache: Optional[torch.Tensor] = None
        self._cached = 0

    def read(self, indices: np.ndarray) -> Batch:
        """The observations of these indices (B,). The images are valid until the next call."""
        states = np.asarray(self._observations.states[indices], dtype=np.float32)
        return Batch(torch.from_numpy(states).to(self._device), self._images(indices))

    def read_in_place(self, indices: np.ndarray) -> Batch:
        """The same with the images where they are stored, which costs nothing; on the CPU."""
        stored = torch.from_numpy(self._observations.images)
        states = np.asarray(self._observations.states[indices], dtype=np.float32)
        return Batch(torch.from_numpy(states), [stored[index] for index in indices.tolist()])

    def _images(self, indices: np.ndarray) -> torch.Tensor:
        if not self._keep:
            return torch.from_numpy(self._copy_to_buffer(indices)).to(self._device)
        self._extend_cache(len(self._observations))
        return self._cache[torch.from_numpy(indices).to(self._device)]

    def _copy_to_buffer(self, indices: np.ndarray) -> np.ndarray:
        # One buffer for all batches: fresh memory of this size costs more in page faults than the copy itself.
        images = self._observations.images
        shape = (len(indices), *images.shape[1:])
        if self._buffer.shape != shape:
            self._buffer = np.empty(shape, np.uint8)
        return np.take(images, indices, axis=0, out=self._buffer, mode="clip")

    def _extend_cache(self, count: int) -> None:
        """Bring images [0, count) to the device, doubling the room when it is full."""
        images = self._observations.images
        if self._cache is None or len(self._cache) < count:
            grown = torch.empty((max(2 * count, 256), *images.shape[1:]), dtype=torch.uint8, device=self._device)
            if self._cache is not None:
                grown[: self._cached] = self._cache[: self._cached]
            self._cache = grown
        if self._cached < count:
            self._cache[self._cached : count] = torch.from_numpy(np.array(images[self._cached : count]))
            self._cached = count
