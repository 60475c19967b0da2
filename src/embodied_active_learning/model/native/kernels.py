"""The compiled kernels as functions of tensors. A group: as many images as a vector has lanes, innermost in memory."""

from __future__ import annotations

import ctypes
from itertools import accumulate
from typing import Any, Dict, Iterable, List, NamedTuple, Sequence, Tuple

import torch

from embodied_active_learning.model.objective import Images

Shape = Tuple[int, int, int]


class Layer(NamedTuple):
    """A convolution between its wide side (nearer the image) and its narrow one; (channels, rows, columns) of each."""

    wide: Shape
    narrow: Shape
    kernel: int
    stride: int


class Chain(NamedTuple):
    """Layers from the image inwards, with weights packed for going either way; as the library takes them."""

    layers: Any
    kept: List[torch.Tensor]


class Gradients:
    """Room for the gradients of some parameters from each group of images."""

    def __init__(self, parameters: Sequence[torch.Tensor], groups: int) -> None:
        self._shapes = [parameter.shape for parameter in parameters]
        self._lengths = [parameter.numel() for parameter in parameters]
        self._each = torch.empty((groups, sum(self._lengths)))

    def of(self, group: int) -> Any:
        """Addresses of one group's gradients."""
        first = self._each[group].data_ptr()
        places = accumulate([first, *(4 * length for length in self._lengths[:-1])])
        return (ctypes.c_void_p * len(self._lengths))(*places)

    def summed(self) -> Tuple[List[torch.Tensor], torch.Tensor]:
        """The gradients from all groups, and the sum of all their elements."""
        total = self._each.sum(0)
        parts = total.split(self._lengths)
        return [part.view(shape) for part, shape in zip(parts, self._shapes)], total.sum()


class Room(NamedTuple):
    """Memory for one group's values on some sides; sides: all of them as the library takes them, the image's first."""

    tensors: Dict[int, torch.Tensor]
    sides: Any


