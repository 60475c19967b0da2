"""Image features and reconstruction errors, with their gradients, on the compiled kernels and a pool of threads."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Callable, DefaultDict, List, Optional, Tuple

import torch
from torch import nn

from embodied_active_learning.model.cvae import IMAGE_CHANNELS, ConditionalVAE
from embodied_active_learning.model.kernels import Kernels, Layer, Weights, pack_weights

Gradients = Tuple[Optional[torch.Tensor], ...]


class NativeImages:
    """Computes what blocks.BlockImages computes, in single precision."""

    def __init__(self, network: ConditionalVAE, kernels: Kernels) -> None:
        """Take over the geometry of the network; its weights are read at each call."""
        self.kernels = kernels
        self.threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="kernels")
        convolutions = [layer for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        shapes = [(IMAGE_CHANNELS, *network.sizes[0])]
        shapes += [(layer.out_channels, *size) for layer, size in zip(convolutions, network.sizes[1:])]
        geometry = zip(shapes, shapes[1:], convolutions)
        self.layers = [Layer(wide, narrow, part.kernel_size[0], part.stride[0]) for wide, narrow, part in geometry]
        self._shapes = shapes
        self._spare: DefaultDict[int, List[List[torch.Tensor]]] = defaultdict(list)

    def features(self, network: ConditionalVAE, images: torch.Tensor) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, F)."""
        return _Features.apply(self, images.contiguous(), *network.image_encoder.parameters())

    def weighted_errors(
        self, network: ConditionalVAE, features: torch.Tensor, images: torch.Tensor, weights: torch.Tensor
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """Mean squared error of each image (B,) decoded from its features (B, F): weighted sum, and each."""
        parameters = network.image_decoder.parameters()
        return _WeightedErrors.apply(self, features, weights, images.contiguous(), *parameters)

    def for_each_group(self, count: int, task: Callable[[int, slice], None]) -> None:
        """Call task(group, its images) for the groups of `count` images, on all threads."""
        lanes = self.kernels.lanes
        groups = -(-count // lanes)
        list(self._pool.map(lambda group: task(group, slice(group * lanes, (group + 1) * lanes)), range(groups)))

    def borrow(self, groups: int) -> List[torch.Tensor]:
        """Room for the values on all sides of the layers, (groups, C, H, W, lanes) from the image inwards.

        Given back, it is used again: fresh memory of this size costs more in page faults than the arithmetic.
        """
        try:
            return self._spare[groups].pop()
        except IndexError:
            return [torch.empty((groups, *shape, self.kernels.lanes)) for shape in self._shapes]

    def give_back(self, buffers: List[torch.Tensor]) -> None:
        """Return what was borrowed."""
        self._spare[len(buffers[0])].append(buffers)


class _Features(torch.autograd.Function):
    """The convolutions; the values between them stay borrowed until the gradients have been taken."""

    @staticmethod
    def forward(ctx: Any, native: NativeImages, images: torch.Tensor, *parameters: torch.Tensor) -> torch.Tensor:
        kernels, layers = native.kernels, native.layers
        weights = pack_weights(parameters)
        values = native.borrow(-(-len(images) // kernels.lanes))

        def encode(group: int, members: slice) -> None:
            kernels.pack_images(images[members], values[0][group])
            for i, (layer, (packed, _, bias)) in enumerate(zip(layers, weights)):
                kernels.narrow(layer, values[i][group], packed, values[i + 1][group], bias, relu=i + 1 < len(layers))

        native.for_each_group(len(images), encode)
        ctx.native, ctx.values, ctx.weights = native, values, weights
        ctx.shapes = [parameter.shape for parameter in parameters]
        return kernels.from_groups(values[-1], len(images))

    @staticmethod
    def backward(ctx: Any, upstream: torch.Tensor) -> Gradients:
        native, values, weights = ctx.native, ctx.values, ctx.weights
        kernels, layers = native.kernels, native.layers
        last = kernels.to_groups(upstream)
        gradients = [torch.empty((len(last), *shape)) for shape in ctx.shapes]

        def differentiate(group: int, _: slice) -> None:
            borrowed = native.borrow(1)
            slopes = [side[0] for side in borrowed[:-1]] + [last[group]]
            for i in reversed(range(len(layers))):
                kernels.weight_gradient(layers[i], slopes[i + 1], values[i][group], gradients[2 * i][group])
                kernels.bias_gradient(layers[i].narrow, slopes[i + 1], gradients[2 * i + 1][group])
                if i > 0:
                    kernels.widen(layers[i], slopes[i + 1], weights[i].widening, slopes[i], gate=values[i][group])
            native.give_back(borrowed)

        native.for_each_group(len(upstream), differentiate)
        native.give_back(values)
        return (None, None, *(gradient.sum(0) for gradient in gradients))


class _WeightedErrors(torch.autograd.Function):
    """sum_i w_i e_i, whose gradients are computed along with it, group by group, and kept until they are asked for."""

    @staticmethod
    def forward(
        ctx: Any,
        native: NativeImages,
        features: torch.Tensor,
        weights: torch.Tensor,
        images: torch.Tensor,
        *parameters: torch.Tensor,
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        kernels, pixels = native.kernels, images[0].numel()
        packed = pack_weights(parameters)[::-1]
        inputs, scales = kernels.to_groups(features), kernels.to_groups(weights[:, None] * (2.0 / pixels))
        slopes, errors = torch.empty_like(inputs), torch.empty((len(inputs), 1, kernels.lanes))
        gradients = [torch.empty((len(inputs), *parameter.shape)) for parameter in parameters]

        def work(group: int, members: slice) -> None:
            values, below = native.borrow(1), native.borrow(1)
            sides = [side[0] for side in values[:-1]] + [inputs[group]]
            flow = [side[0] for side in below[:-1]] + [slopes[group]]
            parts = [part[group] for part in gradients]
            _decode(native, packed, sides)
            gate = sides[1] if len(sides) > 2 else None
            image = (sides[0], images[members], scales[group], errors[group], [*parts[-2:], flow[1]])
            kernels.reconstruct(native.layers[0], packed[0], sides[1], gate, *image)
            _differentiate_decoder(native, packed, sides, flow, parts)
            native.give_back(values)
            native.give_back(below)

        native.for_each_group(len(images), work)
        errors = kernels.from_groups(errors, len(images))[:, 0] / pixels
        slopes = kernels.from_groups(slopes, len(images))
        ctx.save_for_backward(slopes, errors, *(gradient.sum(0) for gradient in gradients))
        ctx.mark_non_differentiable(errors)
        return torch.dot(weights, errors), errors

    @staticmethod
    def backward(ctx: Any, upstream: torch.Tensor, _: torch.Tensor) -> Gradients:
        slopes, errors, *gradients = (upstream * saved for saved in ctx.saved_tensors)
        return (None, slopes, errors, None, *gradients)


def _decode(native: NativeImages, packed: List[Weights], sides: List[torch.Tensor]) -> None:
    """Fill the sides of one group from the innermost, the features, to the last but one, which the image is made of."""
    for i in reversed(range(1, len(native.layers))):
        native.kernels.widen(native.layers[i], sides[i + 1], packed[i].widening, sides[i], packed[i].bias, relu=True)


def _differentiate_decoder(
    native: NativeImages,
    packed: List[Weights],
    sides: List[torch.Tensor],
    slopes: List[torch.Tensor],
    gradients: List[torch.Tensor],
) -> None:
    """From the slopes behind the image to those at the features, with the gradients of the parameters on the way."""
    kernels, count = native.kernels, len(native.layers)
    for i in range(1, count):
        layer, parameter = native.layers[i], 2 * (count - 1 - i)
        kernels.weight_gradient(layer, sides[i + 1], slopes[i], gradients[parameter])
        kernels.bias_gradient(layer.wide, slopes[i], gradients[parameter + 1])
        gate = sides[i + 1] if i + 1 < count else None
        kernels.narrow(layer, slopes[i], packed[i].narrowing, slopes[i + 1], gate=gate)
