"""A trained network for fingerprinting and identification: arrays in SI units in, arrays out."""

from __future__ import annotations

from typing import Dict, Tuple

import numpy as np
import torch
from torch.nn import functional

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.model.cvae import ConditionalVAE
from embodied_active_learning.model.inference import make_inference

_PAIRS = 2048
"""Pairs of image and state per forward pass, so that activations stay in the cache."""
_STATES = 8192
"""States per forward pass of the log std."""


class TrainedModel:
    """Encoder and decoder with fixed weights. States are (..., 3) [m, m, rad] in the base frame."""

    def __init__(self, config: Config, weights: Dict[str, torch.Tensor]) -> None:
        """Raises RuntimeError if the weights don't fit the configured camera, workspace and model."""
        self._workspace = config.workspace.box()
        self.network = ConditionalVAE((config.camera.height, config.camera.width), self._workspace.size, config.model)
        self.network.load_state_dict(weights)
        self.network.eval().requires_grad_(False)
        self._inference = make_inference(self.network.image_size, config.model)

    @property
    def latent_size(self) -> int:
        """Number of latents L."""
        return self.network.latent_size

    def image_features(self, images: np.ndarray) -> np.ndarray:
        """Return the encoder's image features (N, F) float32, which do not depend on the state.

        Args:
            images: (N, H, W, 3) uint8.

        Raises:
            ObservationError: The images have another size or type than the model's.
        """
        expected = (*self.network.image_size, 3)
        if images.dtype != np.uint8 or images.shape[1:] != expected:
            raise ObservationError(
                f"images of the wrong size or type: {images.dtype} {images.shape}, the model was trained with uint8"
                f" (N, *{expected}); check camera/height and camera/width"
            )
        return self._inference.encode(self.network, torch.from_numpy(np.ascontiguousarray(images))).numpy()

    def encode(self, states: np.ndarray, images: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return mean and std of q(z | x, y), (N, L) float32 each, of N images at N states."""
        return self.encode_features(states, self.image_features(images))

    def encode_features(self, states: np.ndarray, features: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return mean and std of q(z | x, y), (N, L) float32 each, from image_features (N, F)."""
        with torch.inference_mode():
            latent = self.network.encode_features(self._normalised(states), torch.from_numpy(features))
            return latent.mean.numpy(), latent.std.numpy()

    def encode_pairs(self, states: np.ndarray, features: np.ndarray) -> np.ndarray:
        """Return the mean latents (N, V, L) of N images, given as features (N, F), each at all V states.

        The image's part of the first layer is shared by all states, the states' part by all images.
        """
        first, rest = self.network.encoder[0], self.network.encoder[2:]
        width = features.shape[1]
        with torch.inference_mode():
            of_states = self._normalised(states) @ first.weight[:, width:].T
            of_images = functional.linear(torch.from_numpy(features), first.weight[:, :width], first.bias)
            pairs = [
                rest((part[:, None] + of_states).relu_().flatten(0, 1))
                for part in of_images.split(max(1, _PAIRS // max(1, len(of_states))))
            ]
            means = torch.cat(pairs)[:, : self.latent_size]
        return means.reshape(len(features), len(states), self.latent_size).numpy()

    def decode(self, latents: np.ndarray, states: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return mean image (N, H, W, 3) float32 in [0, 1] and std (N,) of p(y | z, x), for latents (N, L)."""
        log_std, features = self.network.decode_features(
            torch.from_numpy(np.ascontiguousarray(latents)), self._normalised(states)
        )
        return self._inference.decode(self.network, features).clamp_(0.0, 1.0).numpy(), log_std.exp().numpy()

    def log_std(self, latents: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Return the log std (N, S) float32 of p(y | z, x) for N latents (N, L), each at all S states."""
        parts = self._normalised(states).split(_STATES)
        with torch.inference_mode():
            rows = [torch.cat([self.network.log_std(z, part) for part in parts]) for z in torch.from_numpy(latents)]
            return torch.stack(rows).numpy()

    def _normalised(self, states: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(self._workspace.normalise(states).astype(np.float32))
