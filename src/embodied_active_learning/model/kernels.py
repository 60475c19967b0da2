"""The compiled kernels as functions of tensors. A group: as many images as a vector has lanes, innermost in memory."""

from __future__ import annotations

import ctypes
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import torch

from embodied_active_learning.model.objective import Images

Shape = Tuple[int, int, int]


class Layer(NamedTuple):
    """A convolution between its wide side (nearer the image) and its narrow one; (channels, rows, columns) of each."""

    wide: Shape
    narrow: Shape
    kernel: int
    stride: int


class Weights(NamedTuple):
    """What Kernels.pack makes of a layer's weights for going either way, and the bias if there is one."""

    narrowing: torch.Tensor
    widening: torch.Tensor
    bias: Optional[torch.Tensor]

    @property
    def without_bias(self) -> Weights:
        """The same for the way back, where slopes go and not values."""
        return self._replace(bias=None)


class EndGradients(NamedTuple):
    """What Kernels.reconstruct leaves behind, beside the slopes.

    errors: (lanes,) sums of squared differences; weight and bias of the last layer and of the one before it, where
    there is one; totals: (channels,) sums of the slopes.
    """

    errors: torch.Tensor
    last: Sequence[torch.Tensor]
    before: Optional[Sequence[torch.Tensor]]
    totals: torch.Tensor


