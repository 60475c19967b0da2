"""A shadow copy of the network that answers questions while the original goes on learning in another thread."""

from __future__ import annotations

import copy
import threading
from typing import Tuple

import numpy as np
import torch

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.model.cvae import ConditionalVAE, LatentGaussian

CHUNK = 64


class Snapshot:
    """The network as it was after `updates` updates. Safe to use from any thread; arrays in, arrays out."""

    def __init__(self, network: ConditionalVAE) -> None:
        self._network = copy.deepcopy(network).requires_grad_(False)
        self._device = next(network.parameters()).device
        self._lock = threading.Lock()
        self.updates = 0

    def log_std(self, states: np.ndarray, latent: np.ndarray) -> np.ndarray:
        """Log standard deviation of the image predicted at states (S, D) from one latent (L,). -> (S,) float32."""
        with self._lock, torch.inference_mode():
            return self._network.log_std(self._tensor(latent), self._tensor(states)).cpu().numpy()

    def conditional_log_std(self, states: np.ndarray, state: np.ndarray, image: np.ndarray) -> Tuple[np.ndarray, int]:
        """Log standard deviation predicted at states (S, D), given the mean latent of one observation.

        state: (D,) normalised, image: (H, W, 3) uint8 -> (S,) float32, and the updates of the model that answers.
        """
        self._check(state[np.newaxis], image[np.newaxis])
        with self._lock, torch.inference_mode():
            latent = self._latent(state[np.newaxis], image[np.newaxis]).mean[0]
            return self._network.log_std(latent, self._tensor(states)).cpu().numpy(), self.updates

    def encode(self, states: np.ndarray, images: np.ndarray) -> Tuple[np.ndarray, np.ndarray, int]:
        """q(z | x, y): mean and std, (B, L) float32 each, and the updates of the model that answers.

        states: (B, D) normalised; images: (B, H, W, 3) uint8, or (1, H, W, 3), which is then encoded only once.
        Raises ObservationError for images of another shape or type than the model was built for.
        """
        self._check(states, images)
        with self._lock, torch.inference_mode():
            latent = self._latent(states, images)
            return latent.mean.cpu().numpy(), latent.std.cpu().numpy(), self.updates

    def copy_from(self, network: ConditionalVAE, updates: int, wait: bool = False) -> bool:
        """Take over the weights, into the memory at hand. False, at once, if a reader is busy and wait is not set."""
        if not self._lock.acquire(blocking=wait):
            return False
        try:
            with torch.no_grad():
                for mine, theirs in zip(self._network.parameters(), network.parameters()):
                    mine.copy_(theirs)
            self.updates = updates
        finally:
            self._lock.release()
        return True

    def _latent(self, states: np.ndarray, images: np.ndarray) -> LatentGaussian:
        parts = torch.from_numpy(np.array(images)).split(CHUNK)
        features = torch.cat([self._network.image_features(part.to(self._device)) for part in parts])
        return self._network.encode_features(self._tensor(states), features)

    def _tensor(self, values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(self._device)

    def _check(self, states: np.ndarray, images: np.ndarray) -> None:
        expected = (*self._network.image_size, 3)
        if images.dtype != np.uint8 or images.shape[1:] != expected:
            raise ObservationError(
                f"images are {images.dtype} {images.shape}, the model was built for uint8 (B, *{expected})"
            )
        if len(images) not in (1, len(states)):
            raise ObservationError(f"{len(images)} images for {len(states)} states: give one each, or one for all")
