"""Image features and reconstruction errors, with their gradients, in torch alone: for machines without a compiler."""

from __future__ import annotations

from typing import Any, List, Optional, Sequence, Tuple

import torch
from torch import nn
from torch.autograd.function import once_differentiable

from embodied_active_learning.model.blocks import BlockLayer
from embodied_active_learning.model.cvae import ConditionalVAE

Gradients = Tuple[Optional[torch.Tensor], ...]

WHITE = 255.0  # of a byte
CHUNK = 16  # images at a time: little enough to stay in the cache and to be allocated from memory at hand


class BlockImages:
    """Strided convolutions over blocks of pixels (see blocks), a chunk of images at a time.

    Gradients are written out rather than left to autograd: bias gradients of torch's convolutions take as long as those
    of their weights, and each of its slices is copied into fresh zeros on the way back.
    """

    def __init__(self, network: ConditionalVAE) -> None:
        """Take over the geometry of the network; its weights are read at each call."""
        convolutions = [layer for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        geometry = zip(network.sizes, network.sizes[1:], convolutions)
        self._layers = [BlockLayer(wide, narrow, part.kernel_size[0], part.stride[0]) for wide, narrow, part in geometry]

    def features(self, network: ConditionalVAE, images: torch.Tensor) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, F)."""
        return _Features.apply(self._layers, images, *network.image_encoder.parameters()).flatten(1)

    def weighted_errors(
        self, network: ConditionalVAE, features: torch.Tensor, images: torch.Tensor, weights: torch.Tensor
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """Mean squared error of each image (B,) decoded from its features (B, F): weighted sum, and each."""
        features = features.unflatten(1, network.feature_shape)
        return _WeightedErrors.apply(self._layers, images, features, weights, *network.image_decoder.parameters())

    @staticmethod
    def linear(layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        return layer(inputs)


class _Features(torch.autograd.Function):
    """The encoder's convolutions. The parts of each layer's input are kept until the gradients are asked for."""

    @staticmethod
    def forward(
        ctx: Any, layers: Sequence[BlockLayer], images: torch.Tensor, *parameters: torch.Tensor
    ) -> torch.Tensor:
        weights, biases = parameters[::2], parameters[1::2]
        # Bytes are scaled to [0, 1] by the first weights.
        kernels = [layer.kernels(weight) for layer, weight in zip(layers, (weights[0] / WHITE, *weights[1:]))]
        inputs, features = [], []
        for values in images.split(CHUNK):
            inputs.append([])
            for layer, kernel, bias in zip(layers, kernels, biases):
                if inputs[-1]:
                    values.relu_()
                parts = layer.split(values, bias.dtype)
                inputs[-1].append(parts)
                values = layer.contract(parts, kernel, bias)
            features.append(layers[-1].off_grid(values))
        ctx.layers, ctx.inputs = layers, inputs
        ctx.save_for_backward(*parameters)
        return torch.cat(features)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> Gradients:
        layers, parameters = ctx.layers, ctx.saved_tensors
        kernels = [layer.kernels(weight) for layer, weight in zip(layers, parameters[::2])]
        gradients = [torch.zeros_like(parameter) for parameter in parameters]
        for slope, inputs in zip(upstream.split(CHUNK), ctx.inputs):
            slope = layers[-1].on_grid(slope)
            for index in reversed(range(len(layers))):
                layer, parts = layers[index], inputs[index]
                gradients[2 * index] += layer.weight_gradient(parts, slope)
                gradients[2 * index + 1] += _sum_over_pixels(slope)
                if index:
                    slopes = layer.expand(slope, kernels[index])
                    masked = [part.mul_(value.sign()) for part, value in zip(slopes, parts)]
                    slope = layer.join(masked, layers[index - 1].grid)
        gradients[0] /= WHITE
        return (None, None, *gradients)


class _WeightedErrors(torch.autograd.Function):
    """sum_i w_i e_i, whose gradients are computed along with it, chunk by chunk, and kept until they are asked for."""

    @staticmethod
    def forward(
        ctx: Any,
        layers: Sequence[BlockLayer],
        images: torch.Tensor,
        features: torch.Tensor,
        weights: torch.Tensor,
        *parameters: torch.Tensor,
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        decoder = _Decoder(layers, parameters)
        parts, errors = [], []
        for image, feature, weight in zip(images.split(CHUNK), features.split(CHUNK), weights.split(CHUNK)):
            inputs, decoded = decoder.decode(feature)
            errors.append(decoder.compare(decoded, image, weight))
            parts.append(decoder.differentiate(inputs, decoded))
        errors = torch.cat(errors)
        ctx.save_for_backward(torch.cat(parts), errors, *decoder.gradients)
        ctx.mark_non_differentiable(errors)
        return torch.dot(weights, errors), errors

    @staticmethod
    def backward(ctx: Any, upstream: torch.Tensor, _: torch.Tensor) -> Gradients:
        return (None, None, *(upstream * gradient for gradient in ctx.saved_tensors))


class _Decoder:
    """The transposed convolutions with their present weights, forth and back; adds up the gradients of the weights.

    Layers are counted from the features outwards.
    """

    def __init__(self, layers: Sequence[BlockLayer], parameters: Sequence[torch.Tensor]) -> None:
        """parameters: weight and bias of each layer, the features' first; layers: the image's first."""
        self._layers = layers[::-1]
        self._kernels = [layer.kernels(weight) for layer, weight in zip(self._layers, parameters[::2])]
        self._biases = parameters[1::2]
        self.gradients = [torch.zeros_like(parameter) for parameter in parameters]

    def decode(self, features: torch.Tensor) -> Tuple[List[torch.Tensor], List[torch.Tensor]]:
        """Features (B, C, h, w) -> the input of each layer, on its grid, and the parts of the image."""
        inputs = [self._layers[0].on_grid(features)]
        for index, layer in enumerate(self._layers):
            parts = layer.expand(inputs[-1], self._kernels[index], self._biases[index])
            if index + 1 < len(self._layers):
                inputs.append(layer.join([part.relu_() for part in parts], self._layers[index + 1].grid))
        return inputs, parts

    def compare(self, parts: Sequence[torch.Tensor], images: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Mean squared error e (B,) of decoded parts against images (B, H, W, 3) uint8.

        The parts are overwritten with d(sum w e) / d parts.
        """
        count = images[0].numel()
        for part, pixels in self._layers[-1].pairs(parts, images):
            part.sub_(pixels, alpha=1.0 / WHITE)
        self._layers[-1].clear_surplus(parts)
        errors = sum(torch.linalg.vector_norm(part.flatten(1), dim=1).square() for part in parts) / count
        for part in parts:
            part *= (2.0 / count * weights)[:, None, None, None]
        return errors

    def differentiate(self, inputs: Sequence[torch.Tensor], slopes: Sequence[torch.Tensor]) -> torch.Tensor:
        """From the inputs of the layers and the slopes of the image's parts: d / d features (B, C, h, w)."""
        for index in reversed(range(len(self._layers))):
            layer, values = self._layers[index], inputs[index]
            self.gradients[2 * index] += layer.weight_gradient(slopes, values)
            self.gradients[2 * index + 1] += sum(_sum_over_pixels(part) for part in slopes)
            slope = layer.contract(slopes, self._kernels[index])
            if index:
                slopes = self._layers[index - 1].split(slope.mul_(values.sign()), slope.dtype)
        return self._layers[0].off_grid(slope)


def _sum_over_pixels(values: torch.Tensor) -> torch.Tensor:
    """(B, rows, columns, C) -> (C,), rows first: torch sums long rows much faster than a few channels."""
    return values.sum((0, 1)).sum(0)