class Kernels:
    """Typed calls into the library. Tensors are contiguous float32 on the CPU, values (C, H, W, lanes), unless said.

    Every call may raise MemoryError.
    """

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        self.lanes: int = library.lanes()
        self.panel: int = library.panel()

    def pack(self, layers: Sequence[Layer], parameters: Sequence[torch.Tensor]) -> List[Weights]:
        """Weight (narrow channels, wide channels, k, k), bias, weight, bias, ... -> one Weights a layer."""
        pairs = zip(layers, parameters[::2], parameters[1::2])
        return [self._pack(layer, weight.detach().contiguous(), bias) for layer, weight, bias in pairs]

    def _pack(self, layer: Layer, weight: torch.Tensor, bias: torch.Tensor) -> Weights:
        narrow, wide, kernel, _ = weight.shape
        columns = layer.narrow[2]
        taps = self._library.packed_taps(kernel, layer.stride, columns)
        made = Weights(*(torch.empty(narrow * wide * taps * taps) for _ in range(2)), bias)
        shape = narrow, wide, kernel, layer.stride, columns
        self._library.pack(weight.data_ptr(), *shape, made.narrowing.data_ptr(), made.widening.data_ptr())
        return made

    def to_group(self, rows: torch.Tensor, out: torch.Tensor) -> None:
        """Rows (B, F), any strides, of at most `lanes` images -> one group (..., lanes), zero beyond B."""
        count, length = rows.shape
        self._library.to_group(rows.data_ptr(), *rows.stride(), count, length, out.data_ptr())

    def from_group(self, values: torch.Tensor, out: torch.Tensor) -> None:
        """One group (..., lanes) -> rows (B, F), any strides, of at most `lanes` images."""
        count, length = out.shape
        self._library.from_group(values.data_ptr(), length, out.data_ptr(), *out.stride(), count)

    def narrow(
        self,
        layer: Layer,
        weights: Weights,
        values: torch.Tensor,
        out: torch.Tensor,
        relu: bool = False,
        gate: Optional[torch.Tensor] = None,
        totals: Optional[torch.Tensor] = None,
    ) -> None:
        """Convolution from the wide side to the narrow one; zero where the gate (as out) is not positive.

        totals: room for the sums (channels,) of what comes out.
        """
        sides = _side(layer.wide, values), _side(layer.narrow, out)
        last = (relu, _optional_side(layer.narrow, gate), _address(totals))
        _check(self._library.narrow(*sides, _layer(layer, weights), *last))

    def widen(
        self,
        layer: Layer,
        weights: Weights,
        values: torch.Tensor,
        out: torch.Tensor,
        relu: bool = False,
        gate: Optional[torch.Tensor] = None,
        totals: Optional[torch.Tensor] = None,
    ) -> None:
        """Transposed convolution from the narrow side to the wide one; otherwise as narrow."""
        sides = _side(layer.narrow, values), _side(layer.wide, out)
        last = (relu, _optional_side(layer.wide, gate), _address(totals))
        _check(self._library.widen(*sides, _layer(layer, weights), *last))

    def weight_gradient(self, layer: Layer, narrow: torch.Tensor, wide: torch.Tensor, out: torch.Tensor) -> None:
        """Gradient (narrow channels, wide channels, k, k) of a weight, from the values and slopes on its two sides."""
        sides = _side(layer.narrow, narrow), _side(layer.wide, wide)
        _check(self._library.correlate(*sides, _layer(layer), out.data_ptr()))

    def bias_gradient(self, shape: Shape, slopes: torch.Tensor, out: torch.Tensor) -> None:
        """Sum (C,) of slopes of this shape over rows, columns and images."""
        self._library.channel_sums(_side(shape, slopes), out.data_ptr())

    def look(
        self,
        layers: Sequence[Layer],
        weights: Sequence[Weights],
        images: Images,
        values: Sequence[torch.Tensor],
        relu: bool,
    ) -> None:
        """The convolutions next to the image, one or two, from up to `lanes` images.

        values: room for what is behind each of them; relu: whether the last one has it.
        """
        second = _layer(layers[1], weights[1]) if len(layers) > 1 else _layer()
        sides = _side(layers[0].narrow, values[0]), _side(layers[-1].narrow, values[-1])
        _check(self._library.look(_pictures(images), _layer(layers[0], weights[0]), second, *sides, relu))

    def look_back(
        self,
        layers: Sequence[Layer],
        weights: Sequence[Weights],
        images: Images,
        values: Optional[torch.Tensor],
        slopes: torch.Tensor,
        gradients: Sequence[torch.Tensor],
    ) -> None:
        """Gradients of the first layers, one or two, from the slopes behind them.

        values: between two layers. gradients: room for those of weight, bias, weight; or of weight alone.
        """
        second = _layer(layers[1], weights[1]) if len(layers) > 1 else _layer()
        sides = _side(layers[0].narrow, values), _side(layers[-1].narrow, slopes)
        results = [_address(part) for part in (*gradients, None, None)[:3]]
        _check(self._library.look_back(_pictures(images), _layer(layers[0]), second, *sides, *results))

    def reconstruct(
        self,
        layers: Sequence[Layer],
        weights: Sequence[Weights],
        values: torch.Tensor,
        images: Images,
        scales: torch.Tensor,
        gated: bool,
        slopes: torch.Tensor,
        gradients: EndGradients,
    ) -> None:
        """Widen values through the last layers, one or two, compare with images, and come back.

        layers: the image's first. Fills slopes and gradients with those of the sum of scales (lanes,) / 2 times the
        errors; slopes are zero where gated values are not positive.
        """
        before = _layer(layers[1], weights[1]) if len(layers) > 1 else _layer()
        parts = (gradients.errors, *gradients.last, *(gradients.before or (None, None)), gradients.totals)
        flow = _side(layers[-1].narrow, slopes)
        results = _Gradients(*map(_address, parts), ctypes.pointer(flow))
        sides = _side(layers[-1].narrow, values), _layer(layers[0], weights[0]), before, _side(layers[0].narrow, None)
        _check(self._library.reconstruct(*sides, _pictures(images), scales.data_ptr(), gated, results))

    def multiply(self, left: torch.Tensor, right: torch.Tensor, out: torch.Tensor) -> None:
        """Fill out (M, N) with left (M, K) right (K, N). Rows of right and out are contiguous, N at least `panel`."""
        rows, columns = out.shape
        pitches = right.data_ptr(), right.stride(0), out.data_ptr(), out.stride(0)
        self._library.multiply(left.data_ptr(), *left.stride(), *pitches, rows, len(right), columns)


