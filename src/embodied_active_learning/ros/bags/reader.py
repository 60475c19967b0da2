"""Read ROS bags (format 2.0) sequentially, without executing anything from them.

Security property: no content of a bag is executed. rosbag's reader generates Python code from the message definitions
stored in a bag and imports it, and starts gpg for encrypted bags. This reader ignores the stored definitions: a message
is returned as bytes, to be deserialised by the message classes installed on this computer. All sizes are bounded before
memory is allocated. The index is not needed, so bags of a recorder that was killed can be read too.
"""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path
from typing import Callable, Dict, Iterator, NamedTuple, Tuple

from embodied_active_learning.errors import BagError
from embodied_active_learning.files import open_regular_file, short_repr
from embodied_active_learning.ros.bags.chunk import ReadStream, decompress

MAX_MESSAGE_SIZE = 2**26
"""Maximum size of a message that is read, in bytes; larger messages on other topics are skipped."""
MAX_CHUNK_SIZE = 2**30
"""Maximum size of an uncompressed chunk in bytes. Chunks are streamed: the limit bounds time, not memory."""
_MAX_HEADER_SIZE = 2**16
_MAX_DEFINITION_SIZE = 2**20
_MAX_CONNECTIONS = 10000
_MAX_TOPIC, _MAX_TYPE, _MD5_LENGTH = 1024, 256, 32  # characters; genmsg and roscpp stay far below
_MAGIC = b"#ROSBAG V"
_VERSION = b"2.0\n"
_MESSAGE, _FILE_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_BUFFER = 2**16

Fields = Dict[str, bytes]


class Connection(NamedTuple):
    """Topic and message type of one publisher, as recorded."""

    topic: str
    datatype: str  # such as sensor_msgs/Image
    md5sum: str


class BagMessage(NamedTuple):
    """One recorded message."""

    connection: Connection
    time: Tuple[int, int]  # s, ns: time of recording
    data: bytes  # serialised


class _LimitError(ValueError):
    """A valid bag exceeds a limit of this reader."""


class BagFile:
    """The messages of one bag. An unclosed bag (its recorder was killed) is read up to its last whole record."""

    def __init__(self, path: Path) -> None:
        """Read the file header. Raises BagError if the file is not a readable bag."""
        self.path = Path(path)
        with self._open() as stream:
            self.closed, self._first = self._read_file_header(stream)

    def read(self, wanted: Callable[[Connection], bool]) -> Iterator[BagMessage]:
        """Yield the messages of the wanted connections in file order. Raises BagError for a damaged bag."""
        with self._open() as stream:
            size = os.fstat(stream.fileno()).st_size
            stream.seek(self._first)
            try:
                yield from self._messages(_records(stream, size), {}, wanted)
            except _LimitError as error:
                raise BagError(f"{self.path}: {error}") from error
            except (EOFError, ValueError, struct.error) as error:
                if self.closed:
                    raise BagError(self._damage(str(error) or "unexpected end of file")) from error
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
                _add_connection(connections, record)
            elif operation == _CHUNK and not in_chunk:
                yield from self._messages(_chunk_records(record), connections, wanted, in_chunk=True)
            elif operation == _MESSAGE:
                number = record.number("conn", "<L")
                if number not in connections:
                    raise ValueError("a message has no connection record")
                if wanted(connections[number]):
                    yield BagMessage(connections[number], record.time(), record.data())
            elif in_chunk or operation not in (_INDEX, _CHUNK_INFO):
                raise ValueError(f"unexpected record type {operation}")

    def _open(self) -> io.BufferedReader:
        try:
            return io.BufferedReader(open_regular_file(self.path, follow=True), _BUFFER)  # type: ignore[arg-type]
        except (OSError, ValueError) as error:  # ValueError: null byte in the path
            reason = getattr(error, "strerror", None) or error
            raise BagError(f"cannot read {self.path}: {reason}; give the path of an existing bag") from error

    def _read_file_header(self, stream: io.BufferedReader) -> Tuple[bool, int]:
        """Return whether the bag was closed, and the offset of its first record."""
        found = stream.read(len(_MAGIC) + len(_VERSION))
        if not found.startswith(_MAGIC):
            raise BagError(f"{self.path} is not a ROS bag: give one written by rosbag, record:=true or session_to_bag")
        if not found.endswith(_VERSION):
            version = found[len(_MAGIC) :].decode("ascii", "replace").strip()
            raise BagError(
                f"{self.path} has bag format {short_repr(version)}, expected 2.0: convert it with rosbag fix"
            )
        try:
            header = next(_records(stream, os.fstat(stream.fileno()).st_size))
            if header.number("op", "<B") != _FILE_HEADER:
                raise ValueError("the first record is not a file header")
            if header.fields.get("encryptor"):
                raise BagError(f"{self.path} is encrypted: decrypt it first with rosbag decompress")
            return header.number("index_pos", "<Q") > 0, header.end
        except (StopIteration, EOFError, ValueError, struct.error) as error:
            raise BagError(self._damage(str(error) or "unexpected end of file")) from error

    def _damage(self, reason: str) -> str:
        return f"{self.path} is damaged: {reason}; restore it from a copy, or recover it with rosbag reindex"


