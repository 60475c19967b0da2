"""The fingerprints of a session: the old set or the new one is always there whole, and nothing damaged is believed."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from embodied_active_learning.config import SessionConfig
from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.objects.fingerprint import ARRAYS, BLANK
from embodied_active_learning.session import fingerprints, lock
from embodied_active_learning.session.checksummed_yaml import write_checksummed
from embodied_active_learning.session.fingerprints import has_fingerprints, load_fingerprints, save_fingerprints
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.stored_config import write_stored_config
from embodied_active_learning.session.summary import Summary, write_summary
from embodied_active_learning.session.tensor_files import read_tensors, write_tensors
from sample_fingerprints import CONFIG, make_fingerprint, make_set

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
FACTS = ("session", "updates", "observations", "created")


@pytest.fixture
def session(tmp_path):
    return make_session(tmp_path)


def make_session(folder, config=CONFIG):
    path = folder / "a"
    path.mkdir()
    write_stored_config(path / "config.yaml", config)
    return path


def numbered(number):
    """A set in which everything says the same number."""
    arrays = {
        field: np.full_like(array, number % 256)
        for field, array in ((field, getattr(make_fingerprint(), field)) for field in ARRAYS)
    }
    weights = {"layer.weight": torch.full((2, 3), float(number))}
    return make_set(updates=number, weights=weights, fingerprints=(make_fingerprint(**arrays),))


def number_of(found):
    """The number that everything in a set says."""
    assert_same(found, numbered(found.updates))
    return found.updates


def assert_same(found, expected):
    for field in FACTS:
        assert getattr(found, field) == getattr(expected, field)
    assert list(found.weights) == list(expected.weights)
    for name, tensor in expected.weights.items():
        assert torch.equal(found.weights[name], tensor)
    assert len(found.fingerprints) == len(expected.fingerprints)
    for one, other in zip(found.fingerprints, expected.fingerprints):
        assert (one.name, one.kind, one.importance) == (other.name, other.kind, other.importance)
        assert (one.calibration is None) == (other.calibration is None)
        if one.calibration is not None:
            np.testing.assert_array_equal(one.calibration.true, other.calibration.true)
            np.testing.assert_array_equal(one.calibration.false, other.calibration.false)
        for field in ARRAYS:
            array, wanted = getattr(one, field), getattr(other, field)
            assert (array.dtype, array.shape, array.tobytes()) == (wanted.dtype, wanted.shape, wanted.tobytes())


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_set_round_trip_with_session_config(session):
    generation = save_fingerprints(session, make_set())
    assert generation == session / "fingerprints" / "000001"
    found = load_fingerprints(session)
    assert_same(found, make_set())
    assert found.config == CONFIG
    assert type(found.fingerprints) is tuple


@pytest.mark.parametrize(("updates", "warned"), [(8, True), (7, False)])
def test_fingerprints_of_an_earlier_model_are_warned_about(session, caplog, updates, warned):
    save_fingerprints(session, numbered(7))
    write_summary(SessionPaths(session).summary, Summary(finished=True, steps=100, updates=updates, wall_time=1.0))
    load_fingerprints(session)
    assert (f"after 7 of {updates} updates: make them again" in caplog.text) == warned


def test_calibration_of_other_rules_or_missing_is_none(session, monkeypatch):
    path = save_fingerprints(session, make_set()) / "object-1" / "calibration.safetensors"
    monkeypatch.setattr(fingerprints, "CALIBRATION_VERSION", 0)
    assert load_fingerprints(session).fingerprints[0].calibration is None
    path.unlink()
    assert load_fingerprints(session).fingerprints[0].calibration is None


def test_invalid_calibration_is_rejected(session):
    path = save_fingerprints(session, make_set()) / "object-1" / "calibration.safetensors"
    write_tensors(
        path, "calibration", {"true": torch.ones(2, dtype=torch.float64)}, {"rules": fingerprints.CALIBRATION_VERSION}
    )
    with pytest.raises(CorruptFileError, match="expected the arrays true and false"):
        load_fingerprints(session)


def test_empty_set_round_trip(session):
    save_fingerprints(session, make_set(fingerprints=()))
    assert load_fingerprints(session).fingerprints == ()


@settings(max_examples=10)
@given(
    states=arrays(np.float64, (2, 3), elements=st.floats(-1e300, 1e300)),
    images=arrays(np.uint8, (2, 8, 9, 3), elements=st.integers(0, 255), fill=st.integers(0, 255)),
    stds=arrays(np.float32, (2, 2), elements=st.floats(0, 2.0**100, width=32)),
    importance=st.floats(0, 1),
    counts=st.tuples(st.integers(0, 2**63), st.integers(0, 2**63)),
)
def test_any_numbers_round_trip_bit_exactly(tmp_path_factory, states, images, stds, importance, counts):
    session = make_session(tmp_path_factory.mktemp("sessions"))
    fingerprint = make_fingerprint(
        centre=states[0], states=states, images=images, latent_means=-stds, latent_stds=stds, importance=importance
    )
    expected = make_set(fingerprints=(fingerprint,), updates=counts[0], observations=counts[1])
    save_fingerprints(session, expected)
    assert_same(load_fingerprints(session), expected)


def test_read_only_and_reversed_arrays_are_saved(session):
    frozen = np.arange(9.0).reshape(3, 3)
    frozen.setflags(write=False)
    images = make_fingerprint().images[::-1, :, ::-1]
    expected = make_set(fingerprints=(make_fingerprint(states=frozen, images=images),))
    save_fingerprints(session, expected)
    assert_same(load_fingerprints(session), expected)


@pytest.mark.parametrize("name", ["0", "1e5", "null"])
def test_names_ambiguous_in_yaml_round_trip(session, name):
    expected = make_set(session=name, fingerprints=(make_fingerprint(name=name),))
    save_fingerprints(session, expected)
    assert_same(load_fingerprints(session), expected)


def test_missing_thumbnail_is_ignored(session):
    generation = save_fingerprints(session, make_set())
    path = generation / "object-1" / "thumbnail.png"
    np.testing.assert_array_equal(cv2.imread(str(path))[..., ::-1], make_fingerprint().thumbnail)
    path.unlink()
    assert_same(load_fingerprints(session), make_set())


def test_second_save_replaces_the_first(session):
    save_fingerprints(session, make_set())
    generation = save_fingerprints(session, numbered(7))
    assert number_of(load_fingerprints(session)) == 7
    assert names_in(session / "fingerprints") == [".lock", generation.name]
    assert names_in(generation) == ["model.safetensors", "object-1", "set.yaml"]


def test_next_save_removes_only_leftovers(session):
    folder = session / "fingerprints"
    (folder / ".000001.tmp" / "object-1").mkdir(parents=True)
    (folder / ".set.yaml.7.8.tmp").write_text("half")
    (folder / ".000009.tmp").symlink_to(session)
    (folder / "notes.txt").write_text("mine")
    assert not has_fingerprints(session)
    save_fingerprints(session, numbered(1))
    assert names_in(folder) == [".lock", "000001", "notes.txt"]
    assert (session / "config.yaml").is_file()


def test_missing_fingerprints_error_has_a_remedy(session):
    (session / "fingerprints").mkdir()
    assert not has_fingerprints(session)
    command = "roslaunch embodied_active_learning fingerprint.launch session:=a"
    with pytest.raises(SessionError, match=rf"a has no fingerprints yet: make them with {command}, or"):
        load_fingerprints(session)
    save_fingerprints(session, make_set())
    assert has_fingerprints(session)


def test_other_folder_is_rejected_untouched(tmp_path):
    with pytest.raises(CorruptFileError, match=r"config.yaml is missing"):
        load_fingerprints(tmp_path)
    with pytest.raises(CorruptFileError, match=r"config.yaml is missing"):
        save_fingerprints(tmp_path, make_set())
    assert names_in(tmp_path) == []


def test_set_of_another_config_is_not_saved(session):
    config = replace(CONFIG, exploration=replace(CONFIG.exploration, seed=3))
    with pytest.raises(SessionError, match=r"do not belong to session .*: exploration/seed is 3 but"):
        save_fingerprints(session, make_set(config=config))
    assert not has_fingerprints(session)


def test_non_finite_weights_keep_old_set(session):
    save_fingerprints(session, numbered(1))
    with pytest.raises(SessionError, match=r"array w has values that are not finite"):
        save_fingerprints(session, make_set(weights={"w": torch.tensor([float("nan")])}))
    assert number_of(load_fingerprints(session)) == 1
    assert names_in(session / "fingerprints") == [".lock", "000001"]


def test_set_is_saved_while_session_is_locked(tmp_path):
    config = replace(CONFIG, session=SessionConfig(root=str(tmp_path), name="a"))
    with Session.open_for_writing(config) as session:
        save_fingerprints(session.paths.path, make_set(config=config))
        assert load_fingerprints(session.paths.path).config == config


def test_concurrent_save_is_rejected(session):
    save_fingerprints(session, numbered(1))
    with (session / "fingerprints" / ".lock").open("ab") as held:
        lock.claim(held, session)
        with pytest.raises(
            SessionError, match=r"fingerprints is being written by another process: stop that process first"
        ):
            save_fingerprints(session, numbered(2))
        assert number_of(load_fingerprints(session)) == 1
    save_fingerprints(session, numbered(2))
    assert number_of(load_fingerprints(session)) == 2


def test_set_replaced_while_reading_gives_new_one(session, monkeypatch):
    save_fingerprints(session, numbered(1))
    rounds = []

    def read_slowly(path, kind, reader):
        rounds.append(path.parent.name)
        if len(rounds) == 1:
            save_fingerprints(session, numbered(2))
        return read_tensors(path, kind, reader)

    monkeypatch.setattr(fingerprints, "read_tensors", read_slowly)
    assert number_of(load_fingerprints(session)) == 2
    assert rounds == ["000001", "000002"]


def test_set_is_complete_when_saver_is_killed(session):
    # In a process without threads, because it forks.
    code = "import sys, test_fingerprints as tests; tests.kill_before_steps(sys.argv[1])"
    subprocess.run([sys.executable, "-c", code, str(session)], check=True, timeout=120, env=ENVIRONMENT)


def fork(work):
    """A child process that does the work and ends with status 0, or 1 when it failed."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            work()
            status = 0
        finally:
            os._exit(status)
    return child


