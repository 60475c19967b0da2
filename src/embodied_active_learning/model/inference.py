"""Forward passes without gradients: image features, decoded images and reconstruction errors."""

from __future__ import annotations

from functools import lru_cache
from typing import List, Protocol

import torch
from torch import nn

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model.cvae import ConditionalVAE, Size
from embodied_active_learning.model.loss import Images
from embodied_active_learning.model.native.convolutions import NativeConvolutions
from embodied_active_learning.model.native.library import load_kernels

CHUNK = 64
"""Images per forward pass of torch, which limits the memory of the activations."""


class Inference(Protocol):
    """Forward passes of networks of one geometry. images: B images (H, W, 3) uint8; F features."""

    def encode(self, network: ConditionalVAE, images: Images) -> torch.Tensor:
        """Return the image features (B, F)."""
        ...

    def decode(self, network: ConditionalVAE, features: torch.Tensor) -> torch.Tensor:
        """Return the images (B, H, W, 3) decoded from features (B, F)."""
        ...

    def errors(self, network: ConditionalVAE, features: torch.Tensor, images: Images) -> torch.Tensor:
        """Return the mean squared error (B,) of the images decoded from features (B, F)."""
        ...

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """Return layer(inputs): (B, I) -> (B, O)."""
        ...


class TorchInference:
    """Forward passes of the network itself: on a GPU, and on the CPU without compiled kernels."""

    def encode(self, network: ConditionalVAE, images: Images) -> torch.Tensor:
        """See Inference."""
        return torch.cat([network.image_features(part) for part in _chunks(images)])

    def decode(self, network: ConditionalVAE, features: torch.Tensor) -> torch.Tensor:
        """See Inference."""
        parts = features.unflatten(1, network.feature_shape).split(CHUNK)
        return torch.cat([network.image_decoder(part) for part in parts]).permute(0, 2, 3, 1)

    def errors(self, network: ConditionalVAE, features: torch.Tensor, images: Images) -> torch.Tensor:
        """See Inference."""
        pairs = zip(features.split(CHUNK), _chunks(images))
        differences = (self.decode(network, part).sub_(target / 255.0) for part, target in pairs)
        return torch.cat([difference.square_().mean(dim=(1, 2, 3)) for difference in differences])

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """See Inference."""
        return layer(inputs)


class NativeInference:
    """Forward passes on the compiled kernels, equal to torch's within 1e-5. Safe to use from any thread."""

    def __init__(self, convolutions: NativeConvolutions) -> None:
        self.convolutions = convolutions

    def encode(self, network: ConditionalVAE, images: Images) -> torch.Tensor:
        """See Inference."""
        return self.convolutions.encode(network, images)

    def decode(self, network: ConditionalVAE, features: torch.Tensor) -> torch.Tensor:
        """See Inference."""
        return self.convolutions.decode(network, features)

    def errors(self, network: ConditionalVAE, features: torch.Tensor, images: Images) -> torch.Tensor:
        """See Inference."""
        # Computing unused gradients costs less than copying decoded images out of their groups.
        gradient = torch.empty_like(features).t()
        weights = torch.ones(len(features))
        return self.convolutions.reconstruct(network, features.t(), images, weights, gradient).errors

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """See Inference."""
        return self.convolutions.linear(layer, inputs)


def make_inference(image_size: Size, config: ModelConfig) -> Inference:
    """Return the fastest inference on the CPU for networks of a geometry.

    All networks of that geometry share its threads and memory: an identification may use dozens of them.
    """
    return _make_inference(image_size, config, torch.get_num_threads())


@lru_cache(maxsize=4)
def _make_inference(image_size: Size, config: ModelConfig, _threads: int) -> Inference:
    """_threads is part of the cache's key, because NativeConvolutions takes over torch's number of threads."""
    kernels = load_kernels().kernels
    if kernels is None:
        return TorchInference()
    with torch.device("meta"):
        geometry = ConditionalVAE(image_size, 0, config)  # its weights are not used
    return NativeInference(NativeConvolutions(geometry, kernels))


def _chunks(images: Images) -> List[torch.Tensor]:
    """Split images into tensors (<= CHUNK, H, W, 3)."""
    parts = (images[first : first + CHUNK] for first in range(0, len(images), CHUNK))
    return [part if isinstance(part, torch.Tensor) else torch.stack(list(part)) for part in parts]
