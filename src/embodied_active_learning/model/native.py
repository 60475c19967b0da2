"""Image features, reconstruction errors and large layers, with gradients, on the compiled kernels."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, Callable, DefaultDict, List, Optional, Tuple

import torch
from torch import nn
from torch.autograd.function import once_differentiable

from embodied_active_learning.model.cvae import IMAGE_CHANNELS, ConditionalVAE
from embodied_active_learning.model.kernels import EndGradients, Kernels, Layer, Weights, pack_weights

Gradients = Tuple[Optional[torch.Tensor], ...]

PARTS = 2  # of a product for each thread: when one of them is held up, the others take over
END = 2  # layers next to the image that are worked off together, a few rows at a time


class NativeImages:
    """Computes what blocks.BlockImages computes, in single precision."""

    def __init__(self, network: ConditionalVAE, kernels: Kernels) -> None:
        """Take over the geometry of the network; its weights are read at each call."""
        self.kernels = kernels
        self.threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1), thread_name_prefix="kernels")
        convolutions = [layer for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        shapes = [(IMAGE_CHANNELS, *network.sizes[0])]
        shapes += [(layer.out_channels, *size) for layer, size in zip(convolutions, network.sizes[1:])]
        geometry = zip(shapes, shapes[1:], convolutions)
        self.layers = [Layer(wide, narrow, part.kernel_size[0], part.stride[0]) for wide, narrow, part in geometry]
        self._shapes = shapes
        self.feature_size = network.feature_size
        self.deep_sides = range(min(END, len(self.layers)), len(self.layers) + 1)
        self._spare: DefaultDict[Tuple[int, range], List[List[torch.Tensor]]] = defaultdict(list)

    def features(self, network: ConditionalVAE, images: torch.Tensor) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, F). They must stay as they are until the gradients are taken."""
        return _Features.apply(self, images.contiguous(), *network.image_encoder.parameters())

    def weighted_errors(
        self, network: ConditionalVAE, features: torch.Tensor, images: torch.Tensor, weights: torch.Tensor
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """Mean squared error of each image (B,) decoded from its features (B, F): weighted sum, and each."""
        parameters = network.image_decoder.parameters()
        return _WeightedErrors.apply(self, features, weights, images.contiguous(), *parameters)

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        if min(inputs.shape) < self.kernels.panel:
            return layer(inputs)
        return _Linear.apply(self, inputs, layer.weight, layer.bias)

    def encode(self, weights: List[Weights], images: torch.Tensor, sides: List[torch.Tensor]) -> None:
        """From one group's images: fill its sides, that behind the first convolution to the innermost, the features."""
        layers, count = self.layers, len(self.layers)
        self.kernels.look(layers[:END], weights[:END], images, sides[:END], relu=count > END)
        for i in range(END, count):
            self.kernels.narrow(layers[i], weights[i], sides[i - 1], sides[i], relu=i + 1 < count)

    def decode(self, weights: List[Weights], sides: List[torch.Tensor]) -> None:
        """From the innermost of one group's sides, the features: fill the others, outwards as far as there are any.

        weights: of the decoder's layers, the image's first.
        """
        nearest = len(self.layers) + 1 - len(sides)
        for i in reversed(range(nearest, len(self.layers))):
            wide, narrow = sides[i - nearest], sides[i - nearest + 1]
            self.kernels.widen(self.layers[i], weights[i], narrow, wide, relu=i > 0)

    def for_each_group(self, count: int, task: Callable[[int, slice], None]) -> None:
        """Call task(group, its images) for the groups of `count` images, on all threads."""
        lanes = self.kernels.lanes
        self._share(-(-count // lanes), lambda group: task(group, slice(group * lanes, (group + 1) * lanes)))

    def for_each_part(self, count: int, task: Callable[[slice], None]) -> None:
        """Call task(part) for parts of range(count), none smaller than a panel, on all threads."""
        parts = max(1, min(PARTS * self.threads, count // self.kernels.panel))
        bounds = [count * part // parts for part in range(parts + 1)]
        self._share(parts, lambda part: task(slice(bounds[part], bounds[part + 1])))

    def _share(self, count: int, task: Callable[[int], None]) -> None:
        """Call task(0), ..., task(count - 1), each by whichever thread is free; the caller is one of them."""
        left = iter(range(count))

        def work() -> None:
            for index in left:
                task(index)

        helping = [self._pool.submit(work) for _ in range(min(count, self.threads) - 1)]
        try:
            work()
        finally:
            wait(helping)
        for helper in helping:
            helper.result()

    def borrow(self, groups: int, sides: range) -> List[torch.Tensor]:
        """Room for the values on some sides of the layers, counted from the image: (groups, C, H, W, lanes) each.

        Given back, it is used again: fresh memory of this size costs more in page faults than the arithmetic.
        """
        try:
            return self._spare[groups, sides].pop()
        except IndexError:
            return [torch.empty((groups, *self._shapes[side], self.kernels.lanes)) for side in sides]

    def give_back(self, buffers: List[torch.Tensor], groups: int, sides: range) -> None:
        """Return what was borrowed."""
        self._spare[groups, sides].append(buffers)


class _Features(torch.autograd.Function):
    """The convolutions; the values between them stay borrowed until the gradients have been taken."""

    @staticmethod
    def forward(ctx: Any, native: NativeImages, images: torch.Tensor, *parameters: torch.Tensor) -> torch.Tensor:
        kernels, layers = native.kernels, native.layers
        weights = pack_weights(parameters)
        groups, sides = -(-len(images) // kernels.lanes), range(1, len(layers) + 1)
        values, features = native.borrow(groups, sides), torch.empty((len(images), native.feature_size))

        def encode(group: int, members: slice) -> None:
            native.encode(weights, images[members], [side[group] for side in values])
            kernels.from_group(values[-1][group], features[members])

        native.for_each_group(len(images), encode)
        ctx.native, ctx.images, ctx.values, ctx.weights = native, images, values, weights
        ctx.shapes = [parameter.shape for parameter in parameters]
        return features

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> Gradients:
        native, values, weights = ctx.native, ctx.values, ctx.weights
        if values is None:
            raise RuntimeError("gradients of image features can be taken once: what they need is given back after that")
        ctx.values = None
        kernels, layers = native.kernels, native.layers
        groups, upstream = len(values[0]), upstream.detach()
        gradients = [torch.empty((groups, *shape)) for shape in ctx.shapes]

        def differentiate(group: int, members: slice) -> None:
            borrowed = native.borrow(1, native.deep_sides)
            parts = [part[group] for part in gradients]
            slopes = borrowed[-1][0]
            kernels.to_group(upstream[members], slopes)
            kernels.bias_gradient(layers[-1].narrow, slopes, parts[-1])
            for i in reversed(range(END, len(layers))):
                inner = values[i - 1][group]
                kernels.weight_gradient(layers[i], slopes, inner, parts[2 * i])
                below = borrowed[i - END][0]
                kernels.widen(layers[i], weights[i].without_bias, slopes, below, gate=inner, totals=parts[2 * i - 1])
                slopes = below
            end = parts[:3] if len(layers) > 1 else parts[:1]
            between = values[0][group] if len(layers) > 1 else None
            kernels.look_back(layers[:END], weights[:END], ctx.images[members], between, slopes, end)
            native.give_back(borrowed, 1, native.deep_sides)

        native.for_each_group(len(upstream), differentiate)
        native.give_back(values, groups, range(1, len(layers) + 1))
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
        kernels, layers, pixels = native.kernels, native.layers, images[0].numel()
        is_gated = len(layers) > END
        packed = pack_weights(parameters)[::-1]
        features, scales = features.detach(), weights.detach()[:, None] * (2.0 / pixels)
        slopes, errors = torch.empty((len(images), native.feature_size)), torch.empty((len(images), 1))
        gradients = [torch.empty((-(-len(images) // kernels.lanes), *parameter.shape)) for parameter in parameters]

        def work(group: int, members: slice) -> None:
            values, flow = native.borrow(1, native.deep_sides), native.borrow(1, native.deep_sides)
            inner, below = [side[0] for side in values], [side[0] for side in flow]
            scale, squares = torch.empty(kernels.lanes), torch.empty(kernels.lanes)
            kernels.to_group(features[members], inner[-1])
            kernels.to_group(scales[members], scale)
            # Weight and bias of each layer, from the image inwards.
            slots = [(weight[group], bias[group]) for weight, bias in zip(gradients[-2::-2], gradients[::-2])]
            totals = slots[END][1] if is_gated else torch.empty(layers[-1].narrow[0])
            found = EndGradients(squares, slots[0], slots[1] if len(slots) > 1 else None, totals)
            native.decode(packed, inner)
            image = images[members], scale
            kernels.reconstruct(layers[:END], packed[:END], inner[0], *image, is_gated, below[0], found)
            _differentiate_decoder(native, packed, inner, below, slots)
            kernels.from_group(below[-1], slopes[members])
            kernels.from_group(squares, errors[members])
            native.give_back(values, 1, native.deep_sides)
            native.give_back(flow, 1, native.deep_sides)

        native.for_each_group(len(images), work)
        errors = errors[:, 0] / pixels
        ctx.save_for_backward(slopes, errors, *(gradient.sum(0) for gradient in gradients))
        ctx.mark_non_differentiable(errors)
        return torch.dot(weights, errors), errors

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor, _: torch.Tensor) -> Gradients:
        slopes, errors, *gradients = (upstream * saved for saved in ctx.saved_tensors)
        return (None, slopes, errors, None, *gradients)


class _Linear(torch.autograd.Function):
    """A layer large enough that the product decides: torch's own is far from this machine's best on some processors."""

    @staticmethod
    def forward(
        ctx: Any, native: NativeImages, inputs: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor
    ) -> torch.Tensor:
        inputs = inputs.contiguous()
        across = inputs.t().contiguous()
        out = torch.empty((len(weight), len(inputs)))
        native.for_each_part(len(weight), lambda part: native.kernels.multiply(weight[part], across, out[part]))
        ctx.native = native
        ctx.save_for_backward(inputs, weight)
        return out.add_(bias[:, None]).t()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> Gradients:
        native, (inputs, weight) = ctx.native, ctx.saved_tensors
        multiply = native.kernels.multiply
        slopes, gradient = torch.empty_like(inputs), torch.empty_like(weight)
        native.for_each_part(inputs.shape[1], lambda part: multiply(upstream, weight[:, part], slopes[:, part]))
        native.for_each_part(len(weight), lambda part: multiply(upstream.t()[part], inputs, gradient[part]))
        return None, slopes, gradient, upstream.sum(0)


def _differentiate_decoder(
    native: NativeImages,
    packed: List[Weights],
    inner: List[torch.Tensor],
    below: List[torch.Tensor],
    slots: List[Tuple[torch.Tensor, torch.Tensor]],
) -> None:
    """From the slopes that the last layers leave to those at the features, with the gradients on the way."""
    kernels, count = native.kernels, len(native.layers)
    for i in range(END, count):
        layer, (wide, narrow) = native.layers[i], below[i - END : i - END + 2]
        values = inner[i - END + 1]
        kernels.weight_gradient(layer, values, wide, slots[i][0])
        gate, totals = (values, slots[i + 1][1]) if i + 1 < count else (None, None)
        kernels.narrow(layer, packed[i].without_bias, wide, narrow, gate=gate, totals=totals)
