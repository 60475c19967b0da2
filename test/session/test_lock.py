"""Locks of sessions and their files, on file systems and beside processes that do not make it easy."""

from __future__ import annotations

import errno
import fcntl
import os
from types import SimpleNamespace

import pytest

from embodied_active_learning.errors import SessionError
from embodied_active_learning.session import lock


def claim(path):
    with path.open("r+b") as stream:
        lock.claim(stream, path)


@pytest.mark.parametrize("attempt", [lock.acquire, lock.holder, claim])
@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EACCES])
def test_lock_failure_names_file_and_reason(tmp_path, monkeypatch, attempt, code):
    path = tmp_path / "file"
    path.touch()

    def flock(descriptor, kind):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(SessionError, match=rf"{path} cannot be locked \({os.strerror(code)}\)"):
        attempt(path)


def test_unopenable_lock_file_is_named(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)  # opening it would wait for a writer for ever
    for attempt in (lock.acquire, lock.holder):
        for path, kind in ((tmp_path, "folder"), (pipe, "named pipe")):
            with pytest.raises(SessionError, match=rf"{path} cannot be locked \(it is a {kind}\)"):
                attempt(path)


def test_missing_lock_file_has_no_holder(tmp_path):
    (tmp_path / "file").touch()
    assert lock.holder(tmp_path / "missing" / ".lock") is None
    assert lock.holder(tmp_path / "file" / ".lock") is None


def test_query_of_holder_does_not_block_opening(tmp_path, monkeypatch):
    path = tmp_path / ".lock"
    path.touch()
    asking = path.open("rb")
    fcntl.flock(asking.fileno(), fcntl.LOCK_SH)
    monkeypatch.setattr(lock, "time", SimpleNamespace(sleep=lambda seconds: asking.close()))
    lock.acquire(path).close()
    assert asking.closed


def test_session_in_use_is_reported_quickly(tmp_path, monkeypatch):
    path, pauses = tmp_path / ".lock", []
    monkeypatch.setattr(lock, "time", SimpleNamespace(sleep=pauses.append))
    with lock.acquire(path):
        with pytest.raises(SessionError, match=f"in use by process {os.getpid()} on"):
            lock.acquire(path)
        assert 0.0 < sum(pauses) < 0.5
    lock.acquire(path).close()
