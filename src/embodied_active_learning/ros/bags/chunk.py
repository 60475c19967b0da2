"""Stream the content of compressed bag chunks in bounded memory."""

from __future__ import annotations

import bz2
from typing import Iterator, Protocol

import roslz4

from embodied_active_learning.files import short_repr

_PIECE = 2**16  # compressed bytes per step
_MAX_STEP = 2**20  # uncompressed bytes per step of bz2


class ReadStream(Protocol):
    """What the reader needs of a stream: reading, and seeking forwards."""

    def read(self, size: int) -> bytes:
        """Return up to size bytes; fewer at the end only."""

    def tell(self) -> int:
        """Return the position in bytes."""

    def seek(self, position: int) -> object:
        """Move to a position."""


class DecompressedStream:
    """Forward-only stream over decompressed pieces."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces = pieces
        self._buffer = bytearray()
        self._position = 0

    def read(self, size: int) -> bytes:
        """Return up to size bytes; fewer at the end only."""
        self._fill(size)
        data = bytes(self._buffer[:size])
        self._advance(len(data))
        return data

    def tell(self) -> int:
        """Return the position in decompressed bytes."""
        return self._position

    def seek(self, position: int) -> None:
        """Skip forwards to a position. Raises EOFError beyond the end."""
        while position > self._position:
            self._fill(1)
            if not self._buffer:
                raise EOFError
            self._advance(min(position - self._position, len(self._buffer)))

    def _fill(self, size: int) -> None:
        while len(self._buffer) < size:
            piece = next(self._pieces, None)
            if piece is None:
                return
            self._buffer += piece

    def _advance(self, count: int) -> None:
        del self._buffer[:count]
        self._position += count


def decompress(compression: str, stream: ReadStream, size: int) -> DecompressedStream:
    """Decompress the next size bytes of a stream, which must not be read meanwhile.

    Raises ValueError for an unknown compression; the returned stream raises ValueError for damaged data.
    """
    if compression == "bz2":
        return DecompressedStream(_bz2_pieces(_pieces(stream, size)))
    if compression == "lz4":
        return DecompressedStream(_lz4_pieces(_pieces(stream, size)))
    raise ValueError(f"unknown chunk compression {short_repr(compression)}")


def _pieces(stream: ReadStream, size: int) -> Iterator[bytes]:
    while size > 0:
        piece = stream.read(min(size, _PIECE))
        if not piece:
            raise EOFError
        size -= len(piece)
        yield piece


def _bz2_pieces(compressed: Iterator[bytes]) -> Iterator[bytes]:
    decompressor = bz2.BZ2Decompressor()
    while not decompressor.eof:
        piece = next(compressed, None) if decompressor.needs_input else b""
        if piece is None:
            return
        try:
            yield decompressor.decompress(piece, max_length=_MAX_STEP)
        except OSError as error:
            raise ValueError(f"cannot decompress a chunk: {error}") from error


def _lz4_pieces(compressed: Iterator[bytes]) -> Iterator[bytes]:
    decompressor = roslz4.LZ4Decompressor()
    for piece in compressed:
        try:
            content = decompressor.decompress(piece)
        except Exception as error:  # roslz4 raises several classes, some of them bare
            raise ValueError(f"cannot decompress a chunk: {error!r}") from error
        yield content
