"""Decoding of raw and compressed camera images, and cropping and scaling to the size of the model.

The bytes are not trusted: each function returns an array of the announced size or raises ObservationError.
"""

from __future__ import annotations

import struct
import zlib
from typing import Dict, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from embodied_active_learning.errors import ObservationError

MAX_SIDE = 8192
"""Largest accepted width and height of an image [px]."""
MAX_PIXELS = 2**24
"""Largest accepted number of pixels."""
MAX_DATA = 2**26
"""Largest accepted size of a compressed image [bytes]."""


class _Layout(NamedTuple):
    bytes_per_pixel: int
    to_rgb: Optional[int]  # conversion code of OpenCV; None for RGB
    pixels_per_group: int = 1  # pixels that share their colour


# YUV is BT.601 with Y from 16 to 235, as in webcams and OpenCV.
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
"""Supported encodings of raw images, named as in sensor_msgs/Image."""

_JPEG_START, _JPEG_SCAN, _JPEG_END = b"\xff\xd8\xff", b"\xff\xda", b"\xff\xd9"
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # markers of the segment with the size
_JPEG_ALONE = frozenset((0x01, *range(0xD0, 0xD8)))  # markers without a segment
_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_DEPTH = 24  # position of the byte with the bits per channel


def decode_raw(data: bytes, encoding: str, height: int, width: int, step: int) -> np.ndarray:
    """Decode the fields of a sensor_msgs/Image.

    Args:
        data: Rows of step bytes.
        encoding: One of ENCODINGS.
        height: Rows.
        width: Columns.
        step: Bytes per row.

    Returns:
        (height, width, 3) uint8 RGB; read-only if it shares memory with the data.

    Raises:
        ObservationError: The encoding is not supported, or the number of bytes is wrong.
    """
    layout = _LAYOUTS.get(encoding)
    if layout is None:
        raise ObservationError(
            f"unsupported image encoding {encoding[:40]!r}: set one of {', '.join(ENCODINGS)} in the camera's driver"
        )
    _check_size(height, width)
    row = layout.bytes_per_pixel * width
    if step < row or len(data) != step * height:
        raise ObservationError(
            f"image has {len(data)} bytes in rows of {step}: expected {height} rows of {row} bytes or more"
        )
    if width % layout.pixels_per_group:
        raise ObservationError(
            f"image is {width} pixels wide: encoding {encoding} requires an even number; set another width in the "
            "camera's driver"
        )
    rows: np.ndarray = np.frombuffer(data, np.uint8).reshape(height, step)[:, :row]
    pixels = rows.reshape(height, width, layout.bytes_per_pixel)
    return pixels if layout.to_rgb is None else cv2.cvtColor(pixels, layout.to_rgb)


def decode_compressed(data: bytes) -> np.ndarray:
    """Decode a JPEG or PNG file to (H, W, 3) uint8 RGB. EXIF rotation is ignored.

    The size is checked before decoding, so that a small file cannot allocate much memory.

    Raises:
        ObservationError: The format is not supported, or the image is too large, truncated or damaged.
    """
    if len(data) > MAX_DATA:
        raise ObservationError(f"compressed image has {len(data)} bytes: at most {MAX_DATA} are supported")
    try:
        height, width = encoded_size(data)
    except ValueError as error:
        remedy = _REMEDY if data.startswith(tuple(_SIZE_OF)) else "set the compression of the camera driver"
        raise ObservationError(f"compressed image {error}: {remedy}") from None
    _check_size(height, width)
    if data.startswith(_PNG_START) and data[_PNG_DEPTH] > 8:  # OpenCV would keep the higher byte: dark images
        raise ObservationError(f"PNG image has {data[_PNG_DEPTH]} bits per channel: set 8 bits in the camera's driver")
    picture = decode_pixels(data, height, width)
    if picture is None:
        raise ObservationError(f"compressed image is damaged, its content cannot be decoded: {_REMEDY}")
    return picture


def decode_pixels(data: bytes, height: int, width: int) -> Optional[np.ndarray]:
    """Decode a JPEG or PNG file of a size that was checked. EXIF rotation is ignored.

    Returns:
        (height, width, 3) uint8 RGB; None if the file is damaged or has another size.
    """
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None
    if picture is None or picture.shape != (height, width, 3):
        return None
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def encoded_size(data: bytes) -> Tuple[int, int]:
    """Return height and width of a JPEG or PNG file from its header, without decoding it.

    Raises ValueError for another format, or an incomplete or damaged file.
    """
    size_of = next((size_of for start, size_of in _SIZE_OF.items() if data.startswith(start)), None)
    if size_of is None:
        raise ValueError(
            f"has an unsupported format (it begins with {data[:4].hex(' ') or 'nothing'}, expected JPEG or PNG)"
        )
    try:
        return size_of(data)
    except ValueError as error:
        raise ValueError(f"is damaged, {error}") from None


class Framing(NamedTuple):
    """Central crop with the model's aspect ratio, scaled to the model's size. All values in pixels.

    Attributes:
        source: Height and width of the camera's image.
        part: Height and width of the crop.
        size: Height and width of the result.
    """

    source: Tuple[int, int]
    part: Tuple[int, int]
    size: Tuple[int, int]

    @classmethod
    def between(cls, source: Tuple[int, int], size: Tuple[int, int]) -> Framing:
        """Return the framing of images of one size (height, width) for another."""
        scale = min(source[0] / size[0], source[1] / size[1])
        part = [max(1, min(have, round(scale * want))) for have, want in zip(source, size)]
        return cls(source, (part[0], part[1]), size)

    @property
    def offset(self) -> Tuple[int, int]:
        """First row and column of the crop."""
        return (self.source[0] - self.part[0]) // 2, (self.source[1] - self.part[1]) // 2

    @property
    def is_identity(self) -> bool:
        """Whether images are unchanged."""
        return self.source == self.size

    def apply(self, picture: np.ndarray) -> np.ndarray:
        """Crop and scale an image (H, W, 3) uint8 of the source size to (h, w, 3) uint8."""
        if self.is_identity:
            return picture
        (top, left), (rows, columns), (height, width) = self.offset, self.part, self.size
        part = picture[top : top + rows, left : left + columns]
        shrinks = rows >= height and columns >= width
        return cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)

    def matrix(self) -> np.ndarray:
        """Return the (3, 3) map from source pixels (column, row, 1) to result pixels; pixel centres are integers."""
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
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE and height * width <= MAX_PIXELS):
        raise ObservationError(
            f"image is {width} x {height} pixels: at most {MAX_SIDE} per side and {MAX_PIXELS} in total; "
            "set it in the camera's driver"
        )


def _jpeg_size(data: bytes) -> Tuple[int, int]:
    """Return height and width of a complete JPEG file. Raises ValueError. Some cameras pad the end with zeros."""
    if data.rfind(_JPEG_END) < data.rfind(_JPEG_SCAN):  # neither marker occurs inside compressed data
        raise ValueError("its end is missing")
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # padding
            at += 1
        elif marker in _JPEG_ALONE:
            at += 2
        elif marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return height, width
        else:
            at += 2 + max(2, struct.unpack_from(">H", data, at + 2)[0])
    raise ValueError("its size is missing")


def _png_size(data: bytes) -> Tuple[int, int]:
    """Return height and width of a complete PNG file with correct checksums. Raises ValueError."""
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
                raise ValueError("its size is missing")
            width, height = struct.unpack_from(">II", data, at + 8)
            size = height, width
        at += 12 + length
    return size


_SIZE_OF = {_JPEG_START: _jpeg_size, _PNG_START: _png_size}
_REMEDY = "check cable and network, or use raw images"
