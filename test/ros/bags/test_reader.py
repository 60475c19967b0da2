"""Bags are read as rosbag has written them; what is no bag, damaged or made up is refused by name, and never run."""

import bz2
import struct
from contextlib import suppress

import genpy
import numpy as np
import pytest
import rosbag
from hypothesis import given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import Image
from std_msgs.msg import String

from embodied_active_learning.errors import BagError
from embodied_active_learning.ros.bags.reader import LARGEST_RECORD, BagFile

WORDS = [f"number {number}" for number in range(200)]
PICTURE = np.random.default_rng(0).integers(0, 40, 3000, dtype=np.uint8).tobytes()


def write(path, compression="none", leave_open=False):
    """A bag with a text and a picture by turns, in chunks of a few."""
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


def refusal(path):
    with pytest.raises(BagError) as error:
        words(path)
    return str(error.value)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a whole bag."""
    path = tmp_path_factory.mktemp("bag") / "a.bag"
    write(path)
    return path.read_bytes()


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_what_rosbag_has_written_is_read_in_its_order(tmp_path, compression):
    write(tmp_path / "a.bag", compression)
    assert words(tmp_path / "a.bag") == WORDS
    messages = list(BagFile(tmp_path / "a.bag").read(lambda _: True))
    assert [message.connection.topic for message in messages[:4]] == ["/words", "/pictures"] * 2
    assert [message.time for message in messages[:3]] == [(1, 0), (1, 0), (1, 1)]
    assert messages[1].connection.datatype == "sensor_msgs/Image"
    assert messages[1].connection.md5sum == Image._md5sum


def test_a_bag_whose_recorder_was_killed_is_read_up_to_where_it_breaks_off(tmp_path):
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


def test_a_closed_bag_that_is_cut_short_is_refused(tmp_path, whole):
    path = tmp_path / "a.bag"
    path.write_bytes(whole[: len(whole) // 2])
    assert "a.bag is damaged (it ends too early): put it back from a copy" in refusal(path)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is no ROS bag"),
        (b"\x80\x04K\x01.", "is no ROS bag"),
        (b"#ROSBAG V2.0\n", "is damaged (it ends too early)"),
        (b"#ROSBAG V1.2\n", "is of the bag format '1.2': convert it with rosbag fix"),
    ],
)
def test_what_is_no_such_bag_is_refused_by_name(tmp_path, content, expected):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    assert expected in refusal(path)


def test_what_is_no_file_is_refused(tmp_path):
    assert "cannot be read (No such file or directory)" in refusal(tmp_path / "a.bag")
    assert "it is a folder" in refusal(tmp_path)
    assert "it is a device" in refusal("/dev/zero")


def test_an_encrypted_bag_is_refused_and_no_key_is_looked_for(tmp_path, whole):
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + record({"op": b"\x03", "index_pos": struct.pack("<Q", 9), "encryptor": b"x"}))
    assert "is encrypted" in refusal(path)


def record(fields, data=b""):
    parts = [b"=".join((name.encode(), value)) for name, value in fields.items()]
    header = b"".join(struct.pack("<L", len(part)) + part for part in parts)
    return struct.pack("<L", len(header)) + header + struct.pack("<L", len(data)) + data


HEAD = b"#ROSBAG V2.0\n" + record({"op": b"\x03", "index_pos": struct.pack("<Q", 9)})


def chunk(data, size, compression=b"bz2"):
    return HEAD + record({"op": b"\x05", "compression": compression, "size": struct.pack("<L", size)}, data)


NESTED = chunk(b"", 0, b"none")[len(HEAD) :]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (chunk(bz2.compress(bytes(10**7)), 100), "a chunk has 101 bytes, and should have 100"),
        (chunk(b"", LARGEST_RECORD + 1), f"and {LARGEST_RECORD} are allowed"),
        (chunk(b"nonsense", 100), "cannot be unpacked"),
        (chunk(b"nonsense", 100, b"lz4"), "a chunk"),
        (chunk(b"", 0, b"gzip"), "compressed by 'gzip'"),
        (HEAD + struct.pack("<L", 2**31), "it ends too early"),
        (HEAD + record({"op": b"\x02", "conn": bytes(4)}), "belongs to no publisher"),
        (HEAD + record({"op": b"\x63"}), "of the kind 99, which has no place there"),
        (chunk(NESTED, len(NESTED), b"none"), "of the kind 5, which has no place there"),
        (HEAD + record({}), "damaged"),
    ],
)
def test_what_asks_for_too_much_or_makes_no_sense_is_refused(tmp_path, content, expected):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    assert expected in refusal(path)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_bag_in_which_bytes_have_changed_is_read_or_refused_and_nothing_else(whole, tmp_path_factory, data):
    content = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "changed.bag"
    path.write_bytes(content)
    with suppress(BagError):
        assert all(len(message.data) <= len(whole) for message in BagFile(path).read(lambda _: True))