class _Record:
    """One record: its header fields, and its data, which are read on request."""

    def __init__(self, stream: ReadStream, end_of_stream: int) -> None:
        self.stream = stream
        self.fields = _parse_fields(_read_sized(stream, end_of_stream, _MAX_HEADER_SIZE))
        (self.size,) = struct.unpack("<L", _read_exactly(stream, 4))
        self.end = stream.tell() + self.size

    def data(self, largest: int = MAX_MESSAGE_SIZE) -> bytes:
        """Return the record's data; only before the next record is read."""
        if self.size > largest:
            raise _LimitError(f"a record has {self.size} bytes, this reader accepts up to {largest}")
        return _read_exactly(self.stream, self.size)

    def number(self, field: str, layout: str) -> int:
        """Return an integer header field."""
        return struct.unpack(layout, self.fields.get(field, b""))[0]

    def text(self, field: str, largest: int) -> str:
        """Return a text header field of limited length."""
        return _text(self.fields, field, largest)

    def time(self) -> Tuple[int, int]:
        """Return the time of recording (s, ns)."""
        seconds, nanoseconds = struct.unpack("<LL", self.fields.get("time", b""))
        return seconds, nanoseconds


def _records(stream: ReadStream, end: int) -> Iterator[_Record]:
    """Yield the records from the current position to an end. Raises EOFError if the last one is incomplete."""
    position = stream.tell()
    while position < end:
        record = _Record(stream, end)
        if record.end > end:
            raise EOFError
        yield record
        position = record.end
        stream.seek(position)


def _chunk_records(chunk: _Record) -> Iterator[_Record]:
    """Yield the records inside a chunk."""
    size = chunk.number("size", "<L")
    if size > MAX_CHUNK_SIZE:
        raise _LimitError(
            f"a chunk has {size} bytes, this reader accepts up to {MAX_CHUNK_SIZE}: rewrite the bag with smaller "
            "chunks (rosbag filter IN.bag OUT.bag True)"
        )
    compression = chunk.text("compression", _MAX_TYPE)
    if compression == "none":
        if chunk.size != size:
            raise ValueError(f"a chunk has {chunk.size} bytes, its header says {size}")
        yield from _records(chunk.stream, chunk.end)
        return
    content = decompress(compression, chunk.stream, chunk.size)
    yield from _records(content, size)
    if content.read(1):
        raise ValueError(f"a chunk has more than the {size} bytes in its header")


def _add_connection(connections: Dict[int, Connection], record: _Record) -> None:
    if len(connections) >= _MAX_CONNECTIONS:
        raise _LimitError(f"more than {_MAX_CONNECTIONS} connections: extract the topics you need with rosbag filter")
    own = _parse_fields(record.data(_MAX_DEFINITION_SIZE))
    connections[record.number("conn", "<L")] = Connection(
        record.text("topic", _MAX_TOPIC), _text(own, "type", _MAX_TYPE), _text(own, "md5sum", _MD5_LENGTH)
    )


def _parse_fields(content: bytes) -> Fields:
    """Parse name=value pairs, each preceded by its length."""
    fields: Fields = {}
    stream = io.BytesIO(content)
    while stream.tell() < len(content):
        name, equals, value = _read_sized(stream, len(content), len(content)).partition(b"=")
        if not equals:
            raise ValueError("a header field has no value")
        fields[name.decode("ascii", "replace")] = value
    return fields


def _text(fields: Fields, name: str, largest: int) -> str:
    value = fields.get(name, b"")
    if len(value) > largest:
        raise _LimitError(f"the {name} of a connection has {len(value)} bytes, this reader accepts up to {largest}")
    return value.decode("utf-8", "replace")


def _read_sized(stream: ReadStream, end: int, largest: int) -> bytes:
    """Read bytes preceded by their length."""
    (size,) = struct.unpack("<L", _read_exactly(stream, 4))
    if stream.tell() + size > end:
        raise EOFError
    if size > largest:
        raise ValueError(f"a header has {size} bytes, {largest} are allowed")
    return _read_exactly(stream, size)


def _read_exactly(stream: ReadStream, size: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise EOFError
    return data