class Kernels:
    """Typed calls into the library. Tensors are contiguous float32 on the CPU, values (C, H, W, lanes), unless said.

    Calls that take a chain may raise MemoryError.
    """

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        self.lanes: int = library.lanes()
        self.panel: int = library.panel()
        self.near: int = library.near_layers()

    def pack(self, layers: Sequence[Layer], parameters: Sequence[torch.Tensor]) -> Chain:
        """Weight (narrow channels, wide channels, k, k), bias, weight, bias, ... from the image inwards -> a chain."""
        kept: List[torch.Tensor] = []
        made = (_Layer * len(layers))()
        for index, (layer, weight, bias) in enumerate(zip(layers, parameters[::2], parameters[1::2])):
            narrow, wide, kernel, _ = weight.shape
            columns = layer.narrow[2]
            taps = self._library.packed_taps(kernel, layer.stride, columns)
            ways = [torch.empty(narrow * wide * taps * taps) for _ in range(2)]
            source = weight.detach().contiguous()  # has a name, or it would be gone before it is read
            shape = narrow, wide, kernel, layer.stride, columns
            paired = self._library.pack(source.data_ptr(), *shape, *(way.data_ptr() for way in ways))
            made[index] = _Layer(kernel, layer.stride, paired, *(part.data_ptr() for part in (*ways, bias)))
            kept += [*ways, bias]
        return Chain(made, kept)

    def room(self, layers: Sequence[Layer], wanted: Iterable[int]) -> Room:
        """Room on the wanted sides, counted from the image."""
        shapes = [layers[0].wide, *(layer.narrow for layer in layers)]
        tensors = {side: torch.empty((*shapes[side], self.lanes)) for side in wanted}
        found = (tensors[side].data_ptr() if side in tensors else None for side in range(len(shapes)))
        sides = (_Side(address, *shape, shape[1], -1) for address, shape in zip(found, shapes))
        return Room(tensors, (_Side * len(shapes))(*sides))

    def encode(self, chain: Chain, images: Images, room: Room, *features: torch.Tensor) -> None:
        """Up to `lanes` images -> values on all sides but the image's, the last also into each of features (B, F)."""
        out = (_Numbers * len(features))(*map(_numbers, features))
        layers = chain.layers, room.sides, len(chain.layers)
        _check(self._library.encode(_pictures(images), *layers, out, len(features)))

    def encode_back(
        self,
        chain: Chain,
        images: Images,
        values: Room,
        flow: Room,
        slopes: torch.Tensor,
        gradients: Any,
    ) -> None:
        """Slopes (B, F) at what encode has left in values -> the gradients of weight, bias, ... from the image inwards.

        flow: room on the sides from `near` on. gradients: addresses of room for them.
        """
        layers = chain.layers, values.sides, flow.sides, len(chain.layers)
        _check(self._library.encode_back(_pictures(images), *layers, _numbers(slopes), gradients))

    def decode(self, chain: Chain, features: torch.Tensor, values: Room) -> None:
        """Features (B, F) of up to `lanes` images -> values on all sides, the image's with them."""
        layers = chain.layers, values.sides, len(chain.layers)
        _check(self._library.decode(_numbers(features), len(features), *layers, 0))

    def decode_back(
        self,
        chain: Chain,
        features: torch.Tensor,
        images: Images,
        scales: torch.Tensor,
        rooms: Sequence[Room],
        slopes: torch.Tensor,
        errors: torch.Tensor,
        gradients: Any,
    ) -> None:
        """Decode features (B, F) of up to `lanes` images, compare with the images, and come back.

        Fills errors (B,) with sums of squared differences, and, for the sum of scales (B,) / 2 times these, slopes
        (B, F) at the features and the gradients of weight, bias, ... from the image inwards. rooms: two, on the sides
        from `near` on. gradients: addresses of room for them.
        """
        values, flow = rooms
        target = _pictures(images), scales.data_ptr()
        layers = chain.layers, values.sides, flow.sides, len(chain.layers)
        results = _numbers(slopes), errors.data_ptr(), gradients
        _check(self._library.decode_back(_numbers(features), *target, *layers, *results))

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
        ("paired", ctypes.c_int),
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


class _Numbers(ctypes.Structure):
    _fields_ = (("first", ctypes.c_void_p), ("across", ctypes.c_long), ("along", ctypes.c_long))


def signatures() -> Dict[str, Tuple[Any, List[Any]]]:
    """What each function of the library returns and takes."""
    address, number, length = ctypes.c_void_p, ctypes.c_int, ctypes.c_long
    side, layer, pictures, numbers = map(ctypes.POINTER, (_Side, _Layer, _Pictures, _Numbers))
    addresses = ctypes.POINTER(address)
    return {
        "lanes": (number, []),
        "panel": (number, []),
        "near_layers": (number, []),
        "packed_taps": (number, [number, number, number]),
        "pack": (number, [address, number, number, number, number, number, address, address]),
        "encode": (number, [pictures, layer, side, number, numbers, number]),
        "encode_back": (number, [pictures, layer, side, side, number, numbers, addresses]),
        "decode": (number, [numbers, number, layer, side, number, number]),
        "decode_back": (
            number,
            [numbers, pictures, address, layer, side, side, number, numbers, address, addresses],
        ),
        "multiply": (None, [address, length, length, address, length, address, length, number, number, number]),
    }


def _pictures(images: Images) -> _Pictures:
    if not images[0].is_contiguous():
        raise ValueError("the compiled kernels read images row by row: give them in one piece each")
    addresses = [image.data_ptr() for image in images]
    return _Pictures((ctypes.c_void_p * len(addresses))(*addresses), len(addresses), *images[0].shape)


def _numbers(rows: torch.Tensor) -> _Numbers:
    """Rows (B, F), any strides."""
    return _Numbers(rows.data_ptr(), *rows.stride())


def _check(status: int) -> None:
    if status:
        raise MemoryError("the compiled kernels found no memory to work in")
