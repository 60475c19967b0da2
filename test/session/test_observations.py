"""The observation store: what it acknowledged is there, whatever happened to the process or to the file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.errors import CorruptFileError, ObservationError, SessionError
from embodied_active_learning.session.observations import DATA_FILE, LAYOUT_FILE, ObservationStore
from embodied_active_learning.workspace import Workspace

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
SHAPE = (5, 4, 3)
WORKSPACE = Workspace()


def image(index, shape=SHAPE):
    return np.random.default_rng(index).integers(0, 256, shape, dtype=np.uint8)


def state(index):
    return np.array([0.4 + 0.001 * index, -0.1, 0.5])


def open_store(folder, **keywords):
    return ObservationStore.open_for_writing(folder, WORKSPACE, SHAPE, **keywords)


def fill(folder, count):
    with open_store(folder) as store:
        for index in range(count):
            store.append(index, 0.2 * index, state(index), image(index))
    return Path(folder) / DATA_FILE


def assert_holds(store, count):
    assert len(store) == count
    for index in range(count):
        np.testing.assert_array_equal(store.images[index], image(index))
        np.testing.assert_array_equal(store.raw_states[index], state(index))
    np.testing.assert_allclose(store.states, WORKSPACE.normalise(store.raw_states), atol=1e-6)


def test_store_round_trip(tmp_path):
    fill(tmp_path, 7)
    with ObservationStore.open_read_only(tmp_path, WORKSPACE) as store:
        assert_holds(store, 7)
        np.testing.assert_array_equal(store.stamps, 0.2 * np.arange(7))
        assert (store.states.dtype, store.raw_states.dtype, store.images.dtype) == (np.float32, np.float64, np.uint8)


def test_store_grows_and_continues_after_reopening(tmp_path):
    fill(tmp_path, 70)
    with open_store(tmp_path, capacity=10) as store:
        for index in range(70, 150):
            assert store.append(index, 0.2 * index, state(index), image(index))
        assert_holds(store, 150)
    with open_store(tmp_path) as store:
        assert_holds(store, 150)


def test_repeated_observation_is_stored_once(tmp_path):
    data = fill(tmp_path, 3)
    size = data.stat().st_size
    with open_store(tmp_path) as store:
        assert store.append(1, 0.2, state(1), image(1)) is False
        assert len(store) == 3
    assert data.stat().st_size == size


@pytest.mark.parametrize(
    ("index", "stamp", "content", "message"),
    [
        (5, 1.0, 5, "observation 5 received, expected 3"),
        (-1, 1.0, 5, "observation -1 received, expected 3"),
        (1, 0.2, 2, "observation 1 is stored with other content"),
        (1, 0.3, 1, "observation 1 is stored with other content"),
    ],
)
def test_wrong_observation_number_is_rejected(tmp_path, index, stamp, content, message):
    fill(tmp_path, 3)
    with open_store(tmp_path) as store:
        with pytest.raises(ObservationError, match=message):
            store.append(index, stamp, state(content), image(content))
        assert_holds(store, 3)


@pytest.mark.parametrize(
    ("stamp", "pose", "picture", "message"),
    [
        (0.0, state(0), image(0, (4, 5, 3)), r"image is uint8 \(4, 5, 3\), expected uint8 \(5, 4, 3\)"),
        (0.0, state(0), image(0).astype(np.float32), "image is float32"),
        (0.0, state(0), None, "image is NoneType"),
        (0.0, [0.4, np.nan, 0.0], image(0), "not finite"),
        (np.inf, state(0), image(0), "not finite"),
        (0.0, [0.4, 0.0], image(0), r"state has shape \(2,\), expected \(3,\)"),
    ],
)
def test_invalid_observation_is_rejected(tmp_path, stamp, pose, picture, message):
    with open_store(tmp_path) as store:
        with pytest.raises(ObservationError, match=message):
            store.append(0, stamp, pose, picture)
        assert len(store) == 0


def test_truncated_record_keeps_earlier_records(tmp_path):
    data = fill(tmp_path, 3)
    content = data.read_bytes()
    record = len(content) // 3
    for length in range(2 * record, 3 * record):
        data.write_bytes(content[:length])
        with ObservationStore.open_read_only(tmp_path, WORKSPACE) as store:
            assert len(store) == 2
        assert data.stat().st_size == length, "reading must not write"
        with open_store(tmp_path) as store:
            assert len(store) == 2
            assert store.append(2, 0.4, state(2), image(2))
        assert data.read_bytes() == content


def test_damaged_record_in_the_middle_is_named(tmp_path):
    data = fill(tmp_path, 4)
    content = bytearray(data.read_bytes())
    content[len(content) // 4 + 17] ^= 1
    data.write_bytes(content)
    for opener in (open_store, lambda folder: ObservationStore.open_read_only(folder, WORKSPACE)):
        with pytest.raises(CorruptFileError, match=rf"{DATA_FILE}: record 1 is damaged"):
            opener(tmp_path)
    assert data.read_bytes() == bytes(content)


def test_damaged_last_record_is_dropped(tmp_path, caplog):
    data = fill(tmp_path, 3)
    content = bytearray(data.read_bytes())
    content[-20] ^= 4
    data.write_bytes(content)
    with open_store(tmp_path) as store:
        assert_holds(store, 2)
    assert "record 2" in caplog.text


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("version", 2),
        ("image_shape", [5, 4, 4]),
        ("image_shape", [10**6, 10**6, 3]),
        ("state_names", ["y", "x", "theta"]),
        ("record_bytes", 12),
    ],
)
def test_invalid_layout_names_file_and_field(tmp_path, field, value):
    fill(tmp_path, 1)
    path = tmp_path / LAYOUT_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), field: value}))
    with pytest.raises(CorruptFileError, match=rf"{LAYOUT_FILE}: {field}(/0)? (is|has)"):
        open_store(tmp_path)


def test_store_of_other_image_size_is_rejected(tmp_path):
    fill(tmp_path, 1)
    with pytest.raises(ObservationError, match=r"image_shape is \[5, 4, 3\], but the camera is .* \[6, 4, 3\]"):
        ObservationStore.open_for_writing(tmp_path, WORKSPACE, (6, 4, 3))


def test_reading_a_missing_store_creates_nothing(tmp_path):
    with pytest.raises(SessionError, match="no observations yet"):
        ObservationStore.open_read_only(tmp_path / "observations", WORKSPACE)
    assert not (tmp_path / "observations").exists()


def test_second_writer_is_rejected(tmp_path):
    with open_store(tmp_path), pytest.raises(SessionError, match="being written by another process"):
        open_store(tmp_path)
    open_store(tmp_path).close()


def test_reader_works_beside_writer(tmp_path):
    with open_store(tmp_path) as writer:
        writer.append(0, 0.0, state(0), image(0))
        with ObservationStore.open_read_only(tmp_path, WORKSPACE) as reader:
            assert_holds(reader, 1)
            with pytest.raises(SessionError, match="read-only"):
                reader.append(1, 0.2, state(1), image(1))


def test_snapshots_are_consistent_prefixes(tmp_path):
    faults = []
    stop = threading.Event()

    def read(store):
        while not stop.is_set():
            taken = store.snapshot()
            lengths = {len(array) for array in taken}
            good = len(lengths) == 1 and all(
                taken.raw_states[i, 0] == state(i)[0] and np.array_equal(taken.images[i], image(i))
                for i in range(max(0, len(taken.stamps) - 3), len(taken.stamps))
            )
            if not good:
                faults.append(lengths)

    with open_store(tmp_path) as store:
        first = None
        thread = threading.Thread(target=read, args=(store,))
        thread.start()
        for index in range(300):
            store.append(index, 0.2 * index, state(index), image(index))
            first = store.images if index == 10 else first
        stop.set()
        thread.join()
    assert not faults
    assert all(np.array_equal(first[i], image(i)) for i in range(11))


def test_append_continues_after_full_disk(tmp_path):
    script = f"""
