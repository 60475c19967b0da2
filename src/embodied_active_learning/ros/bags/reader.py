"""Reading ROS bags (format 2.0) from front to back: bytes in, messages as bytes out, and nothing of a bag is ever run.

rosbag's own reader makes Python code of the message definitions that it finds in a bag and imports it, has gpg open
encrypted ones, and needs the index, which a bag lacks whose recorder was killed. A bag may come from anybody; so what
is read here is bounded, and what a message means is taken from this computer's own message classes alone.
"""

from __future__ import annotations

import bz2
import io
import os
import struct
from pathlib import Path
from typing import BinaryIO, Callable, Dict, Iterator, NamedTuple, Tuple

import roslz4

from embodied_active_learning.errors import BagError
from embodied_active_learning.files import open_plain, shown

LARGEST_RECORD = 2**26
"""Bytes of the largest chunk or message that is read: many times a camera's picture."""
_LARGEST_HEADER = 2**16
_LARGEST_DEFINITION = 2**20
_MOST_CONNECTIONS = 10000
_MAGIC = b"#ROSBAG V"
_VERSION = b"2.0\n"
_MESSAGE, _FILE_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_PIECE = 2**16  # compressed bytes that are unpacked at a time

Fields = Dict[str, bytes]


class Connection(NamedTuple):
    """What the messages of one publisher are, by their own account."""

    topic: str
    datatype: str  # such as sensor_msgs/Image
    md5sum: str


class BagMessage(NamedTuple):
    """One message as it was recorded."""

    connection: Connection
    time: Tuple[int, int]  # s, ns: when it was recorded
    data: bytes  # serialised


class BagFile:
    """The messages of one bag. One that was not closed, as its recorder was killed, is read to where it breaks off."""

    def __init__(self, path: Path) -> None:
        """Look at the beginning of the file. Raises BagError when it is no bag that can be read."""
        self.path = Path(path)
        with self._opened() as stream:
            self.closed, self._first = self._read_beginning(stream)

    def read(self, wanted: Callable[[Connection], bool]) -> Iterator[BagMessage]:
        """The messages on connections that are wanted, as they were recorded one after the other.

        Raises BagError for a damaged bag.
        """
        with self._opened() as stream:
            size = os.fstat(stream.fileno()).st_size
            stream.seek(self._first)
            try:
                yield from self._messages(_records(stream, size), {}, wanted)
            except (EOFError, ValueError, struct.error) as error:
                if self.closed:
                    raise BagError(self._damage(str(error) or "it ends too early")) from error
            except OSError as error:
                raise BagError(self._damage(str(error))) from error

    def _messages(
        self,
        records: Iterator[_Record],
        connections: Dict[int, Connection],
        wanted: Callable[[Connection], bool],
        in_chunk: bool = False,
    ) -> Iterator[BagMessage]:
        for record in records:
            operation = record.number("op", "<B")
            if operation == _CONNECTION:
                _connect(connections, record)
            elif operation == _CHUNK and not in_chunk:
                chunk = _unpacked(record)
                yield from self._messages(_records(io.BytesIO(chunk), len(chunk)), connections, wanted, in_chunk=True)
            elif operation == _MESSAGE:
                number = record.number("conn", "<L")
                if number not in connections:
                    raise ValueError("a message belongs to no publisher")
                if wanted(connections[number]):
                    yield BagMessage(connections[number], record.time(), record.data())
            elif in_chunk or operation not in (_INDEX, _CHUNK_INFO):
                raise ValueError(f"a record is of the kind {operation}, which has no place there")

    def _opened(self) -> BinaryIO:
        try:
            return io.BufferedReader(open_plain(self.path, follow=True), _PIECE)
        except (OSError, ValueError) as error:  # the latter for names that no file can have
            reason = getattr(error, "strerror", None) or error
            raise BagError(f"{self.path} cannot be read ({reason}): give the path of a bag that is there") from error

    def _read_beginning(self, stream: BinaryIO) -> Tuple[bool, int]:
        """Whether the bag was closed, and where its first record begins."""
        found = stream.read(len(_MAGIC) + len(_VERSION))
        if not found.startswith(_MAGIC):
            raise BagError(
                f"{self.path} is no ROS bag: give one that rosbag, record:=true or session_to_bag has written"
            )
        if not found.endswith(_VERSION):
            version = found[len(_MAGIC) :].decode("ascii", "replace").strip()
            raise BagError(f"{self.path} is of the bag format {shown(version)}: convert it with rosbag fix")
        try:
            header = next(_records(stream, os.fstat(stream.fileno()).st_size))
            if header.number("op", "<B") != _FILE_HEADER:
                raise ValueError("its first record is no file header")
            if header.fields.get("encryptor"):
                raise BagError(f"{self.path} is encrypted: decrypt it with rosbag decompress first")
            return header.number("index_pos", "<Q") > 0, header.end
        except (StopIteration, EOFError, ValueError, struct.error) as error:
            raise BagError(self._damage(str(error) or "it ends too early")) from error

    def _damage(self, reason: str) -> str:
        return f"{self.path} is damaged ({reason}): put it back from a copy, or see what rosbag reindex can save"


