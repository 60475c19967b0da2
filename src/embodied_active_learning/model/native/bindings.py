"""Typed calls into the compiled kernels.

The kernels process a group of `lanes` images at once and store their feature maps as (C, H, W, lanes) float32. A layer
lies between an outer feature map (nearer the image) and an inner one (nearer the latents).
"""

from __future__ import annotations

import ctypes
from itertools import accumulate
from typing import Any, Dict, Iterable, List, NamedTuple, Sequence, Tuple

import torch

from embodied_active_learning.model.loss import Images

Shape = Tuple[int, int, int]


class ConvLayer(NamedTuple):
    """Geometry of a convolution: (channels, rows, columns) of its outer and inner feature maps, kernel and stride."""

    outer: Shape
    inner: Shape
    kernel: int
    stride: int


class PackedLayers(NamedTuple):
    """Layers from the image inwards as the library takes them, and the tensors that they point to."""

    layers: Any
    tensors: List[torch.Tensor]


class FeatureMaps(NamedTuple):
    """Scratch memory for the feature maps of one group: tensors by index, 0 being the image, and as the library's."""

    tensors: Dict[int, torch.Tensor]
    maps: Any


class GroupGradients:
    """Gradients of a list of parameters, computed for each group of images separately and then summed."""

    def __init__(self, parameters: Sequence[torch.Tensor], groups: int) -> None:
        self._shapes = [parameter.shape for parameter in parameters]
        self._sizes = [parameter.numel() for parameter in parameters]
        self._values = torch.empty((groups, sum(self._sizes)))

    def addresses(self, group: int) -> Any:
        """Addresses of one group's gradients."""
        first = self._values[group].data_ptr()
        addresses = accumulate([first, *(4 * size for size in self._sizes[:-1])])
        return (ctypes.c_void_p * len(self._sizes))(*addresses)

    def reduce(self) -> Tuple[List[torch.Tensor], torch.Tensor]:
        """Return the gradients summed over all groups, and the sum of all their elements."""
        total = self._values.sum(0)
        parts = total.split(self._sizes)
        return [part.view(shape) for part, shape in zip(parts, self._shapes)], total.sum()


class Kernels:
    """The library's functions. Tensors are contiguous float32 on the CPU unless stated; calls may raise MemoryError."""

    def __init__(self, library: ctypes.CDLL) -> None:
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self._library = library
        self.lanes: int = library.lanes()
        self.panel_columns: int = library.panel_columns()
        self.fused_layers: int = library.fused_layers()

    def pack(self, layers: Sequence[ConvLayer], parameters: Sequence[torch.Tensor]) -> PackedLayers:
        """Pack weight (inner channels, outer channels, k, k), bias, weight, bias, ... from the image inwards."""
        packed = (_ConvLayer * len(layers))()
        tensors: List[torch.Tensor] = []
        for index, (layer, weight, bias) in enumerate(zip(layers, parameters[::2], parameters[1::2])):
            conv, transpose = weight.detach().permute(1, 2, 3, 0), weight.detach().permute(0, 2, 3, 1)
            parts = conv.contiguous(), transpose.contiguous(), bias
            packed[index] = _ConvLayer(layer.kernel, layer.stride, *(part.data_ptr() for part in parts))
            tensors += parts
        return PackedLayers(packed, tensors)

    def allocate(self, layers: Sequence[ConvLayer], wanted: Iterable[int]) -> FeatureMaps:
        """Allocate the feature maps with these indices, 0 being the image."""
        shapes = [layers[0].outer, *(layer.inner for layer in layers)]
        tensors = {index: torch.empty((*shapes[index], self.lanes)) for index in wanted}
        addresses = (tensors[index].data_ptr() if index in tensors else None for index in range(len(shapes)))
        maps = (_FeatureMap(address, *shape, shape[1], -1) for address, shape in zip(addresses, shapes))
        return FeatureMaps(tensors, (_FeatureMap * len(shapes))(*maps))

    def encoder_forward(self, layers: PackedLayers, images: Images, maps: FeatureMaps, *features: torch.Tensor) -> None:
        """Encode up to `lanes` images. Fills all maps but the image's, and each of features (B, F), any strides."""
        outputs = (_Strided * len(features))(*map(_strided, features))
        arguments = layers.layers, maps.maps, len(layers.layers)
        _check(self._library.encoder_forward(_image_group(images), *arguments, outputs, len(features)))

    def encoder_backward(
        self,
        layers: PackedLayers,
        images: Images,
        maps: FeatureMaps,
        gradient_maps: FeatureMaps,
        feature_gradient: torch.Tensor,
        gradients: Any,
    ) -> None:
        """Compute the gradients of weight, bias, ... from the image inwards.

        Args:
            maps: As filled by encoder_forward for the same images.
            gradient_maps: Scratch memory for the maps from `fused_layers` on.
            feature_gradient: Gradient at the features (B, F), any strides.
            gradients: Addresses of the output.
        """
        arguments = layers.layers, maps.maps, gradient_maps.maps, len(layers.layers)
        group = _image_group(images)
        _check(self._library.encoder_backward(group, *arguments, _strided(feature_gradient), gradients))

    def decoder_forward(self, layers: PackedLayers, features: torch.Tensor, maps: FeatureMaps) -> None:
        """Decode features (B, F), any strides, of up to `lanes` images. Fills all maps, including the image's."""
        arguments = layers.layers, maps.maps, len(layers.layers)
        _check(self._library.decoder_forward(_strided(features), len(features), *arguments, 0))

    def decoder_forward_backward(
        self,
        layers: PackedLayers,
        features: torch.Tensor,
        images: Images,
        scales: torch.Tensor,
        scratch: Tuple[FeatureMaps, FeatureMaps],
        feature_gradient: torch.Tensor,
        squared_errors: torch.Tensor,
        gradients: Any,
    ) -> None:
        """Decode features, compare with images, and compute the gradients of sum_i scales_i / 2 squared_errors_i.

        Args:
            features: (B, F), any strides, of up to `lanes` images.
            scales: (B,) weight of each image's error.
            scratch: Maps from `fused_layers` on, for activations and for gradients.
            feature_gradient: Output (B, F), any strides.
            squared_errors: Output (B,), summed over pixels and channels.
            gradients: Addresses of the output: weight, bias, ... from the image inwards.
        """
        maps, gradient_maps = scratch
        target = _image_group(images), scales.data_ptr()
        arguments = layers.layers, maps.maps, gradient_maps.maps, len(layers.layers)
        outputs = _strided(feature_gradient), squared_errors.data_ptr(), gradients
        _check(self._library.decoder_forward_backward(_strided(features), *target, *arguments, *outputs))

    def matmul(self, left: torch.Tensor, right: torch.Tensor, out: torch.Tensor) -> None:
        """Compute out (M, N) = left (M, K) right (K, N).

        left has any strides; rows of right and out are contiguous, and N is at least `panel_columns`.
        """
        rows, columns = out.shape
        others = right.data_ptr(), right.stride(0), out.data_ptr(), out.stride(0)
        self._library.matmul(left.data_ptr(), *left.stride(), *others, rows, len(right), columns)


