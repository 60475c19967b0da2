"""Pictures as cameras send them, raw or compressed, to arrays, and to the size that the model takes.

Whatever the bytes are, the answer is an array of the size that was announced, or an ObservationError: they come from
another process, over a network.
"""

from __future__ import annotations

import struct
import zlib
from typing import Dict, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from embodied_active_learning.errors import ObservationError

LARGEST_SIDE = 8192
"""Most pixels of a picture's side that are taken ..."""
LARGEST_AREA = 2**24
"""... and most pixels in all."""
LARGEST_DATA = 2**26
"""Most bytes of a compressed picture that are looked at."""


class _Layout(NamedTuple):
    bytes_per_pixel: int
    to_rgb: Optional[int]  # OpenCV's code of the conversion; None where there is nothing to convert
    pixels_together: int = 1  # how many share their colour


# YUV is BT.601 with Y from 16 to 235, which is what webcams mean by it, and what OpenCV converts.
_UYVY = _Layout(2, cv2.COLOR_YUV2RGB_UYVY, 2)
_YUYV = _Layout(2, cv2.COLOR_YUV2RGB_YUY2, 2)
_LAYOUTS: Dict[str, _Layout] = {
    "rgb8": _Layout(3, None),
    "bgr8": _Layout(3, cv2.COLOR_BGR2RGB),
    "rgba8": _Layout(4, cv2.COLOR_RGBA2RGB),
    "bgra8": _Layout(4, cv2.COLOR_BGRA2RGB),
    "mono8": _Layout(1, cv2.COLOR_GRAY2RGB),
    "yuv422": _UYVY,  # sensor_msgs' name for UYVY
    "uyvy": _UYVY,
    "yuyv": _YUYV,
    "yuv422_yuy2": _YUYV,
}
ENCODINGS = tuple(_LAYOUTS)
"""Encodings of raw pictures that can be decoded, by the names of sensor_msgs/Image."""

_JPEG_START, _JPEG_SCAN, _JPEG_END = b"\xff\xd8\xff", b"\xff\xda", b"\xff\xd9"
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # markers of the segment that has the size
_JPEG_ALONE = frozenset((0x01, *range(0xD0, 0xD8)))  # markers without a segment
_PNG_START = b"\x89PNG\r\n\x1a\n"


def decode_raw(data: bytes, encoding: str, height: int, width: int, step: int) -> np.ndarray:
    """Rows of step bytes, as in sensor_msgs/Image -> (height, width, 3) uint8 RGB.

    The array may share its memory with the data, and then cannot be written to. Raises ObservationError for another
    encoding than ENCODINGS, and for bytes that are not what the numbers beside them say.
    """
    layout = _LAYOUTS.get(encoding)
    if layout is None:
        raise ObservationError(
            f"image encoding is {encoding[:40]!r}: it can be one of {', '.join(ENCODINGS)}; set it in the camera's "
            "driver"
        )
    _check_size(height, width)
    row = layout.bytes_per_pixel * width
    if step < row or len(data) != step * height:
        raise ObservationError(
            f"image has {len(data)} bytes in rows of {step}: expected {height} rows of {row} bytes or more"
        )
    if width % layout.pixels_together:
        raise ObservationError(
            f"image is {width} pixels wide: in the encoding {encoding} there is no odd number of them; set another "
            "width in the camera's driver"
        )
    rows = np.frombuffer(data, np.uint8).reshape(height, step)[:, :row]
    pixels = rows.reshape(height, width, layout.bytes_per_pixel)
    return pixels if layout.to_rgb is None else cv2.cvtColor(pixels, layout.to_rgb)


def decode_compressed(data: bytes) -> np.ndarray:
    """A JPEG or PNG file -> (H, W, 3) uint8 RGB, as it was stored: a note that it is to be turned is passed over.

    Its size is read before it is decoded, so that a small file cannot ask for much memory. Raises ObservationError for
    what is neither, too large, cut off or damaged.
    """
    if len(data) > LARGEST_DATA:
        raise ObservationError(f"compressed image has {len(data)} bytes: at most {LARGEST_DATA} are taken")
    try:
        height, width = encoded_size(data)
    except ValueError as error:
        raise ObservationError(f"compressed image {error}: {_REMEDY}") from None
    _check_size(height, width)
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        picture = None
    if picture is None or picture.shape != (height, width, 3):
        raise ObservationError(f"compressed image is damaged, its content cannot be decoded: {_REMEDY}")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def encoded_size(data: bytes) -> Tuple[int, int]:
    """Return height and width of a JPEG or PNG file from its header, without decoding it.

    Raises ValueError for another format, or an incomplete or damaged file.
    """
    size_of = next((size_of for start, size_of in _SIZE_OF.items() if data.startswith(start)), None)
    if size_of is None:
        raise ValueError(f"begins with {data[:4].hex(' ') or 'nothing'}: it can be JPEG or PNG")
    try:
        return size_of(data)
    except ValueError as error:
        raise ValueError(f"is damaged, {error}") from None


