"""Shadow copies of the network that answer questions while the original goes on learning in another thread."""

from __future__ import annotations

import copy
import threading
from contextlib import contextmanager
from typing import Dict, Iterator, Mapping, Optional, Tuple

import numpy as np
import torch

from embodied_active_learning.errors import ObservationError
from embodied_active_learning.model.cvae import ConditionalVAE, LatentGaussian
from embodied_active_learning.model.inference import InferenceImages


class Replica:
    """A network that nobody trains, with the updates it was made after. Whoever holds the lock may use it."""

    def __init__(self, network: ConditionalVAE, images: InferenceImages) -> None:
        self.network = copy.deepcopy(network).requires_grad_(False)
        self._images = images
        self.lock = threading.Lock()
        self.updates = 0
        self._device = next(network.parameters()).device

    def latent(self, states: np.ndarray, images: np.ndarray) -> LatentGaussian:
        """q(z | x, y) at states (B, D) normalised, from images (B, H, W, 3) or (1, H, W, 3) uint8."""
        pixels = torch.from_numpy(np.array(images)).to(self._device)
        # One image does not fill the compiled kernels' groups.
        alone = len(pixels) == 1
        features = self.network.image_features(pixels) if alone else self._images.features(self.network, pixels)
        return self.network.encode_features(self.tensor(states), features)

    def log_std(self, states: np.ndarray, latent: torch.Tensor) -> np.ndarray:
        """Log standard deviation (S,) predicted at states (S, D) normalised, from one latent (L,)."""
        return self.network.log_std(latent, self.tensor(states)).cpu().numpy()

    def tensor(self, values: np.ndarray) -> torch.Tensor:
        """Numbers as the network takes them."""
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(self._device)


class Replicas:
    """The network as it was at the last two refreshes. Safe to use from any thread; arrays in, arrays out.

    Two, because learning goes on while the planner looks at what the model before said: see `min_updates`.
    """

    def __init__(self, network: ConditionalVAE, images: InferenceImages) -> None:
        """images: how the network is asked on its device."""
        self._copies = Replica(network, images), Replica(network, images)
        # Number and updates of the older copy and of the newer one: replaced at once, so that none reads half a change.
        self._order = (0, 0), (1, 0)

    @property
    def updates(self) -> int:
        """Updates of the newest model."""
        return self._order[1][1]

    def log_std(self, states: np.ndarray, latent: np.ndarray) -> np.ndarray:
        """Log standard deviation of the image predicted at states (S, D) from one latent (L,). -> (S,) float32."""
        with torch.inference_mode(), self._reading() as found:
            return found.log_std(states, found.tensor(latent))

    def conditional_log_std(
        self, states: np.ndarray, state: np.ndarray, image: np.ndarray, min_updates: int = 0
    ) -> Tuple[np.ndarray, int]:
        """Log standard deviation predicted at states (S, D), given the mean latent of one observation.

        state: (D,) normalised, image: (H, W, 3) uint8 -> (S,) float32, and the updates of the model that answers: the
        older one if min_updates are its own, so that who counts updates hears the very model that it waited for.
        """
        self._check(state[np.newaxis], image[np.newaxis])
        with torch.inference_mode(), self._reading(min_updates) as found:
            latent = found.latent(state[np.newaxis], image[np.newaxis]).mean[0]
            return found.log_std(states, latent), found.updates

    def encode(self, states: np.ndarray, images: np.ndarray) -> Tuple[np.ndarray, np.ndarray, int]:
        """q(z | x, y): mean and std, (B, L) float32 each, and the updates of the model that answers.

        states: (B, D) normalised; images: (B, H, W, 3) uint8, or (1, H, W, 3), which is then encoded only once.
        Raises ObservationError for images of another shape or type than the model was built for.
        """
        self._check(states, images)
        with torch.inference_mode(), self._reading() as found:
            latent = found.latent(states, images)
            return latent.mean.cpu().numpy(), latent.std.cpu().numpy(), found.updates

    def take(self, weights: Mapping[str, torch.Tensor], updates: int) -> None:
        """Take over weights by name in place of the older copy's, once nobody reads it any more.

        One thread at a time may call it.
        """
        (oldest, _), newest = self._order
        found = self._copies[oldest]
        with found.lock, torch.no_grad():
            for name, mine in found.network.named_parameters():
                mine.copy_(weights[name])
            found.updates = updates
            self._order = newest, (oldest, updates)

    def weights_before(self, updates: int) -> Optional[Tuple[Dict[str, torch.Tensor], int]]:
        """Weights by name, and their updates, of the newest model with fewer updates; None if there is none."""
        for index, made in reversed(self._order):
            if 0 < made < updates:
                return dict(self._copies[index].network.named_parameters()), made
        return None

    @contextmanager
    def _reading(self, min_updates: int = 0) -> Iterator[Replica]:
        """The newer copy, or the older one if that is the one asked for; kept from being replaced meanwhile."""
        while True:
            older, newer = self._order
            index, updates = older if 0 < min_updates == older[1] else newer
            found = self._copies[index]
            with found.lock:
                if found.updates == updates:
                    yield found
                    return

    def _check(self, states: np.ndarray, images: np.ndarray) -> None:
        expected = (*self._copies[0].network.image_size, 3)
        if images.dtype != np.uint8 or images.shape[1:] != expected:
            raise ObservationError(
                f"images are {images.dtype} {images.shape}, the model was built for uint8 (N, *{expected}): "
                "check camera/height and camera/width"
            )
        if len(images) not in (1, len(states)):
            raise ObservationError(f"{len(images)} images for {len(states)} states: give one each, or one for all")
