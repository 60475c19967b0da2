"""A network that is only asked, for features, images and large layers: no gradients, so nothing is kept for them."""

from __future__ import annotations

from functools import lru_cache
from typing import Union

import torch
from torch import nn

from embodied_active_learning.config import ModelConfig
from embodied_active_learning.model.cvae import ConditionalVAE, Size
from embodied_active_learning.model.native.convolutions import NativeImages
from embodied_active_learning.model.native.kernels import Kernels
from embodied_active_learning.model.native.library import load_library

CHUNK = 64
"""Images that torch takes at a time, so that what lies between the layers stays small."""


class TorchImages:
    """What the network itself computes: for machines without a compiler."""

    def features(self, network: ConditionalVAE, images: torch.Tensor) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, F)."""
        return torch.cat([network.image_features(part) for part in images.split(CHUNK)])

    def decode(self, network: ConditionalVAE, features: torch.Tensor) -> torch.Tensor:
        """Features (B, F) -> images (B, H, W, 3)."""
        parts = features.unflatten(1, network.feature_shape).split(CHUNK)
        return torch.cat([network.image_decoder(part) for part in parts]).permute(0, 2, 3, 1)

    def errors(self, network: ConditionalVAE, features: torch.Tensor, images: torch.Tensor) -> torch.Tensor:
        """Mean squared error (B,) of what is decoded from each of the features (B, F); images: (B, H, W, 3) uint8."""
        pairs = zip(features.split(CHUNK), images.split(CHUNK))
        found = [self.decode(network, part).sub_(seen / 255.0).square_().mean(dim=(1, 2, 3)) for part, seen in pairs]
        return torch.cat(found)

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        return layer(inputs)


class CompiledImages:
    """The same on the compiled kernels, equal to 1e-5; each thread has room for one group of images, and no more."""

    def __init__(self, native: NativeImages) -> None:
        """native: for the geometry of the networks that will be asked."""
        self._native = native

    def features(self, network: ConditionalVAE, images: torch.Tensor) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, F)."""
        native, images = self._native, images.contiguous()
        chain, found = native.encoder_chain(network), torch.empty((len(images), native.feature_size))

        def encode(_: int, members: slice) -> None:
            room = native.borrow(native.inwards)
            native.kernels.encode(chain, images[members], room, found[members])
            native.give_back(room, native.inwards)

        native.for_each_group(len(images), encode)
        return found

    def decode(self, network: ConditionalVAE, features: torch.Tensor) -> torch.Tensor:
        """Features (B, F) -> images (B, H, W, 3)."""
        native, chain = self._native, self._native.decoder_chain(network)
        channels, *size = native.layers[0].wide
        images, all_sides = torch.empty((len(features), *size, channels)), range(len(native.layers) + 1)

        def decode(_: int, members: slice) -> None:
            room = native.borrow(all_sides)
            native.kernels.decode(chain, features[members], room)
            shown = images[members].numpy()
            shown[:] = room.tensors[0].numpy().transpose(3, 1, 2, 0)[: len(shown)]
            native.give_back(room, all_sides)

        native.for_each_group(len(images), decode)
        return images

    def errors(self, network: ConditionalVAE, features: torch.Tensor, images: torch.Tensor) -> torch.Tensor:
        """Mean squared error (B,) of what is decoded from each of the features (B, F); images: (B, H, W, 3) uint8."""
        # Its gradients cost less than to take decoded images out of their groups, and to compare them outside.
        slopes = torch.empty_like(features).t()
        return self._native.reconstruct(network, features.t(), images, torch.ones(len(features)), slopes).each

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        return self._native.linear(layer, inputs)


InferenceImages = Union[TorchImages, CompiledImages]


def fastest_images(image_size: Size, config: ModelConfig) -> InferenceImages:
    """The fastest that this machine has for networks of a geometry; load_library tells what that is, and why.

    All networks of that geometry share its threads and its memory: an identification may ask dozens of them.
    """
    return _fastest_images(image_size, config, torch.get_num_threads())


@lru_cache(maxsize=4)
def _fastest_images(image_size: Size, config: ModelConfig, _threads: int) -> InferenceImages:
    """_threads: how many it will take from torch; when that number was changed, it is made anew."""
    library, _ = load_library()
    if library is None:
        return TorchImages()
    with torch.device("meta"):
        geometry = ConditionalVAE(image_size, 0, config)  # numbers are not needed, and take a while to be drawn
    return CompiledImages(NativeImages(geometry, Kernels(library)))