class _FeatureMap(ctypes.Structure):
    _fields_ = (
        ("values", ctypes.c_void_p),
        ("channels", ctypes.c_int),
        ("rows", ctypes.c_int),
        ("columns", ctypes.c_int),
        ("stored_rows", ctypes.c_int),
        ("row_mask", ctypes.c_int),
    )


class _ConvLayer(ctypes.Structure):
    _fields_ = (
        ("kernel", ctypes.c_int),
        ("stride", ctypes.c_int),
        ("conv_weight", ctypes.c_void_p),
        ("conv_transpose_weight", ctypes.c_void_p),
        ("bias", ctypes.c_void_p),
    )


class _ImageGroup(ctypes.Structure):
    _fields_ = (
        ("images", ctypes.POINTER(ctypes.c_void_p)),
        ("count", ctypes.c_int),
        ("rows", ctypes.c_int),
        ("columns", ctypes.c_int),
        ("channels", ctypes.c_int),
    )


class _Strided(ctypes.Structure):
    _fields_ = (("first", ctypes.c_void_p), ("image_stride", ctypes.c_long), ("stride", ctypes.c_long))


_INT, _LONG, _POINTER = ctypes.c_int, ctypes.c_long, ctypes.c_void_p
_POINTERS = ctypes.POINTER(ctypes.c_void_p)
_MAP, _LAYER, _GROUP, _STRIDED = map(ctypes.POINTER, (_FeatureMap, _ConvLayer, _ImageGroup, _Strided))
_SIGNATURES: Dict[str, Tuple[Any, List[Any]]] = {
    "lanes": (_INT, []),
    "panel_columns": (_INT, []),
    "fused_layers": (_INT, []),
    "encoder_forward": (_INT, [_GROUP, _LAYER, _MAP, _INT, _STRIDED, _INT]),
    "encoder_backward": (_INT, [_GROUP, _LAYER, _MAP, _MAP, _INT, _STRIDED, _POINTERS]),
    "decoder_forward": (_INT, [_STRIDED, _INT, _LAYER, _MAP, _INT, _INT]),
    "decoder_forward_backward": (
        _INT,
        [_STRIDED, _GROUP, _POINTER, _LAYER, _MAP, _MAP, _INT, _STRIDED, _POINTER, _POINTERS],
    ),
    "matmul": (None, [_POINTER, _LONG, _LONG, _POINTER, _LONG, _POINTER, _LONG, _INT, _INT, _INT]),
}


def _image_group(images: Images) -> _ImageGroup:
    """Up to `lanes` images (H, W, C) uint8, each contiguous, at any address."""
    if not images[0].is_contiguous():
        raise ValueError("the compiled kernels need contiguous images: call contiguous() on each")
    addresses = [image.data_ptr() for image in images]
    return _ImageGroup((ctypes.c_void_p * len(addresses))(*addresses), len(addresses), *images[0].shape)


def _strided(rows: torch.Tensor) -> _Strided:
    """Rows (B, F), any strides."""
    return _Strided(rows.data_ptr(), *rows.stride())


def _check(status: int) -> None:
    if status:
        raise MemoryError("compiled kernels: out of memory for scratch buffers; reduce training/batch_size")