import resource, signal
import numpy as np
from embodied_active_learning.errors import SessionError
from embodied_active_learning.session.observations import ObservationStore
from embodied_active_learning.workspace import Workspace
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
store = ObservationStore.open_for_writing({str(tmp_path)!r}, Workspace(), {SHAPE}, 10)
picture = np.full({SHAPE}, 7, np.uint8)
store.append(0, 0.0, (0.4, 0.0, 0.0), picture)
resource.setrlimit(resource.RLIMIT_FSIZE, (store.layout.size + 30, resource.RLIM_INFINITY))
try:
    store.append(1, 0.2, (0.4, 0.0, 0.0), picture)
except SessionError as error:
    assert "free disk space" in str(error), error
else:
    raise AssertionError("the disk was full")
assert len(store) == 1
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
assert store.append(1, 0.2, (0.4, 0.0, 0.0), picture)
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60, env=ENVIRONMENT)
    with ObservationStore.open_read_only(tmp_path, WORKSPACE) as store:
        assert len(store) == 2
        assert store.images.min() == store.images.max() == 7


@settings(max_examples=25)
@given(
    height=st.integers(1, 6),
    width=st.integers(1, 6),
    values=st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 4), max_size=5),
)
def test_any_finite_observations_round_trip(tmp_path_factory, height, width, values):
    folder = tmp_path_factory.mktemp("store")
    shape = (height, width, 3)
    with ObservationStore.open_for_writing(folder, WORKSPACE, shape) as store:
        for index, (stamp, *pose) in enumerate(values):
            store.append(index, stamp, pose, image(index, shape))
    with ObservationStore.open_read_only(folder, WORKSPACE) as store:
        assert [(stamp, *pose) for stamp, pose in zip(store.stamps, store.raw_states)] == values
        assert all(np.array_equal(store.images[index], image(index, shape)) for index in range(len(values)))
