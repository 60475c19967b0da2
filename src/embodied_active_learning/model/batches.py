"""Mini-batches from the growing store of observations."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch

from embodied_active_learning.model.loss import Batch, Images


class ObservationSource(Protocol):
    """Store of N observations. Rows are only appended; the arrays may be replaced when it grows."""

    @property
    def states(self) -> np.ndarray:
        """(N, D) float32, normalised."""
        ...

    @property
    def images(self) -> np.ndarray:
        """(N, H, W, 3) uint8."""
        ...

    def __len__(self) -> int:
        """Return N."""
        ...


class BatchReader:
    """Reads observations by index: on the CPU without copying images, on a GPU from a cache on the device."""

    def __init__(self, observations: ObservationSource, device: torch.device) -> None:
        self._observations = observations
        self._device = device
        self._copies = device.type != "cpu"
        self._cache = torch.empty(0, dtype=torch.uint8)
        self._cached = 0

    def read(self, indices: np.ndarray) -> Batch:
        """Return the observations with these indices (B,), on the device."""
        states = self._observations.states[indices].astype(np.float32, copy=False)
        return Batch(torch.from_numpy(states).to(self._device), self._images(indices))

    def _images(self, indices: np.ndarray) -> Images:
        if not self._copies:
            stored = torch.from_numpy(self._observations.images)
            return [stored[index] for index in indices.tolist()]
        self._extend_cache(len(self._observations))
        return self._cache[torch.from_numpy(indices).to(self._device)]

    def _extend_cache(self, count: int) -> None:
        """Copy images [0, count) to the device, doubling the cache when it is full."""
        images = self._observations.images
        if len(self._cache) < count:
            grown = torch.empty((max(2 * count, 256), *images.shape[1:]), dtype=torch.uint8, device=self._device)
            if self._cached:
                grown[: self._cached] = self._cache[: self._cached]
            self._cache = grown
        if self._cached < count:
            self._cache[self._cached : count] = torch.from_numpy(np.array(images[self._cached : count]))
            self._cached = count
