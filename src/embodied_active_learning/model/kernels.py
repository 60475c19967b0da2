"""The compiled kernels as functions of tensors. A group: as many images as a vector has lanes, innermost in memory."""

from __future__ import annotations

import ctypes
from typing import List, NamedTuple, Optional, Sequence, Tuple

import torch
from torch.nn import functional

Shape = Tuple[int, int, int]


class Layer(NamedTuple):
    """A convolution between its wide side (nearer the image) and its narrow one; (channels, rows, columns) of each."""

    wide: Shape
    narrow: Shape
    kernel: int
    stride: int


class Weights(NamedTuple):
    """A weight (narrow channels, wide channels, k, k) packed for going either way, and the bias."""

    narrowing: torch.Tensor
    widening: torch.Tensor
    bias: torch.Tensor


def pack_weights(parameters: Sequence[torch.Tensor]) -> List[Weights]:
    """Weight, bias, weight, bias, ... -> one Weights a layer."""
    pairs = zip(parameters[::2], parameters[1::2])
    return [
        Weights(
            weight.detach().permute(1, 2, 3, 0).contiguous(), weight.detach().permute(0, 2, 3, 1).contiguous(), bias
        )
        for weight, bias in pairs
    ]


class Kernels:
    """Typed calls into the library. All tensors are contiguous float32 on the CPU, values are (C, H, W, lanes)."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        self.lanes: int = library.lanes()

    def to_groups(self, values: torch.Tensor) -> torch.Tensor:
        """(B, F) -> (G, F, lanes), zero beyond B."""
        groups = -(-len(values) // self.lanes)
        padded = functional.pad(values.detach(), (0, 0, 0, groups * self.lanes - len(values)))
        return padded.unflatten(0, (groups, self.lanes)).transpose(1, 2).contiguous()

    def from_groups(self, values: torch.Tensor, count: int) -> torch.Tensor:
        """(G, ..., lanes) -> (count, F)."""
        return values.flatten(1, -2).transpose(1, 2).flatten(0, 1)[:count]

    def narrow(
        self,
        layer: Layer,
        values: torch.Tensor,
        packed: torch.Tensor,
        out: torch.Tensor,
        bias: Optional[torch.Tensor] = None,
        relu: bool = False,
        gate: Optional[torch.Tensor] = None,
    ) -> None:
        """Convolution from the wide side to the narrow one; zero where the gate (as out) is not positive."""
        last = (layer.kernel, layer.stride, packed.data_ptr(), _address(bias), relu, _address(gate))
        self._library.strided(values.data_ptr(), *layer.wide, out.data_ptr(), *layer.narrow, *last)

    def widen(
        self,
        layer: Layer,
        values: torch.Tensor,
        packed: torch.Tensor,
        out: torch.Tensor,
        bias: Optional[torch.Tensor] = None,
        relu: bool = False,
        gate: Optional[torch.Tensor] = None,
    ) -> None:
        """Transposed convolution from the narrow side to the wide one; zero where the gate (as out) is not positive."""
        last = (layer.kernel, layer.stride, packed.data_ptr(), _address(bias), relu, _address(gate))
        self._library.transposed(values.data_ptr(), *layer.narrow, out.data_ptr(), *layer.wide, *last)

    def weight_gradient(self, layer: Layer, narrow: torch.Tensor, wide: torch.Tensor, out: torch.Tensor) -> None:
        """Gradient (narrow channels, wide channels, k, k) of a weight, from the values and slopes on its two sides."""
        sums = torch.empty(out.numel() * self.lanes)
        last = (layer.wide[1], layer.wide[2], layer.kernel, layer.stride, sums.data_ptr(), out.data_ptr())
        self._library.correlate(narrow.data_ptr(), *layer.narrow, wide.data_ptr(), layer.wide[0], *last)

    def bias_gradient(self, shape: Shape, slopes: torch.Tensor, out: torch.Tensor) -> None:
        """Sum (C,) of slopes of this shape over rows, columns and images."""
        self._library.channel_sums(slopes.data_ptr(), *shape, out.data_ptr())

    def pack_images(self, images: torch.Tensor, out: torch.Tensor) -> None:
        """Up to `lanes` images (B, H, W, 3) uint8 -> values in [0, 1]."""
        row = self._row(images)
        self._library.pack(images.data_ptr(), *images.shape, out.data_ptr(), row.data_ptr())

    def reconstruct(
        self,
        layer: Layer,
        weights: Weights,
        values: torch.Tensor,
        gate: Optional[torch.Tensor],
        image: torch.Tensor,
        images: torch.Tensor,
        scales: torch.Tensor,
        errors: torch.Tensor,
        slopes: Sequence[torch.Tensor],
    ) -> None:
        """Widen values to the image, compare it with images (B, H, W, 3) uint8, and take the gradients.

        errors (lanes,): sums of squared differences; slopes: of the sum of scales / 2 times errors, with respect to the
        weight, the bias and the values, the last one zero where the gate is not positive. image: room for the image.
        """
        sums, row = torch.empty(slopes[0].numel() * self.lanes), self._row(images)
        shapes = (values.data_ptr(), *layer.narrow, image.data_ptr(), *layer.wide, layer.kernel, layer.stride)
        packed = (weights.widening.data_ptr(), weights.narrowing.data_ptr(), weights.bias.data_ptr(), _address(gate))
        target = (images.data_ptr(), len(images), scales.data_ptr(), errors.data_ptr())
        results = [part.data_ptr() for part in (*slopes, sums, row)]
        self._library.reconstruct(*shapes, *packed, *target, *results)

    def _row(self, images: torch.Tensor) -> torch.Tensor:
        """Room for one row of a group of images."""
        return torch.empty(images[0, 0].numel() * self.lanes, dtype=torch.uint8)


def _address(tensor: Optional[torch.Tensor]) -> Optional[int]:
    return None if tensor is None else tensor.data_ptr()
