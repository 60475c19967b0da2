"""Strided convolutions rewritten as stride-one convolutions over blocks of pixels, the form that CPUs compute quickly.

A stride-s convolution reads s x s blocks; with each block's pixels moved into the channels (space to depth) it becomes
an ordinary convolution with a kernel of ceil(k / s) blocks. A transposed one writes blocks (depth to space). The
weights are re-indexed within the graph, so gradients arrive at the network's own parameters. Everything here is exact.

Images are (B, H, W, C) in memory. Blocks are (B, rows, columns, s * s * C), ordered (dy, dx, channel).
"""

from __future__ import annotations

from typing import NamedTuple, Optional, Sequence, Tuple

import torch
from torch import nn
from torch.nn import functional

Size = Tuple[int, int]


class Kernel(NamedTuple):
    """Weight (O, C, k', k') and bias (O,) of a stride-one convolution over blocks."""

    weight: torch.Tensor
    bias: torch.Tensor


def space_to_depth(images: torch.Tensor, stride: int) -> torch.Tensor:
    """(B, rows * s, columns * s, C) -> (B, rows, columns, s * s * C)."""
    batch, height, width, channels = images.shape
    cells = images.reshape(batch, height // stride, stride, width // stride, stride * channels)
    # Row by row of the block: a transpose does the same, but takes three times as long on bytes.
    return torch.cat(cells.unbind(2), dim=-1)


def depth_to_space(blocks: torch.Tensor, stride: int) -> torch.Tensor:
    """(B, rows, columns, s * s * C) -> (B, rows * s, columns * s, C)."""
    batch, rows, columns, depth = blocks.shape
    cells = blocks.reshape(batch, rows, columns, stride, stride, depth // (stride * stride))
    return cells.transpose(2, 3).reshape(batch, rows * stride, columns * stride, -1)


def convolution_kernel(layer: nn.Conv2d) -> Kernel:
    """The layer's weight (O, C, k, k) over blocks: (O, s * s * C, k', k') with zeros where k' * s exceeds k."""
    kernel, stride = layer.kernel_size[0], layer.stride[0]
    blocks = -(-kernel // stride)
    padded = functional.pad(layer.weight, (0, blocks * stride - kernel) * 2)
    cells = padded.unflatten(3, (blocks, stride)).unflatten(2, (blocks, stride))  # (O, C, by, dy, bx, dx)
    weight = cells.permute(0, 3, 5, 1, 2, 4).flatten(1, 3)
    return Kernel(weight.contiguous(memory_format=torch.channels_last), layer.bias)


def transposed_kernel(layer: nn.ConvTranspose2d) -> Kernel:
    """The layer's weight (C, O, k, k) as an ordinary convolution that yields blocks: (s * s * O, C, k', k')."""
    kernel, stride = layer.kernel_size[0], layer.stride[0]
    blocks = _transposed_blocks(layer)
    padded = functional.pad(layer.weight, (0, blocks * stride - kernel) * 2)
    cells = padded.unflatten(3, (blocks, stride)).unflatten(2, (blocks, stride))  # (C, O, by, dy, bx, dx)
    # Transposing turns the kernel round: block b of the output is reached from b blocks before it.
    weight = cells.permute(3, 5, 1, 0, 2, 4).flatten(0, 2).flip(2, 3)
    return Kernel(weight.contiguous(memory_format=torch.channels_last), layer.bias.repeat(stride * stride))


def _transposed_blocks(layer: nn.ConvTranspose2d) -> int:
    reach = layer.kernel_size[0] + max(layer.output_padding)
    return -(-reach // layer.stride[0])


class BlockEncoder:
    """The image encoder's convolutions over blocks.

    Each stage computes as many rows as fill the next one's blocks; the surplus meets weights that are zero.
    """

    def __init__(self, layers: Sequence[nn.Conv2d], output_size: Size) -> None:
        self._strides = [layer.stride[0] for layer in layers]
        size = output_size
        for layer in reversed(layers):
            reach = -(-layer.kernel_size[0] // layer.stride[0]) - 1
            size = tuple((length + reach) * layer.stride[0] for length in size)
        self._input_size: Size = size

    def __call__(self, images: torch.Tensor, kernels: Sequence[Kernel]) -> torch.Tensor:
        """Images (B, H, W, 3) uint8 -> (B, C, rows, columns) before the flattening."""
        height, width = (wanted - given for wanted, given in zip(self._input_size, images.shape[1:3]))
        pixels = functional.pad(images, (0, 0, 0, width, 0, height))
        values = space_to_depth(pixels, self._strides[0]).to(kernels[0].weight.dtype).div_(255.0)
        for kernel, stride in zip(kernels, self._strides[1:]):
            values = functional.relu_(functional.conv2d(values.permute(0, 3, 1, 2), *kernel))
            values = space_to_depth(values.permute(0, 2, 3, 1), stride)
        return functional.conv2d(values.permute(0, 3, 1, 2), *kernels[-1])


class BlockDecoder:
    """The image decoder's transposed convolutions over blocks; the last stage's result stays in blocks."""

    def __init__(self, layers: Sequence[nn.ConvTranspose2d], sizes: Sequence[Size]) -> None:
        """Take over the geometry. sizes: (height, width) of each stage's input, and of the image."""
        self._sizes = list(sizes)
        self._strides = [layer.stride[0] for layer in layers]
        self._paddings = [_transposed_blocks(layer) - 1 for layer in layers]
        self._inside = self._mask()

    def __call__(self, features: torch.Tensor, kernels: Sequence[Kernel]) -> torch.Tensor:
        """Features (B, C, rows, columns) -> image in blocks (B, rows', columns', s * s * 3), rows' * s >= H."""
        values = features
        for index, kernel in enumerate(kernels):
            if index:
                height, width = self._sizes[index]
                spread = depth_to_space(values, self._strides[index - 1])[:, :height, :width]
                values = functional.relu(spread).permute(0, 3, 1, 2)
            values = functional.conv2d(values, *kernel, padding=self._paddings[index]).permute(0, 2, 3, 1)
        return values

    def compare(
        self, decoded: torch.Tensor, images: torch.Tensor, weights: torch.Tensor
    ) -> Tuple[torch.Tensor, torch.Tensor]:
        """Mean squared error e (B,) of decoded blocks against images (B, H, W, 3) uint8, and d(sum w e)/d decoded."""
        count = images[0].numel()
        residual = decoded - self._blocks_of(images).to(decoded.dtype).div_(255.0)
        if self._inside is not None:
            residual *= self._inside.to(residual.dtype)
        flat = residual.flatten(1)
        errors = torch.linalg.vecdot(flat, flat) / count
        return errors, residual.mul_((2.0 / count * weights)[:, None, None, None])

    def _blocks_of(self, images: torch.Tensor) -> torch.Tensor:
        """Images in the layout of the result, filled up with zeros; same type."""
        stride, padding = self._strides[-1], self._paddings[-1]
        whole = [(length + padding) * stride for length in self._sizes[-2]]
        height, width = (wanted - given for wanted, given in zip(whole, self._sizes[-1]))
        return space_to_depth(functional.pad(images, (0, 0, 0, width, 0, height)), stride)

    def _mask(self) -> Optional[torch.Tensor]:
        """(1, rows, columns, s * s * 3) of what lies inside the image, or None if everything does."""
        inside = self._blocks_of(torch.ones((1, *self._sizes[-1], 3), dtype=torch.uint8))
        return None if bool(inside.all()) else inside
