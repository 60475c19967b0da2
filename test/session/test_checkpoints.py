"""Checkpoints and models: the newest whole one is always found, and nothing damaged or foreign is ever believed."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import subprocess
import sys

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.session import array_files, atomic
from embodied_active_learning.session.atomic import replace_file, write_text
from embodied_active_learning.session.checkpoints import load_latest, load_model, save_checkpoint, save_model

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def tensors(value=1.0):
    buffer = torch.arange(12, dtype=torch.float32) * value
    return {
        "weight": buffer[:6].reshape(2, 3),
        "moments": buffer[6:],
        "generator": torch.arange(5, dtype=torch.uint8),
        "step": torch.tensor(3),
    }


def assert_equal(found, expected):
    assert sorted(found) == sorted(expected)
    for name, tensor in expected.items():
        assert found[name].dtype == tensor.dtype
        assert torch.equal(found[name], tensor)


def test_checkpoint_round_trip(tmp_path):
    counters = {"beta": [1e-4, 0.1], "draws": {"state": 2**127 + 1, "name": "PCG64"}}
    save_checkpoint(tmp_path, 600, 214, tensors(), counters)
    checkpoint = load_latest(tmp_path)
    assert (checkpoint.updates, checkpoint.observations, checkpoint.counters) == (600, 214, counters)
    assert checkpoint.refused == ()
    assert_equal(checkpoint.tensors, tensors())


def test_missing_checkpoint_is_none(tmp_path):
    assert load_latest(tmp_path) is None
    assert load_latest(tmp_path / "missing") is None


def test_newest_checkpoints_are_kept(tmp_path):
    (tmp_path / ".checkpoint_000000001.safetensors.99999999.1.tmp").write_bytes(b"half")
    for updates in (9, 90, 900):
        save_checkpoint(tmp_path, updates, 10, tensors(), {}, keep=2)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["checkpoint_000000090.safetensors", "checkpoint_000000900.safetensors"]


def test_damaged_checkpoint_falls_back_to_older_one(tmp_path):
    for updates in (1, 2, 3):
        path = save_checkpoint(tmp_path, updates, 10, tensors(updates), {"n": updates}, keep=3)
    path.write_bytes(path.read_bytes()[:-1])
    (tmp_path / "checkpoint_000000004.safetensors").write_bytes(b"")
    checkpoint = load_latest(tmp_path)
    assert checkpoint.updates == 2
    assert_equal(checkpoint.tensors, tensors(2))
    assert ["000000004" in checkpoint.refused[0], "000000003" in checkpoint.refused[1]] == [True, True]


def test_checkpoint_after_fallback_replaces_damaged_ones(tmp_path):
    for updates in (1, 2):
        save_checkpoint(tmp_path, updates, 10, tensors(), {}, keep=2)
    (tmp_path / "checkpoint_000000009.safetensors").write_bytes(b"damaged")
    save_checkpoint(tmp_path, 3, 10, tensors(), {}, keep=2)
    assert sorted(path.name[18:20] for path in tmp_path.iterdir()) == ["02", "03"]


def test_only_damaged_checkpoints_are_an_error(tmp_path):
    save_checkpoint(tmp_path, 5, 10, tensors(), {}).write_bytes(b"damaged")
    with pytest.raises(CorruptFileError, match=r"no checkpoint in .* can be used: .*000000005"):
        load_latest(tmp_path)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_non_finite_tensor_does_not_replace_checkpoint(tmp_path, value):
    save_checkpoint(tmp_path, 1, 10, tensors(), {}, keep=1)
    with pytest.raises(SessionError, match="array weight has values that are not finite"):
        save_checkpoint(tmp_path, 2, 10, {"weight": torch.tensor([value])}, {}, keep=1)
    assert load_latest(tmp_path).updates == 1


def test_finite_numbers_with_infinite_sum_are_stored(tmp_path):
    largest = torch.full((3,), torch.finfo(torch.float32).max)
    save_checkpoint(tmp_path, 1, 10, {"weight": largest}, {})
    assert torch.equal(load_latest(tmp_path).tensors["weight"], largest)


def test_model_round_trip(tmp_path):
    save_model(tmp_path / "model.safetensors", tensors(), {"updates": 9000})
    found, facts = load_model(tmp_path / "model.safetensors")
    assert_equal(found, tensors())
    assert facts == {"updates": 9000}


def test_checkpoint_of_another_version_is_rejected(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(array_files, "_VERSIONS", {})
        save_checkpoint(tmp_path, 5, 10, tensors(), {})
    message = "no checkpoint .* version is '1', but this package reads version '2' only: .* train again"
    with pytest.raises(CorruptFileError, match=message):
        load_latest(tmp_path)


def test_missing_model_error_has_a_remedy(tmp_path):
    with pytest.raises(CorruptFileError, match=r"model.safetensors is missing: restore the file, or train again"):
        load_model(tmp_path / "model.safetensors")


def test_failed_write_keeps_old_file(tmp_path):
    path = tmp_path / "note.txt"
    write_text(path, "old")

    with contextlib.suppress(KeyError), replace_file(path) as stream:
        stream.write(b"new")
        raise KeyError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_failed_flush_after_rename_reports_new_file(tmp_path, monkeypatch):
    path = tmp_path / "note.txt"

    def fail(folder):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(atomic, "sync_folder", fail)
    with pytest.raises(SessionError, match=r"note.txt was written, but may be lost in a power failure \(Input/output"):
        write_text(path, "new")
    assert path.read_text() == "new"


def test_unwritable_folder_is_reported(tmp_path):
    with pytest.raises(SessionError, match=r"note.txt cannot be written \(No such file or directory\)"):
        write_text(tmp_path / "missing" / "note.txt", "text")


@settings(max_examples=20)
@given(
    values=st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), max_size=20),
    counters=st.dictionaries(
        st.text(max_size=5), st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text())
    ),
)
def test_any_finite_numbers_round_trip(tmp_path_factory, values, counters):
    folder = tmp_path_factory.mktemp("checkpoints")
    save_checkpoint(folder, 1, 10, {"values": torch.tensor(values, dtype=torch.float32)}, counters)
    checkpoint = load_latest(folder)
    assert checkpoint.tensors["values"].tolist() == values
    assert checkpoint.counters == counters


def test_equal_content_gives_equal_bytes(tmp_path):
    tensors = {f"layer-{index}": torch.arange(float(index + 1)) for index in range(20)}
    paths = [tmp_path / f"{index}.safetensors" for index in range(5)]
    for path in paths:
        save_model(path, tensors, {"updates": 1, "observations": 2})
    assert len({path.read_bytes() for path in paths}) == 1


def test_sparse_file_beyond_memory_is_rejected(tmp_path):
    """A failed allocation inside safetensors is not an Exception."""
    path, size = tmp_path / "model.safetensors", 2**30
    header = json.dumps({"w": {"dtype": "U8", "shape": [size], "data_offsets": [0, size]}}).encode()
    path.write_bytes(len(header).to_bytes(8, "little") + header)
    os.truncate(path, 8 + len(header) + size)
    script = f"""
import resource, sys
from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.session.array_files import read_arrays
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {size} + 2**26, resource.RLIM_INFINITY))
try:
    read_arrays({str(path)!r}, "model")
except CorruptFileError as error:
    sys.exit(0 if "model.safetensors" in str(error) else 1)
sys.exit(2)
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60, env=ENVIRONMENT)
