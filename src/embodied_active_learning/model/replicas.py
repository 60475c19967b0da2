"""Copies of the network that serve queries while the original is trained in another thread."""

from __future__ import annotations

import copy
import threading
from contextlib import contextmanager
from typing import Dict, Iterator, Mapping, Optional, Tuple

import numpy as np
import torch

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.model.cvae import ConditionalVAE, LatentGaussian
from embodied_active_learning.model.inference import Inference


class Replica:
    """A copy of the network after some number of updates. Hold the lock while using it."""

    def __init__(self, network: ConditionalVAE, inference: Inference) -> None:
        self.network = copy.deepcopy(network).requires_grad_(False)
        self._inference = inference
        self.lock = threading.Lock()
        self.updates = 0
        self._device = next(network.parameters()).device

    def latent(self, states: np.ndarray, images: np.ndarray) -> LatentGaussian:
        """Return q(z | x, y) at states (B, D) normalised, from images (B, H, W, 3) or (1, H, W, 3) uint8."""
        pixels = torch.from_numpy(np.array(images)).to(self._device)
        if len(pixels) == 1:  # which would leave most lanes of the compiled kernels empty
            features = self.network.image_features(pixels)
        else:
            features = self._inference.encode(self.network, pixels)
        return self.network.encode_features(self.tensor(states), features)

    def log_std(self, states: np.ndarray, latent: torch.Tensor) -> np.ndarray:
        """Return the predicted log standard deviation (S,) at states (S, D) normalised, for one latent (L,)."""
        return self.network.log_std(latent, self.tensor(states)).cpu().numpy()

    def tensor(self, values: np.ndarray) -> torch.Tensor:
        """Return values as float32 on the network's device."""
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(self._device)


class Replicas:
    """The network at its last two refreshes. Thread-safe; arrays in, arrays out.

    There are two because the planner may query an earlier model while training continues, see `min_updates`.
    """

    def __init__(self, network: ConditionalVAE, inference: Inference) -> None:
        self._replicas = Replica(network, inference), Replica(network, inference)
        # (index, updates) of the older and of the newer replica; replaced as one object, so that reads are consistent.
        self._order = (0, 0), (1, 0)

    @property
    def updates(self) -> int:
        """Number of updates of the newest model."""
        return self._order[1][1]

    def conditional_log_std(
        self, states: np.ndarray, state: np.ndarray, image: np.ndarray, min_updates: int = 0
    ) -> Tuple[np.ndarray, int]:
        """Return the log std predicted at states, given the mean latent of one observation. Paper, Eq. 29.

        Args:
            states: (S, D) normalised.
            state: (D,) normalised, where the observation was made.
            image: (H, W, 3) uint8.
            min_updates: The older model is used if it has exactly this number of updates, so that a caller which
                waits for an update gets that very model; otherwise the newest is used.

        Returns:
            Log std (S,) float32, and the number of updates of the model used.
        """
        self._check(state[np.newaxis], image[np.newaxis])
        with torch.inference_mode(), self._locked(min_updates) as replica:
            latent = replica.latent(state[np.newaxis], image[np.newaxis]).mean[0]
            return replica.log_std(states, latent), replica.updates

    def encode(self, states: np.ndarray, images: np.ndarray) -> Tuple[np.ndarray, np.ndarray, int]:
        """Return mean and std of q(z | x, y), (B, L) float32 each, and the number of updates of the model.

        Args:
            states: (B, D) normalised.
            images: (B, H, W, 3) uint8, or (1, H, W, 3) for all states.

        Raises:
            ObservationError: The images have another shape or type than the model's.
        """
        self._check(states, images)
        with torch.inference_mode(), self._locked() as replica:
            latent = replica.latent(states, images)
            return latent.mean.cpu().numpy(), latent.std.cpu().numpy(), replica.updates

    def refresh(self, weights: Mapping[str, torch.Tensor], updates: int) -> None:
        """Copy weights by name into the older replica once no reader holds it. One thread at a time may call it."""
        (oldest, _), newest = self._order
        replica = self._replicas[oldest]
        with replica.lock, torch.no_grad():
            for name, parameter in replica.network.named_parameters():
                parameter.copy_(weights[name])
            replica.updates = updates
            self._order = newest, (oldest, updates)

    def weights_before(self, updates: int) -> Optional[Tuple[Dict[str, torch.Tensor], int]]:
        """Return weights and updates of the newest trained model with fewer updates, or None."""
        for index, made in reversed(self._order):
            if 0 < made < updates:
                return dict(self._replicas[index].network.named_parameters()), made
        return None

    @contextmanager
    def _locked(self, min_updates: int = 0) -> Iterator[Replica]:
        """Lock the newer replica, or the older one if it has exactly min_updates."""
        while True:
            older, newer = self._order
            index, updates = older if 0 < min_updates == older[1] else newer
            replica = self._replicas[index]
            with replica.lock:
                if replica.updates == updates:
                    yield replica
                    return

    def _check(self, states: np.ndarray, images: np.ndarray) -> None:
        expected = (*self._replicas[0].network.image_size, 3)
        if images.dtype != np.uint8 or images.shape[1:] != expected:
            raise ObservationError(
                f"images of the wrong size or type: {images.dtype} {images.shape}, the model needs uint8"
                f" (N, *{expected}); check camera/height and camera/width"
            )
        if len(images) not in (1, len(states)):
            raise ObservationError(f"{len(images)} images for {len(states)} states: give one each, or one for all")