class _Side(ctypes.Structure):
    _fields_ = (
        ("values", ctypes.c_void_p),
        ("channels", ctypes.c_int),
        ("rows", ctypes.c_int),
        ("columns", ctypes.c_int),
        ("kept", ctypes.c_int),
        ("places", ctypes.c_int),
    )


class _Layer(ctypes.Structure):
    _fields_ = (
        ("kernel", ctypes.c_int),
        ("stride", ctypes.c_int),
        ("narrowing", ctypes.c_void_p),
        ("widening", ctypes.c_void_p),
        ("bias", ctypes.c_void_p),
    )


class _Pictures(ctypes.Structure):
    _fields_ = (
        ("images", ctypes.POINTER(ctypes.c_void_p)),
        ("count", ctypes.c_int),
        ("rows", ctypes.c_int),
        ("columns", ctypes.c_int),
        ("channels", ctypes.c_int),
    )


class _Gradients(ctypes.Structure):
    _fields_ = (
        ("errors", ctypes.c_void_p),
        ("last_weight", ctypes.c_void_p),
        ("last_bias", ctypes.c_void_p),
        ("before_weight", ctypes.c_void_p),
        ("before_bias", ctypes.c_void_p),
        ("totals", ctypes.c_void_p),
        ("slopes", ctypes.POINTER(_Side)),
    )


def signatures() -> Dict[str, Tuple[Any, List[Any]]]:
    """What each function of the library returns and takes."""
    address, number, length = ctypes.c_void_p, ctypes.c_int, ctypes.c_long
    side, layer, pictures = map(ctypes.POINTER, (_Side, _Layer, _Pictures))
    convolution = (number, [side, side, layer, number, side, address])
    return {
        "lanes": (number, []),
        "panel": (number, []),
        "packed_taps": (number, [number, number, number]),
        "pack": (None, [address, number, number, number, number, number, address, address]),
        "to_group": (None, [address, length, length, number, length, address]),
        "from_group": (None, [address, length, address, length, length, number]),
        "narrow": convolution,
        "widen": convolution,
        "correlate": (number, [side, side, layer, address]),
        "channel_sums": (None, [side, address]),
        "look": (number, [pictures, layer, layer, side, side, number]),
        "look_back": (number, [pictures, layer, layer, side, side, address, address, address]),
        "reconstruct": (
            number,
            [side, layer, layer, side, pictures, address, number, ctypes.POINTER(_Gradients)],
        ),
        "multiply": (None, [address, length, length, address, length, address, length, number, number, number]),
    }


def _side(shape: Shape, values: Optional[torch.Tensor]) -> _Side:
    return _Side(_address(values), *shape, shape[1], -1)


def _optional_side(shape: Shape, values: Optional[torch.Tensor]) -> Optional[_Side]:
    return None if values is None else _side(shape, values)


def _layer(layer: Optional[Layer] = None, weights: Optional[Weights] = None) -> _Layer:
    """Without weights for what needs the geometry alone, without a layer for one that is not there."""
    return _Layer(*(layer[2:] if layer else (0, 0)), *(map(_address, weights) if weights else (None, None, None)))


def _pictures(images: Images) -> _Pictures:
    if not images[0].is_contiguous():
        raise ValueError("the compiled kernels read images row by row: give them in one piece each")
    addresses = [image.data_ptr() for image in images]
    return _Pictures((ctypes.c_void_p * len(addresses))(*addresses), len(addresses), *images[0].shape)


def _address(tensor: Optional[torch.Tensor]) -> Optional[int]:
    return None if tensor is None else tensor.data_ptr()


def _check(status: int) -> None:
    if status:
        raise MemoryError("the compiled kernels found no memory to work in")