class _Record:
    """One record: its fields, and its data, which are read only when they are asked for."""

    def __init__(self, stream: BinaryIO, end_of_all: int) -> None:
        self._stream = stream
        self.fields = _fields(_sized(stream, end_of_all, _LARGEST_HEADER))
        (self._size,) = struct.unpack("<L", _exactly(stream, 4))
        self._begin = stream.tell()
        self.end = self._begin + self._size

    def data(self, largest: int = LARGEST_RECORD) -> bytes:
        if self._size > largest:
            raise ValueError(f"a record has {self._size} bytes, and {largest} are allowed")
        self._stream.seek(self._begin)
        return _exactly(self._stream, self._size)

    def number(self, field: str, layout: str) -> int:
        return struct.unpack(layout, self.fields.get(field, b""))[0]

    def text(self, field: str) -> str:
        return _text(self.fields, field)

    def time(self) -> Tuple[int, int]:
        seconds, nanoseconds = struct.unpack("<LL", self.fields.get("time", b""))
        return seconds, nanoseconds


def _records(stream: BinaryIO, size: int) -> Iterator[_Record]:
    """The records of a stream from where it stands. Raises EOFError when the last one is not whole."""
    position = stream.tell()
    while position < size:
        record = _Record(stream, size)
        if record.end > size:
            raise EOFError
        yield record
        position = record.end
        stream.seek(position)


def _connect(connections: Dict[int, Connection], record: _Record) -> None:
    if len(connections) >= _MOST_CONNECTIONS:
        raise ValueError(f"it has more than {_MOST_CONNECTIONS} publishers")
    own = _fields(record.data(_LARGEST_DEFINITION))
    connections[record.number("conn", "<L")] = Connection(
        record.text("topic"), _text(own, "type"), _text(own, "md5sum")
    )


def _unpacked(record: _Record) -> bytes:
    """The content of a chunk."""
    compression, size = record.text("compression"), record.number("size", "<L")
    if size > LARGEST_RECORD:
        raise ValueError(f"a chunk has {size} bytes, and {LARGEST_RECORD} are allowed")
    data = record.data()
    if compression == "none":
        content = data
    elif compression == "bz2":
        content = _unpacked_bz2(data, size)
    elif compression == "lz4":
        content = _unpacked_lz4(data, size)
    else:
        raise ValueError(f"a chunk is compressed by {shown(compression)}")
    if len(content) != size:
        raise ValueError(f"a chunk has {len(content)} bytes, and should have {size}")
    return content


def _unpacked_bz2(data: bytes, size: int) -> bytes:
    try:
        return bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
    except OSError as error:
        raise ValueError(f"a chunk cannot be unpacked: {error}") from error


def _unpacked_lz4(data: bytes, size: int) -> bytes:
    decompressor, parts, total = roslz4.LZ4Decompressor(), [], 0
    for start in range(0, len(data), _PIECE):
        try:
            parts.append(decompressor.decompress(data[start : start + _PIECE]))
        except Exception as error:  # roslz4 has errors of its own kind, some of which are bare
            raise ValueError(f"a chunk cannot be unpacked: {error!r}") from error
        total += len(parts[-1])
        if total > size:
            raise ValueError(f"a chunk has more than its {size} bytes")
    return b"".join(parts)


def _fields(content: bytes) -> Fields:
    """name=value pairs, each with its length before it."""
    fields: Fields = {}
    stream = io.BytesIO(content)
    while stream.tell() < len(content):
        name, equals, value = _sized(stream, len(content), len(content)).partition(b"=")
        if not equals:
            raise ValueError("a field has no value")
        fields[name.decode("ascii", "replace")] = value
    return fields


def _text(fields: Fields, name: str) -> str:
    return fields.get(name, b"").decode("utf-8", "replace")


def _sized(stream: BinaryIO, end: int, largest: int) -> bytes:
    """Bytes that have their length before them."""
    (size,) = struct.unpack("<L", _exactly(stream, 4))
    if stream.tell() + size > end:
        raise EOFError
    if size > largest:
        raise ValueError(f"a header has {size} bytes, and {largest} are allowed")
    return _exactly(stream, size)


def _exactly(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise EOFError
    return data
