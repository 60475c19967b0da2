"""Image features and reconstruction errors, with their gradients, in torch alone: for machines without a compiler."""

from __future__ import annotations

from typing import Any, Optional, Tuple

import torch
from torch import nn

from embodied_active_learning.model.blocks import (
    BlockDecoder,
    BlockEncoder,
    Kernel,
    convolution_kernel,
    transposed_kernel,
)
from embodied_active_learning.model.cvae import ConditionalVAE

CHUNK = 16  # images decoded at a time: little enough to stay in the cache and to be allocated from memory at hand


class BlockImages:
    """Strided convolutions over blocks of pixels (see blocks); decoding in chunks."""

    def __init__(self, network: ConditionalVAE) -> None:
        """Take over the geometry of the network; its weights are read at each call."""
        convolutions = [layer for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        transposed = [layer for layer in network.image_decoder if isinstance(layer, nn.ConvTranspose2d)]
        self._encoder = BlockEncoder(convolutions, network.sizes[-1])
        self._decoder = BlockDecoder(transposed, network.sizes[::-1])

    def features(self, network: ConditionalVAE, images: torch.Tensor) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, F)."""
        kernels = [convolution_kernel(layer) for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        return self._encoder(images, kernels).flatten(1)

    def weighted_errors(
        self, network: ConditionalVAE, features: torch.Tensor, images: torch.Tensor, weights: torch.Tensor
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """Mean squared error of each image (B,) decoded from its features (B, F): weighted sum, and each."""
        layers = [layer for layer in network.image_decoder if isinstance(layer, nn.ConvTranspose2d)]
        parameters = [part for layer in layers for part in transposed_kernel(layer)]
        features = features.unflatten(1, network.feature_shape)
        return _WeightedErrors.apply(self._decoder, images, features, weights, *parameters)

    @staticmethod
    def linear(layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        return layer(inputs)


class _WeightedErrors(torch.autograd.Function):
    """sum_i w_i e_i, whose gradients are computed along with it, chunk by chunk, and kept until they are asked for."""

    @staticmethod
    def forward(
        ctx: Any,
        decoder: BlockDecoder,
        images: torch.Tensor,
        features: torch.Tensor,
        weights: torch.Tensor,
        *parameters: torch.Tensor,
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        leaves = [parameter.detach().requires_grad_() for parameter in parameters]
        kernels = [Kernel(*pair) for pair in zip(leaves[::2], leaves[1::2])]
        gradients = [torch.zeros_like(leaf) for leaf in leaves]
        parts, errors = [], []
        for image, feature, weight in zip(images.split(CHUNK), features.split(CHUNK), weights.split(CHUNK)):
            inputs = feature.detach().contiguous(memory_format=torch.channels_last).requires_grad_()
            with torch.enable_grad():
                decoded = decoder(inputs, kernels)
            error, slope = decoder.compare(decoded.detach(), image, weight)
            errors.append(error)
            part, *rest = torch.autograd.grad(decoded, [inputs, *leaves], slope)
            parts.append(part)
            for gradient, increment in zip(gradients, rest):
                gradient.add_(increment)
        errors = torch.cat(errors)
        ctx.save_for_backward(torch.cat(parts), errors, *gradients)
        ctx.mark_non_differentiable(errors)
        return torch.dot(weights, errors), errors

    @staticmethod
    def backward(ctx: Any, upstream: torch.Tensor, _: torch.Tensor) -> Tuple[Optional[torch.Tensor], ...]:
        return (None, None, *(upstream * gradient for gradient in ctx.saved_tensors))
