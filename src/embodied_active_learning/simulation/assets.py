"""Read the files a world refers to: regular files of bounded size, with errors that name the remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Tuple

import numpy as np

from embodied_active_learning.errors import WorldError
from embodied_active_learning.files import FileReader
from embodied_active_learning.images import MAX_PIXELS, decode_pixels, encoded_size

_LFS_POINTER = b"version https://git-lfs"


def read_asset(path: Path, expected: str, limit: int) -> bytes:
    """Return the content of a file.

    Args:
        path: The file; may be a symbolic link.
        expected: What it should be, for messages.
        limit: Maximum size in bytes.

    Raises:
        WorldError: The file is missing, not a regular file, too large, or a Git LFS pointer.
    """
    content = FileReader(WorldError, f"give {expected}", limit, follow=True).read_bytes(path)
    if content.startswith(_LFS_POINTER):
        raise WorldError(f"{path} is a Git LFS pointer, not {expected}: run `git lfs pull` in its repository")
    return content


def read_picture(path: Path) -> np.ndarray:
    """Return a PNG or JPEG file as (H, W, 3) uint8 RGB. Raises WorldError as check_picture(), or for damaged pixels."""
    content, shape = _read_header(path)
    picture = decode_pixels(content, *shape)
    if picture is None:
        raise WorldError(f"texture {path} is damaged: its pixels cannot be decoded; convert it to PNG again")
    return picture


def check_picture(path: Path) -> None:
    """Check a PNG or JPEG file by its header, without decoding it.

    Raises WorldError as read_asset(), and for another format, an incomplete file, or too many pixels.
    """
    _read_header(path)


def _read_header(path: Path) -> Tuple[bytes, Tuple[int, int]]:
    """Content, and height and width."""
    content = read_asset(path, "a PNG or JPEG picture", 2**26)
    try:
        height, width = encoded_size(content)
    except ValueError as error:
        raise WorldError(f"texture {path} {error}; convert it to PNG") from None
    if not 0 < height * width <= MAX_PIXELS:
        raise WorldError(f"texture {path} has {width} x {height} pixels: reduce it to at most {MAX_PIXELS}")
    return content, (height, width)
