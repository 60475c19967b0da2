"""The network's convolutions and matrix products on the compiled kernels, distributed over threads."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import Callable, DefaultDict, Iterable, List, NamedTuple, Sequence, Tuple

import torch
from torch import nn

from embodied_active_learning.model.cvae import IMAGE_CHANNELS, ConditionalVAE
from embodied_active_learning.model.loss import Images
from embodied_active_learning.model.native.bindings import (
    ConvLayer,
    FeatureMaps,
    GroupGradients,
    Kernels,
    PackedLayers,
)

FactorPair = Tuple[torch.Tensor, torch.Tensor]
Product = Tuple[torch.Tensor, torch.Tensor, torch.Tensor]
Job = Callable[[], None]

PARTS = 2  # per thread and matrix product, so that others can take over from a thread that is delayed
SMALL = 1 << 24  # multiply-adds below which one thread is done before a second one has started


class SavedTensors(NamedTuple):
    """What the encoder's backward pass needs from its forward pass; maps: borrowed, one per group."""

    images: Images
    parameters: List[torch.Tensor]
    layers: PackedLayers
    maps: List[FeatureMaps]


class EncoderGradients(NamedTuple):
    """Gradients of the encoder's weights and biases, the products computed meanwhile, and the sum of all elements."""

    gradients: List[torch.Tensor]
    products: List[torch.Tensor]
    sum: torch.Tensor


class Reconstruction(NamedTuple):
    """Mean squared error (B,) of each decoded image, and the decoder's gradients by group."""

    errors: torch.Tensor
    group_gradients: GroupGradients

    def gradients(self) -> Tuple[List[torch.Tensor], torch.Tensor]:
        """Return the gradients of the decoder's weights and biases in their order, and the sum of all elements."""
        gradients, total = self.group_gradients.reduce()
        return _reverse_layers(gradients), total