STRIDE = 3  # steps from one kill to the next; around the commit there is one before each step


def kill_before_steps(path):
    session = Path(path)
    save_fingerprints(session, numbered(1))
    before, found, status = session.with_name("before"), {}, signal.SIGKILL
    session.rename(before)

    def kill_before(step):
        shutil.copytree(before, session)
        child = fork(lambda: (die_before(step), save_fingerprints(session, numbered(2))))
        status = os.waitpid(child, 0)[1]
        found[step] = number_of(load_fingerprints(session))
        shutil.rmtree(session)
        return status

    while status == signal.SIGKILL:
        status = kill_before(STRIDE * len(found))
    assert status == 0
    committed = min(step for step, number in found.items() if number == 2)
    for step in range(committed - STRIDE + 1, committed):
        assert kill_before(step) == signal.SIGKILL
    numbers = [number for _, number in sorted(found.items())]
    assert numbers == sorted(numbers)
    assert numbers.count(1) > 15 // STRIDE, "the steps before the commit"
    assert numbers.count(2) > 1, "the steps after it, which delete the old set"


def die_before(step):
    """Let this process be killed before it touches the file system for that time, from 0."""
    steps = iter(range(step + 1))

    def count(event, _):
        if event in ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir") and next(steps) == step:
            os.kill(os.getpid(), signal.SIGKILL)

    os.fsync = lambda _: None  # the machine keeps running
    sys.addaudithook(count)


