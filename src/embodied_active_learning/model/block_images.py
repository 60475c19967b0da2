"""Image features and reconstruction errors, with their gradients, in torch alone: for machines without a compiler."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, Callable, Iterable, List, Optional, Sequence, Tuple

import torch
from torch import nn
from torch.autograd.function import once_differentiable

from embodied_active_learning.model.blocks import BlockLayer
from embodied_active_learning.model.cvae import ConditionalVAE

Gradients = Tuple[Optional[torch.Tensor], ...]
Parts = List[torch.Tensor]

WHITE = 255.0  # of a byte
CHUNK = 32  # images at a time at most: enough to outweigh torch's own work for each call
PARTS = 2  # of a layer's product for each thread
LARGE = 2**16  # weights of a layer that is worth dividing


class BlockImages:
    """Strided convolutions over blocks of pixels (see blocks), a chunk of images at a time on each thread.

    Each chunk is one thread's work from beginning to end: where torch divides each operation among its threads, all of
    them wait for the last one hundreds of times in an update, and for other processes' work with it. Gradients are
    written out: left to autograd, that of a bias takes as long as that of the weights, and each slice costs two copies.
    """

    def __init__(self, network: ConditionalVAE) -> None:
        """Take over the geometry of the network; its weights are read at each call."""
        convolutions = [layer for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        geometry = zip(network.sizes, network.sizes[1:], convolutions)
        self.layers = [BlockLayer(wide, narrow, part.kernel_size[0], part.stride[0]) for wide, narrow, part in geometry]
        self._threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(self._threads, "blocks", torch.set_num_threads, (1,))

    def features(self, network: ConditionalVAE, images: torch.Tensor) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> features (B, F)."""
        return _Features.apply(self, images, *network.image_encoder.parameters()).flatten(1)

    def weighted_errors(
        self, network: ConditionalVAE, features: torch.Tensor, images: torch.Tensor, weights: torch.Tensor
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """Mean squared error of each image (B,) decoded from its features (B, F): weighted sum, and each."""
        features = features.unflatten(1, network.feature_shape)
        return _WeightedErrors.apply(self, images, features, weights, *network.image_decoder.parameters())

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """layer(inputs), inputs (B, I) -> (B, O)."""
        if layer.weight.numel() < LARGE:
            return layer(inputs)
        return _Linear.apply(self, inputs, layer.weight, layer.bias)

    def share(self, task: Callable[..., Any], *arguments: Iterable) -> List[Any]:
        """[task(*first arguments), task(*second arguments), ...], each by whichever thread is free."""
        return list(self._pool.map(torch.no_grad()(task), *arguments))

    def chunks(self, batch: torch.Tensor) -> Sequence[torch.Tensor]:
        """The batch in chunks of images, one for each thread at least."""
        return batch.split(min(CHUNK, -(-len(batch) // self._threads)))

    def parts(self, count: int) -> List[slice]:
        """range(count) in parts, more than there are threads: when one is held up, the others take over."""
        parts = PARTS * self._threads
        bounds = [count * part // parts for part in range(parts + 1)]
        return [slice(*pair) for pair in zip(bounds, bounds[1:])]


class _Features(torch.autograd.Function):
    """The encoder's convolutions. The parts of each layer's input are kept until the gradients are asked for."""

    @staticmethod
    def forward(ctx: Any, images: BlockImages, pixels: torch.Tensor, *parameters: torch.Tensor) -> torch.Tensor:
        encoder = _Encoder(images.layers, parameters)
        features, ctx.inputs = zip(*images.share(encoder.encode, images.chunks(pixels)))
        ctx.images = images
        ctx.save_for_backward(*parameters)
        return torch.cat(features)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> Gradients:
        encoder = _Encoder(ctx.images.layers, ctx.saved_tensors)
        gradients = ctx.images.share(encoder.differentiate, ctx.images.chunks(upstream), ctx.inputs)
        return (None, None, *map(sum, zip(*gradients)))


class _WeightedErrors(torch.autograd.Function):
    """sum_i w_i e_i, whose gradients are computed along with it, chunk by chunk, and kept until they are asked for."""

    @staticmethod
    def forward(
        ctx: Any,
        images: BlockImages,
        pixels: torch.Tensor,
        features: torch.Tensor,
        weights: torch.Tensor,
        *parameters: torch.Tensor,
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        decoder = _Decoder(images.layers, parameters)
        batches = (images.chunks(batch) for batch in (features, pixels, weights))
        errors, slopes, *gradients = zip(*images.share(decoder.errors, *batches))
        errors = torch.cat(errors)
        ctx.save_for_backward(torch.cat(slopes), errors, *map(sum, gradients))
        ctx.mark_non_differentiable(errors)
        return torch.dot(weights, errors), errors

    @staticmethod
    def backward(ctx: Any, upstream: torch.Tensor, _: torch.Tensor) -> Gradients:
        return (None, None, *(upstream * gradient for gradient in ctx.saved_tensors))


class _Linear(torch.autograd.Function):
    """A large layer, its products divided among the threads."""

    @staticmethod
    def forward(
        ctx: Any, images: BlockImages, inputs: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor
    ) -> torch.Tensor:
        out = inputs.new_empty((len(inputs), len(weight)))
        parts = images.parts(len(weight))
        images.share(lambda part: torch.addmm(bias[part], inputs, weight[part].t(), out=out[:, part]), parts)
        ctx.images = images
        ctx.save_for_backward(inputs, weight)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: torch.Tensor) -> Gradients:
        images, (inputs, weight) = ctx.images, ctx.saved_tensors
        slopes, gradient = torch.empty_like(inputs), torch.empty_like(weight)
        columns, rows = images.parts(inputs.shape[1]), images.parts(len(weight))
        images.share(lambda part: torch.mm(upstream, weight[:, part], out=slopes[:, part]), columns)
        images.share(lambda part: torch.mm(upstream.t()[part], inputs, out=gradient[part]), rows)
        return None, slopes, gradient, upstream.sum(0)


class _Encoder:
    """The convolutions of a chunk of images, with the present weights. Layers are counted from the image."""

    def __init__(self, layers: Sequence[BlockLayer], parameters: Sequence[torch.Tensor]) -> None:
        """parameters: weight and bias of each layer."""
        # The images are bytes; the first weights scale them to [0, 1].
        weights = (parameters[0] / WHITE, *parameters[2::2])
        self._layers = layers
        self._kernels = [layer.kernels(weight) for layer, weight in zip(layers, weights)]
        self._biases = parameters[1::2]

    def encode(self, pixels: torch.Tensor) -> Tuple[torch.Tensor, List[Parts]]:
        """Images (B, H, W, 3) uint8 -> features (B, C, h, w), and each layer's input."""
        inputs: List[Parts] = []
        values = pixels
        for layer, kernels, bias in zip(self._layers, self._kernels, self._biases):
            inputs.append(layer.split(values, bias.dtype, relu=bool(inputs)))
            values = layer.contract(inputs[-1], kernels, bias)
        return self._layers[-1].off_grid(values), inputs

    def differentiate(self, slopes: torch.Tensor, inputs: Sequence[Parts]) -> List[torch.Tensor]:
        """From d / d features (B, C, h, w) and the layers' inputs: the gradients of the parameters."""
        gradients: List[torch.Tensor] = []
        slope = self._layers[-1].on_grid(slopes)
        for index in reversed(range(len(self._layers))):
            layer, parts = self._layers[index], inputs[index]
            gradients[:0] = layer.weight_gradient(parts, slope), _sum_over_pixels(slope)
            if index:
                wide = layer.expand(slope, self._kernels[index])
                masked = [part.mul_(value.sign()) for part, value in zip(wide, parts)]
                slope = layer.join(masked, self._layers[index - 1].grid)
        gradients[0] /= WHITE
        return gradients


class _Decoder:
    """The transposed convolutions of a chunk of images, with the present weights. Layers are counted from the features.

    layers: of the encoder, from the image; parameters: weight and bias of each layer, from the features.
    """

    def __init__(self, layers: Sequence[BlockLayer], parameters: Sequence[torch.Tensor]) -> None:
        self._layers = layers[::-1]
        self._kernels = [layer.kernels(weight) for layer, weight in zip(self._layers, parameters[::2])]
        self._biases = parameters[1::2]

    def errors(self, features: torch.Tensor, pixels: torch.Tensor, weights: torch.Tensor) -> List[torch.Tensor]:
        """Mean squared errors e (B,) of the images decoded from features (B, C, h, w), and gradients of sum w e.

        The gradients are those of the features and of the parameters.
        """
        inputs, parts = self._decode(features)
        errors = self._compare(parts, pixels, weights)
        return [errors, *self._differentiate(inputs, parts)]

    def _decode(self, features: torch.Tensor) -> Tuple[List[torch.Tensor], Parts]:
        """-> the input of each layer, on its grid, and the parts of the image."""
        inputs = [self._layers[0].on_grid(features)]
        parts = self._layers[0].expand(inputs[0], self._kernels[0], self._biases[0])
        for index in range(1, len(self._layers)):
            layer, before = self._layers[index], self._layers[index - 1]
            inputs.append(before.join(parts, layer.grid, relu=True))
            parts = layer.expand(inputs[-1], self._kernels[index], self._biases[index])
        return inputs, parts

    def _compare(self, parts: Parts, pixels: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Mean squared error of decoded parts; they are overwritten with their gradients."""
        image, count = self._layers[-1], pixels[0].numel()
        for part, wanted in image.pairs(parts, pixels):
            part.sub_(wanted, alpha=1.0 / WHITE)
        image.clear_surplus(parts)
        errors = sum(torch.linalg.vector_norm(part.flatten(1), dim=1).square() for part in parts) / count
        for part in parts:
            part.mul_((2.0 / count * weights)[:, None, None, None])
        return errors

    def _differentiate(self, inputs: Sequence[torch.Tensor], slopes: Parts) -> List[torch.Tensor]:
        """From the layers' inputs and the gradients of the image's parts: those of features and parameters."""
        gradients: List[torch.Tensor] = []
        for index in reversed(range(len(self._layers))):
            layer, values = self._layers[index], inputs[index]
            bias = sum(_sum_over_pixels(part) for part in slopes)
            gradients[:0] = layer.weight_gradient(slopes, values), bias
            slope = layer.contract(slopes, self._kernels[index])
            if index:
                slopes = self._layers[index - 1].split(slope.mul_(values.sign_()), slope.dtype)
        return [layer.off_grid(slope), *gradients]


def _sum_over_pixels(values: torch.Tensor) -> torch.Tensor:
    """(B, rows, columns, C) -> (C,), rows first: torch sums long rows much faster than a few channels."""
    return values.sum((0, 1)).sum(0)
