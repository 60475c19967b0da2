"""BagFile: bags written by rosbag are read; damaged, malformed and hostile ones are rejected, and never executed."""

import bz2
import struct
import sys
import tracemalloc
from contextlib import suppress

import genpy
import numpy as np
import pytest
import rosbag
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import Image
from std_msgs.msg import String

from embodied_active_learning.errors import BagError
from embodied_active_learning.ros.bags.reader import MAX_CHUNK_SIZE, MAX_MESSAGE_SIZE, BagFile, Connection

WORDS = [f"number {number}" for number in range(200)]
PICTURE = np.random.default_rng(0).integers(0, 40, 3000, dtype=np.uint8).tobytes()


def write(path, compression="none", leave_open=False):
    """Write a bag with alternating texts and images, in small chunks."""
    bag = rosbag.Bag(str(path), "w", compression=compression, chunk_threshold=20000)
    for number, word in enumerate(WORDS):
        bag.write("/words", String(word), genpy.Time(1, number))
        bag.write("/pictures", Image(data=PICTURE), genpy.Time(1, number))
    if leave_open:
        bag._file.flush()
    else:
        bag.close()
    return bag


def words(path, topic="/words"):
    return [String().deserialize(m.data).data for m in BagFile(path).read(lambda connection: connection.topic == topic)]