def full_disk_at(monkeypatch, function, step):
    """Let that call of a function of os, from 0, find the disk full."""
    real, steps = getattr(os, function), iter(range(step + 1))

    def call(*arguments, **keywords):
        if next(steps, None) == step:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(*arguments, **keywords)

    monkeypatch.setattr(os, function, call)


FULL = r"No space left on device\): free disk space, or make the folder writable; the previous"
FLUSHES = 12  # of the disk while a set is saved; the last one follows the commit


def test_disk_failure_keeps_old_set_until_commit(session, monkeypatch):
    save_fingerprints(session, numbered(1))
    for step in range(FLUSHES - 1):
        with monkeypatch.context() as patched:
            full_disk_at(patched, "fsync", step)
            with pytest.raises(SessionError, match=FULL):
                save_fingerprints(session, numbered(2))
        assert number_of(load_fingerprints(session)) == 1
        assert names_in(session / "fingerprints") == [".lock", "000001"]


def test_disk_failure_after_commit_reports_new_set(session, monkeypatch):
    save_fingerprints(session, numbered(1))
    full_disk_at(monkeypatch, "fsync", FLUSHES - 1)
    with pytest.raises(SessionError, match=r"000002 was written, but may be lost in a power failure \(No space left"):
        save_fingerprints(session, numbered(2))
    assert number_of(load_fingerprints(session)) == 2


def test_too_large_file_is_not_saved(session, monkeypatch):
    save_fingerprints(session, numbered(1))
    for kind, remedy in (("", "fewer fingerprints"), ("_MODEL", "smaller model"), ("_FINGERPRINT", "fewer views")):
        with monkeypatch.context() as patched:
            patched.setattr(fingerprints, f"{kind}_READER", replace(fingerprints._READER, limit=10))
            with pytest.raises(SessionError, match=rf"bytes, at most 10 are allowed: .*{remedy}"):
                save_fingerprints(session, numbered(2))
    assert number_of(load_fingerprints(session)) == 1


