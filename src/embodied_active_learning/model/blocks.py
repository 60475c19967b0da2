"""Strided convolutions rewritten as stride-one convolutions over parts of an image, the form that CPUs compute quickly.

Part r of an image, of as many as the stride s, is each s-th row from row r on, with s neighbouring pixels side by side
as channels of a block: in memory nothing but rows of pixels. A stride-s convolution is the sum of ordinary ones over
the parts, with kernels of ceil((k - r) / s) x ceil(k / s) blocks; a transposed one yields the parts. Everything here is
exact.

Images are (B, H, W, C) in memory. The wide side of a layer is the one next to the camera's image, the narrow side the
one next to the features, in the encoder as in the decoder.
"""

from __future__ import annotations

from typing import Iterator, List, Optional, Sequence, Tuple

import torch
from torch.nn import functional
from torch.nn.grad import conv2d_weight

Size = Tuple[int, int]


class BlockLayer:
    """A strided convolution from a wide image to a narrow one, its transpose, and the gradients of both.

    Narrow images are kept on a grid (B, rows, columns, O) that ends in zeros where the wide image goes on behind the
    reach of the last kernel. Parts are (B, rows, columns, C) of whole blocks, with a surplus of zeros behind the image.
    Weights are (O, C, k, k) both ways: O channels on the narrow side, C on the wide side.
    """

    def __init__(self, wide: Size, narrow: Size, kernel: int, stride: int) -> None:
        """wide, narrow: (height, width) of the images on both sides."""
        self._wide, self._narrow, self._kernel, self._stride = wide, narrow, kernel, stride
        self._blocks = -(-kernel // stride)
        self._reach = (max(kernel, stride), self._blocks * stride)
        sides = zip(wide, narrow, self._reach)
        self.grid: Size = tuple(few + (many > (few - 1) * stride + reach) for many, few, reach in sides)

    def kernels(self, weight: torch.Tensor) -> List[torch.Tensor]:
        """The weight for each part: (O, s * C, rows, blocks), with zeros outside the kernel."""
        height, width = (reach - self._kernel for reach in self._reach)
        padded = functional.pad(weight, (0, width, 0, height)).unflatten(3, (self._blocks, self._stride))
        cells = padded.permute(0, 4, 1, 2, 3).flatten(1, 2)
        parts = (cells[:, :, row :: self._stride] for row in range(self._stride))
        return [part.contiguous(memory_format=torch.channels_last) for part in parts]

    def contract(
        self, parts: Sequence[torch.Tensor], kernels: Sequence[torch.Tensor], bias: Optional[torch.Tensor] = None
    ) -> torch.Tensor:
        """The convolution of the image with these parts -> (B, *grid, O)."""
        result = functional.conv2d(self._in_blocks(parts[0]), kernels[0], bias)
        for part, kernel in zip(parts[1:], kernels[1:]):
            result += functional.conv2d(self._in_blocks(part), kernel)
        return result.permute(0, 2, 3, 1)

    def expand(
        self, narrow: torch.Tensor, kernels: Sequence[torch.Tensor], bias: Optional[torch.Tensor] = None
    ) -> List[torch.Tensor]:
        """The transposed convolution of (B, *grid, O) -> parts, the bias (C,) included; their surplus is undefined."""
        biases = None if bias is None else bias.repeat(self._stride)
        parts = []
        for kernel in kernels:
            # Transposing turns the kernel round: block b of the result is reached from b blocks before it.
            turned = kernel.transpose(0, 1).flip(2, 3).contiguous(memory_format=torch.channels_last)
            padding = (kernel.shape[2] - 1, kernel.shape[3] - 1)
            blocks = functional.conv2d(narrow.permute(0, 3, 1, 2), turned, biases, padding=padding)
            parts.append(blocks.permute(0, 2, 3, 1).unflatten(3, (self._stride, -1)).flatten(2, 3))
        return parts

    def weight_gradient(self, parts: Sequence[torch.Tensor], narrow: torch.Tensor) -> torch.Tensor:
        """(O, C, k, k) from values on one side and gradients on the other, whichever way the layer was used."""
        channels, features = parts[0].shape[3], narrow.shape[3]
        gradient = narrow.new_empty((features, channels, self._kernel, self._kernel))
        for row, part in enumerate(parts):
            wanted = gradient[:, :, row :: self._stride]
            rows = part.shape[1] - narrow.shape[1] + 1
            shape = (features, self._stride * channels, rows, self._blocks)
            found = conv2d_weight(self._in_blocks(part), shape, narrow.permute(0, 3, 1, 2))
            cells = found.unflatten(1, (self._stride, channels)).permute(0, 2, 3, 4, 1).flatten(3)
            wanted.copy_(cells[:, :, : wanted.shape[2], : self._kernel])
        return gradient

    def split(self, wide: torch.Tensor, dtype: torch.dtype, relu: bool = False) -> List[torch.Tensor]:
        """The parts of a wide image (B, >= H, >= W, C), with negative values set to zero on the way or not."""
        columns = (self.grid[1] - 1 + self._blocks) * self._stride
        rows = (self.grid[0] - 1 - (row - self._reach[0]) // self._stride for row in range(self._stride))
        parts = [wide.new_empty((len(wide), count, columns, wide.shape[3]), dtype=dtype) for count in rows]
        for part, pixels in self.pairs(parts, wide):
            _move(pixels, part, relu)
        self.clear_surplus(parts)
        return parts

    def join(self, parts: Sequence[torch.Tensor], size: Size, relu: bool = False) -> torch.Tensor:
        """The wide image with these parts, continued by zeros to the size (height, width) -> (B, *size, C)."""
        wide = parts[0].new_empty((len(parts[0]), *size, parts[0].shape[3]))
        for part, pixels in self.pairs(parts, wide):
            _move(part, pixels, relu)
        height, width = self._wide
        wide[:, height:].zero_()
        wide[:, :, width:].zero_()
        return wide

    def pairs(self, parts: Sequence[torch.Tensor], wide: torch.Tensor) -> Iterator[Tuple[torch.Tensor, torch.Tensor]]:
        """Each part without its surplus, and the same pixels of the wide image (B, >= H, >= W, C): views."""
        height, width = self._wide
        for row, part in enumerate(parts):
            pixels = wide[:, row : height : self._stride, :width]
            common = part[:, : pixels.shape[1], : pixels.shape[2]]
            yield common, pixels[:, : common.shape[1], : common.shape[2]]

    def clear_surplus(self, parts: Sequence[torch.Tensor]) -> None:
        """Set to zero what lies behind the wide image."""
        height, width = self._wide
        for row, part in enumerate(parts):
            part[:, len(range(row, height, self._stride)) :].zero_()
            part[:, :, width:].zero_()

    def on_grid(self, narrow: torch.Tensor) -> torch.Tensor:
        """(B, O, h, w) -> (B, *grid, O)."""
        grid = narrow.new_zeros((len(narrow), *self.grid, narrow.shape[1]))
        self.off_grid(grid).copy_(narrow)
        return grid

    def off_grid(self, grid: torch.Tensor) -> torch.Tensor:
        """(B, *grid, O) -> (B, O, h, w): a view."""
        height, width = self._narrow
        return grid[:, :height, :width].permute(0, 3, 1, 2)

    def _in_blocks(self, part: torch.Tensor) -> torch.Tensor:
        """(B, rows, columns, C) -> (B, s * C, rows, blocks): a view."""
        return part.unflatten(2, (-1, self._stride)).flatten(3).permute(0, 3, 1, 2)


def _move(source: torch.Tensor, target: torch.Tensor, relu: bool) -> None:
    if relu:
        torch.clamp(source, min=0.0, out=target)
    else:
        target.copy_(source)