def rejection(path):
    with pytest.raises(BagError) as error:
        words(path)
    return str(error.value)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The content of a complete bag."""
    path = tmp_path_factory.mktemp("bag") / "a.bag"
    write(path)
    return path.read_bytes()


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_reader_returns_what_rosbag_wrote(tmp_path, compression):
    write(tmp_path / "a.bag", compression)
    assert words(tmp_path / "a.bag") == WORDS
    messages = list(BagFile(tmp_path / "a.bag").read(lambda _: True))
    assert [message.connection.topic for message in messages[:4]] == ["/words", "/pictures"] * 2
    assert [message.time for message in messages[:3]] == [(1, 0), (1, 0), (1, 1)]
    assert messages[1].connection.datatype == "sensor_msgs/Image"
    assert messages[1].connection.md5sum == Image._md5sum


def test_unclosed_bag_is_read_up_to_its_end(tmp_path):
    path = tmp_path / "a.bag.active"
    bag = write(path, leave_open=True)
    assert not BagFile(path).closed
    assert words(path) == WORDS
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2 + 7])
    found = words(path)
    assert found == WORDS[: len(found)]
    assert 80 < len(found) < 120
    bag.close()


def test_truncated_closed_bag_is_rejected(tmp_path, whole):
    path = tmp_path / "a.bag"
    path.write_bytes(whole[: len(whole) // 2])
    assert "a.bag is damaged: unexpected end of file; restore it from a copy" in rejection(path)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is not a ROS bag"),
        (b"\x80\x04K\x01.", "is not a ROS bag"),
        (b"#ROSBAG V2.0\n", "is damaged: unexpected end of file"),
        (b"#ROSBAG V1.2\n", "has bag format '1.2', expected 2.0: convert it with rosbag fix"),
    ],
)
def test_invalid_bag_is_rejected(tmp_path, content, expected):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    assert expected in rejection(path)


def test_missing_or_special_file_is_rejected(tmp_path):
    assert "a.bag: No such file or directory" in rejection(tmp_path / "a.bag")
    assert "it is a folder" in rejection(tmp_path)
    assert "it is a device" in rejection("/dev/zero")


def test_encrypted_bag_is_rejected(tmp_path, whole):
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + record({"op": b"\x03", "index_pos": struct.pack("<Q", 9), "encryptor": b"x"}))
    assert "is encrypted" in rejection(path)


def record(fields, data=b""):
    parts = [b"=".join((name.encode(), value)) for name, value in fields.items()]
    header = b"".join(struct.pack("<L", len(part)) + part for part in parts)
    return struct.pack("<L", len(header)) + header + struct.pack("<L", len(data)) + data


HEAD = b"#ROSBAG V2.0\n" + record({"op": b"\x03", "index_pos": struct.pack("<Q", 9)})


def chunk(data, size, compression=b"bz2"):
    return HEAD + record({"op": b"\x05", "compression": compression, "size": struct.pack("<L", size)}, data)


def connection(topic=b"/words", datatype=b"std_msgs/String", md5sum=b"0" * 32, number=0):
    own = {"type": datatype, "md5sum": md5sum, "message_definition": b"string data"}
    data = record(own)
    size = struct.unpack("<L", data[:4])[0]
    return record({"op": b"\x07", "conn": struct.pack("<L", number), "topic": topic}, data[4 : 4 + size])


CONNECTION = connection()
NESTED = chunk(b"", 0, b"none")[len(HEAD) :]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (chunk(bz2.compress(bytes(10**7)), 100), "damaged"),
        (chunk(bz2.compress(CONNECTION + bytes(10**7)), len(CONNECTION)), "a chunk has more than"),
        (chunk(b"nonsense", 100), "cannot decompress a chunk"),
        (chunk(b"nonsense", 100, b"lz4"), "damaged"),
        (chunk(b"", 0, b"gzip"), "unknown chunk compression 'gzip'"),
        (HEAD + struct.pack("<L", 2**31), "unexpected end of file"),
        (HEAD + record({"op": b"\x02", "conn": bytes(4)}), "a message has no connection record"),
        (HEAD + record({"op": b"\x63"}), "unexpected record type 99"),
        (chunk(NESTED, len(NESTED), b"none"), "unexpected record type 5"),
        (HEAD + record({}), "damaged"),
    ],
)
def test_malformed_records_are_rejected(tmp_path, content, expected):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    assert expected in rejection(path)


fields_of_record = st.dictionaries(
    st.sampled_from(["op", "conn", "time", "topic", "compression", "size", "index_pos", "x"]),
    st.one_of(
        st.sampled_from([b"\x02", b"\x04", b"\x05", b"\x06", b"\x07", b"none", b"bz2", b"lz4", bytes(4), bytes(8)]),
        st.binary(max_size=8),
    ),
)
records = st.builds(record, fields_of_record, st.binary(max_size=60))
nested = st.builds(
    lambda parts, size, compression: chunk(parts, size, compression)[len(HEAD) :],
    st.lists(records, max_size=3).map(b"".join),
    st.integers(0, 2**32 - 1),
    st.sampled_from([b"none", b"bz2", b"lz4"]),
)


@given(parts=st.lists(st.one_of(records, nested, st.just(CONNECTION)), max_size=6))
def test_records_with_random_content_are_read_or_rejected(tmp_path_factory, parts):
    path = tmp_path_factory.getbasetemp() / "random.bag"
    path.write_bytes(HEAD + b"".join(parts))
    with suppress(BagError):
        assert sum(len(message.data) for message in BagFile(path).read(lambda _: True)) <= 2**20


@pytest.mark.parametrize(
    "fields",
    [{"topic": b"/" * 1025}, {"datatype": b"a" * 257}, {"md5sum": b"0" * 33}],
    ids=["topic", "type", "md5sum"],
)
def test_long_connection_fields_are_rejected(tmp_path, fields):
    """The error is about a limit of this reader, not about damage."""
    path = tmp_path / "a.bag"
    path.write_bytes(HEAD + connection(**fields))
    message = rejection(path)
    assert "this reader accepts up to" in message
    assert "damaged" not in message


def test_memory_is_bounded_for_a_bag_of_long_connections(tmp_path):
    """A small compressed bag with many connections, each with a type of 1 MB."""
    path = tmp_path / "a.bag"
    content = b"".join(connection(datatype=b"a" * 10**6, number=number) for number in range(50))
    path.write_bytes(chunk(bz2.compress(content), len(content)))
    assert path.stat().st_size < 20_000
    tracemalloc.start()
    assert "the type of a connection has 1000000 bytes" in rejection(path)
    assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    tracemalloc.stop()


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_large_chunk_is_streamed(tmp_path, compression):
    """A chunk above 64 MiB with large messages on a topic that is not read."""
    path = tmp_path / "a.bag"
    with rosbag.Bag(str(path), "w", compression=compression, chunk_threshold=2**30) as bag:
        for number, word in enumerate(WORDS[:9]):
            bag.write("/clouds", Image(data=bytes(9 * 10**6)), genpy.Time(1, number))
            bag.write("/words", String(word), genpy.Time(1, number))
    tracemalloc.start()
    assert words(path) == WORDS[:9]
    assert tracemalloc.get_traced_memory()[1] < 40 * 2**20
    tracemalloc.stop()


def test_chunk_above_limit_is_reported_as_limit(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(chunk(b"", MAX_CHUNK_SIZE + 1))
    message = rejection(path)
    assert f"this reader accepts up to {MAX_CHUNK_SIZE}: rewrite the bag with smaller chunks" in message
    assert "damaged" not in message


def test_message_above_limit_is_reported_as_limit(tmp_path):
    path = tmp_path / "a.bag"
    message = record({"op": b"\x02", "conn": bytes(4), "time": bytes(8)}, bytes(MAX_MESSAGE_SIZE + 1))
    path.write_bytes(HEAD + CONNECTION + message)
    assert f"this reader accepts up to {MAX_MESSAGE_SIZE}" in rejection(path)


def test_message_definitions_are_never_executed(tmp_path):
    """A definition that breaks out of the code that genpy generates from it: rosbag's reader would run it."""
    marker = tmp_path / "executed"
    definition = f"string data=\"\nopen({str(marker)!r}, 'w')\nx=\""
    path = tmp_path / "a.bag"
    with rosbag.Bag(str(path), "w") as bag:
        header = {"topic": "/words", "type": "a/B", "md5sum": "0" * 32, "message_definition": definition}
        bag.write("/words", String("word"), connection_header=header)
    before = set(sys.modules)
    (found,) = BagFile(path).read(lambda _: True)
    assert found.connection == Connection("/words", "a/B", "0" * 32)
    assert not marker.exists()
    assert set(sys.modules) == before, "reading imported a module"