class NativeConvolutions:
    """Image encoder, image decoder and linear layers of networks of one geometry; weights are read at each call."""

    def __init__(self, network: ConditionalVAE, kernels: Kernels) -> None:
        self.kernels = kernels
        self.threads = torch.get_num_threads()
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1), thread_name_prefix="kernels")
        convs = [layer for layer in network.image_encoder if isinstance(layer, nn.Conv2d)]
        shapes = [(IMAGE_CHANNELS, *network.sizes[0])]
        shapes += [(conv.out_channels, *size) for conv, size in zip(convs, network.sizes[1:])]
        geometry = zip(shapes, shapes[1:], convs)
        self.layers = [ConvLayer(outer, inner, conv.kernel_size[0], conv.stride[0]) for outer, inner, conv in geometry]
        self._inner_maps = range(1, len(self.layers) + 1)
        self._deep_maps = range(min(kernels.fused_layers, len(self.layers)), len(self.layers) + 1)
        self._spare: DefaultDict[range, List[FeatureMaps]] = defaultdict(list)

    def encoder_forward(
        self, network: ConditionalVAE, images: Images, rows: torch.Tensor, columns: torch.Tensor
    ) -> SavedTensors:
        """Encode B images into rows (B, F) and columns (F, B).

        Pass the result to encoder_backward exactly once; the images must not change until then.
        """
        parameters, layers = list(network.image_encoder.parameters()), self._encoder_layers(network)
        maps = [self._acquire_scratch(self._inner_maps) for _ in range(self._groups(len(images)))]

        def encode(group: int, members: slice) -> None:
            outputs = rows[members], columns.t()[members]
            self.kernels.encoder_forward(layers, images[members], maps[group], *outputs)

        self._run(self._for_groups(len(images), encode))
        return SavedTensors(images, parameters, layers, maps)

    def encoder_backward(
        self, saved: SavedTensors, gradient: torch.Tensor, pairs: Sequence[FactorPair] = (), extra: Sequence[Job] = ()
    ) -> EncoderGradients:
        """Return the gradients of the encoder's weights and biases from the gradient (B, F) at the features.

        Args:
            pairs: Factors of further matrix products; in small pieces, they keep all threads busy until the end.
            extra: Further work, done by whichever thread is free.
        """
        group_gradients = GroupGradients(saved.parameters, len(saved.maps))
        products, tasks = self._split_products(pairs)
        sums = [torch.zeros(())] * len(tasks)

        def backward(group: int, members: slice) -> None:
            maps, scratch = saved.maps[group], self._acquire_scratch(self._deep_maps)
            arguments = saved.images[members], maps, scratch, gradient[members], group_gradients.addresses(group)
            self.kernels.encoder_backward(saved.layers, *arguments)
            self._release_scratch(scratch, self._deep_maps)
            self._release_scratch(maps, self._inner_maps)

        def multiply(index: int) -> None:
            left, right, out = tasks[index]
            self._multiply(left, right, out)
            sums[index] = out.sum()  # here, while it is in the cache

        multiplications = [partial(multiply, index) for index in range(len(tasks))]
        self._run([*self._for_groups(len(saved.images), backward), *multiplications, *extra])
        gradients, total = group_gradients.reduce()
        return EncoderGradients(gradients, products, total + sum(sums))

    def reconstruct(
        self,
        network: ConditionalVAE,
        features: torch.Tensor,
        images: Images,
        weights: torch.Tensor,
        feature_gradient: torch.Tensor,
        extra: Sequence[Job] = (),
    ) -> Reconstruction:
        """Decode features, compare with images, and compute the gradients of sum_i weights_i errors_i.

        Args:
            features: (F, B).
            weights: (B,) weight of each image's mean squared error.
            feature_gradient: Output (F, B).
            extra: Further work, done by whichever thread is free.
        """
        pixels, parameters = images[0].numel(), _reverse_layers(network.image_decoder.parameters())
        layers, scales, errors = self._decoder_layers(network), weights * (2.0 / pixels), torch.empty(len(images))
        gradients = GroupGradients(parameters, self._groups(len(images)))

        def reconstruct(group: int, members: slice) -> None:
            scratch = self._acquire_scratch(self._deep_maps), self._acquire_scratch(self._deep_maps)
            outputs = feature_gradient.t()[members], errors[members], gradients.addresses(group)
            inputs = features.t()[members], images[members], scales[members]
            self.kernels.decoder_forward_backward(layers, *inputs, scratch, *outputs)
            for maps in scratch:
                self._release_scratch(maps, self._deep_maps)

        self._run([*self._for_groups(len(images), reconstruct), *extra])
        return Reconstruction(errors / pixels, gradients)

    def encode(self, network: ConditionalVAE, images: Images) -> torch.Tensor:
        """Return features (B, F) of B images (H, W, 3) uint8, without a backward pass."""
        layers, features = self._encoder_layers(network), torch.empty((len(images), network.feature_size))

        def encode(_: int, members: slice) -> None:
            maps = self._acquire_scratch(self._inner_maps)
            self.kernels.encoder_forward(layers, images[members], maps, features[members])
            self._release_scratch(maps, self._inner_maps)

        self._run(self._for_groups(len(images), encode))
        return features

    def decode(self, network: ConditionalVAE, features: torch.Tensor) -> torch.Tensor:
        """Return images (B, H, W, 3) decoded from features (B, F), without a backward pass."""
        layers, all_maps = self._decoder_layers(network), range(len(self.layers) + 1)
        channels, *size = self.layers[0].outer
        images = torch.empty((len(features), *size, channels))

        def decode(_: int, members: slice) -> None:
            maps = self._acquire_scratch(all_maps)
            self.kernels.decoder_forward(layers, features[members], maps)
            decoded = images[members].numpy()
            decoded[:] = maps.tensors[0].numpy().transpose(3, 1, 2, 0)[: len(decoded)]
            self._release_scratch(maps, all_maps)

        self._run(self._for_groups(len(features), decode))
        return images

    def linear(self, layer: nn.Linear, inputs: torch.Tensor) -> torch.Tensor:
        """Return layer(inputs): (B, I) -> (B, O)."""
        return self.matmul(layer.weight, inputs.t().contiguous()).add_(layer.bias[:, None]).t()

    def matmul(self, left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        """Return left (M, K), any strides, times right (K, N), contiguous, computed by all threads."""
        (product,), tasks = self._split_products([(left, right)])
        self._run([partial(self._multiply, *task) for task in tasks])
        return product

    def _encoder_layers(self, network: ConditionalVAE) -> PackedLayers:
        return self.kernels.pack(self.layers, list(network.image_encoder.parameters()))

    def _decoder_layers(self, network: ConditionalVAE) -> PackedLayers:
        return self.kernels.pack(self.layers, _reverse_layers(network.image_decoder.parameters()))

    def _acquire_scratch(self, indices: range) -> FeatureMaps:
        """Scratch memory for one group; reused, because page faults cost more than the arithmetic."""
        try:
            return self._spare[indices].pop()
        except IndexError:
            return self.kernels.allocate(self.layers, indices)

    def _release_scratch(self, maps: FeatureMaps, indices: range) -> None:
        self._spare[indices].append(maps)

    def _split_products(self, pairs: Sequence[FactorPair]) -> Tuple[List[torch.Tensor], List[Product]]:
        """Return the memory of each pair's product, and the parts to compute: (left, right, out)."""
        products: List[torch.Tensor] = []
        tasks: List[Product] = []
        for left, right in pairs:
            (rows, _), columns = left.shape, right.shape[1]
            out = left.new_empty((rows, columns))
            products.append(out)
            if left.numel() * columns <= SMALL:
                tasks.append((left, right, out))
            elif rows > columns:
                tasks += [(left[part], right, out[part]) for part in self._parts(rows)]
            else:
                tasks += [(left, right[:, part], out[:, part]) for part in self._parts(columns)]
        return products, tasks

    def _multiply(self, left: torch.Tensor, right: torch.Tensor, out: torch.Tensor) -> None:
        """Multiply on the kernels, which are faster than torch on some processors.

        Narrow products are padded: torch's rounding depends on the thread that computes them, so that a run would not
        be reproducible.
        """
        columns, panel = out.shape[1], self.kernels.panel_columns
        if columns >= panel:
            self.kernels.matmul(left, right, out)
            return
        padded = nn.functional.pad(right, (0, panel - columns))
        product = out.new_empty((len(out), panel))
        self.kernels.matmul(left, padded, product)
        out.copy_(product[:, :columns])

    def _groups(self, count: int) -> int:
        """Return the number of groups that hold `count` images."""
        return -(-count // self.kernels.lanes)

    def _parts(self, count: int) -> List[slice]:
        """Split range(count) into parts of whole panels, except the last."""
        panel = self.kernels.panel_columns
        parts = max(1, min(PARTS * self.threads, count // panel))
        bounds = [count * part // parts // panel * panel for part in range(parts)] + [count]
        return [slice(*pair) for pair in zip(bounds, bounds[1:])]

    def _for_groups(self, count: int, task: Callable[[int, slice], None]) -> List[Job]:
        """Return a job task(group, slice of its images) for each group of `count` images."""
        lanes = self.kernels.lanes
        slices = [slice(first, first + lanes) for first in range(0, count, lanes)]
        return [partial(task, group, members) for group, members in enumerate(slices)]

    def _run(self, jobs: Sequence[Job]) -> None:
        """Run all jobs, each on whichever thread is free, the calling one included."""
        remaining, inference = iter(jobs), torch.is_inference_mode_enabled()

        def work() -> None:
            with torch.inference_mode(inference), torch.no_grad():  # both are settings of the thread
                for job in remaining:
                    job()

        helpers = [self._pool.submit(work) for _ in range(min(len(jobs), self.threads) - 1)]
        try:
            work()
        finally:
            wait(helpers)
        for helper in helpers:
            helper.result()


def _reverse_layers(parameters: Iterable[torch.Tensor]) -> List[torch.Tensor]:
    """Reverse the order of layers: weight, bias, weight, bias, ... of a decoder from the image inwards, or back."""
    listed = list(parameters)
    return [part for pair in zip(listed[-2::-2], listed[::-2]) for part in pair]