def test_damaged_newest_set_has_no_fallback(session):
    old = save_fingerprints(session, numbered(1))
    kept = session / "kept"
    shutil.copytree(old, kept)
    new = save_fingerprints(session, numbered(2))
    kept.rename(old)
    (new / "set.yaml").unlink()
    with pytest.raises(CorruptFileError, match=r"000002/set.yaml is missing"):
        load_fingerprints(session)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("version", 1, "version is 1, but this package reads version 2 only: .* or fingerprint the session again"),
        ("created", "yesterday", "invalid created 'yesterday'"),
        ("names", ["../x"], "one of names is '../x'"),
        ("names", ["object-1", "object-1"], "duplicate fingerprint name in object-1, object-1"),
    ],
)
def test_invalid_set_with_valid_checksum_is_rejected(session, field, value, message):
    path = save_fingerprints(session, make_set()) / "set.yaml"
    content = yaml.safe_load(path.read_text())
    del content["sha256"]
    write_checksummed(path, {**content, field: value})
    with pytest.raises(CorruptFileError, match=rf"set.yaml: {message}"):
        load_fingerprints(session)


@pytest.mark.parametrize(
    ("tensors", "facts", "message"),
    [
        ({"centre": torch.zeros(3)}, {}, "object-1: centre is float32"),
        ({"latent_stds": None}, {}, "latent_stds is missing"),
        ({"more": torch.zeros(1)}, {}, "array 'more' is unknown"),
        ({}, {"name": "object-2"}, "name is 'object-2': expected 'object-1'"),
        ({}, {"importance": 2.0}, "object-1: importance 2.0"),
    ],
)
def test_invalid_fingerprint_with_valid_checksum_is_rejected(session, tensors, facts, message):
    path = save_fingerprints(session, make_set()) / "object-1" / "fingerprint.safetensors"
    stored, stored_facts = read_tensors(path, "fingerprint")
    changed = {name: tensor for name, tensor in {**stored, **tensors}.items() if tensor is not None}
    write_tensors(path, "fingerprint", changed, {**stored_facts, **facts})
    with pytest.raises(CorruptFileError, match=rf"fingerprint.safetensors: {message}"):
        load_fingerprints(session)


def test_set_of_other_model_is_rejected(session):
    save_fingerprints(session, make_set())
    write_stored_config(session / "config.yaml", replace(CONFIG, model=replace(CONFIG.model, latent_size=5)))
    with pytest.raises(CorruptFileError, match=r"set.yaml: object-1: made with 2 latents but"):
        load_fingerprints(session)


@pytest.mark.parametrize("name", ["", "000001", "000001/object-1"])
def test_folder_link_out_of_session_is_rejected(session, tmp_path, name):
    save_fingerprints(session, make_set())
    path = session / "fingerprints" / name
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(
        SessionError, match=rf"^{path}\S* leads out of {session}, to \S+: replace the link by what it refers to$"
    ):
        load_fingerprints(session)


def test_nothing_is_written_or_deleted_through_a_link(session, tmp_path):
    generation = save_fingerprints(session, numbered(1))
    generation.rename(tmp_path / "elsewhere")
    generation.symlink_to(tmp_path / "elsewhere")
    save_fingerprints(session, numbered(2))
    assert "set.yaml" in names_in(tmp_path / "elsewhere")
    assert names_in(session / "fingerprints") == [".lock", "000002"]

    (session / "fingerprints").rename(tmp_path / "other")
    (session / "fingerprints").symlink_to(tmp_path / "other")
    with pytest.raises(SessionError, match=r"leads out of"):
        save_fingerprints(session, numbered(3))
    assert names_in(tmp_path / "other") == [".lock", "000002"]


def test_session_behind_a_link_is_accepted(session, tmp_path):
    (tmp_path / "link").symlink_to(session)
    save_fingerprints(tmp_path / "link", numbered(1))
    assert number_of(load_fingerprints(tmp_path / "link")) == 1
    assert number_of(load_fingerprints(session)) == 1


def test_generations_continue_after_six_digits(session):
    folder = session / "fingerprints"
    save_fingerprints(session, numbered(1)).rename(folder / "999999")
    shutil.copytree(folder / "999999", session / "kept")
    assert save_fingerprints(session, numbered(2)).name == "1000000"
    (session / "kept").rename(folder / "999999")
    assert number_of(load_fingerprints(session)) == 2


def test_blanks_keep_their_order(session):
    order = ("blank-1", "object-2", "object-1")
    found = tuple(make_fingerprint(name=name, kind=BLANK, importance=0.0) for name in order)
    save_fingerprints(session, make_set(fingerprints=found))
    assert tuple(fingerprint.name for fingerprint in load_fingerprints(session).fingerprints) == order