class Framing(NamedTuple):
    """What of a picture the model sees: the largest part in its middle that has the model's shape, scaled to its size.

    Sizes and offsets in pixels: of the picture, of the part that is kept, and of the image that comes out.
    """

    source: Tuple[int, int]  # height, width
    part: Tuple[int, int]
    size: Tuple[int, int]

    @classmethod
    def between(cls, source: Tuple[int, int], size: Tuple[int, int]) -> Framing:
        """Framing of pictures of a size (height, width) for images of another one."""
        scale = min(source[0] / size[0], source[1] / size[1])
        part = [max(1, min(have, round(scale * want))) for have, want in zip(source, size)]
        return cls(source, (part[0], part[1]), size)

    @property
    def offset(self) -> Tuple[int, int]:
        """First row and column of the part that is kept."""
        return (self.source[0] - self.part[0]) // 2, (self.source[1] - self.part[1]) // 2

    @property
    def changes_nothing(self) -> bool:
        """Whether pictures come out as they go in."""
        return self.source == self.size

    def apply(self, picture: np.ndarray) -> np.ndarray:
        """Picture (H, W, 3) uint8 of the source's size -> image (h, w, 3) uint8."""
        if self.changes_nothing:
            return picture
        (top, left), (rows, columns), (height, width) = self.offset, self.part, self.size
        part = picture[top : top + rows, left : left + columns]
        shrinks = rows >= height and columns >= width
        return cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)

    def matrix(self) -> np.ndarray:
        """(3, 3) pixels of the source (column, row, 1) to pixels of the image, pixel centres at whole numbers."""
        (top, left), (rows, columns), (height, width) = self.offset, self.part, self.size
        across, down = width / columns, height / rows
        return np.array(
            [
                [across, 0.0, (0.5 - left) * across - 0.5],
                [0.0, down, (0.5 - top) * down - 0.5],
                [0.0, 0.0, 1.0],
            ]
        )


def _check_size(height: int, width: int) -> None:
    if not (0 < height <= LARGEST_SIDE and 0 < width <= LARGEST_SIDE and height * width <= LARGEST_AREA):
        raise ObservationError(
            f"image is {width} x {height} pixels: give 1 to {LARGEST_SIDE} a side, and at most {LARGEST_AREA} in all; "
            "set it in the camera's driver"
        )


def _jpeg_size(data: bytes) -> Tuple[int, int]:
    """Height and width that a whole JPEG file says it has; ValueError tells why not.

    Some cameras fill its end up with zeros.
    """
    if data.rfind(_JPEG_END) < data.rfind(_JPEG_SCAN):  # neither marker occurs inside compressed data
        raise ValueError("its end is missing")
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # a byte that only fills
            at += 1
        elif marker in _JPEG_ALONE:
            at += 2
        elif marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return height, width
        else:
            at += 2 + max(2, struct.unpack_from(">H", data, at + 2)[0])
    raise ValueError("it does not say its size")


def _png_size(data: bytes) -> Tuple[int, int]:
    """Height and width of a PNG file whose parts are all there, with their checksums; ValueError tells why not."""
    at, size, name = len(_PNG_START), (0, 0), b""
    while name != b"IEND":
        if at + 12 > len(data):
            raise ValueError("its end is missing")
        length, name = struct.unpack_from(">I4s", data, at)
        if at + 12 + length > len(data):
            raise ValueError("its end is missing")
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(data[at + 4 : at + 8 + length]) != checksum:
            raise ValueError("a checksum in it is wrong")
        if at == len(_PNG_START):
            if name != b"IHDR" or length != 13:
                raise ValueError("it does not say its size")
            width, height = struct.unpack_from(">II", data, at + 8)
            size = height, width
        at += 12 + length
    return size


_SIZE_OF = {_JPEG_START: _jpeg_size, _PNG_START: _png_size}
_REMEDY = "look at cable and network, or take raw images"
