"""Stored identifications: a new one replaces an earlier one of its name completely, or not at all."""

from __future__ import annotations

import errno
import os

import pytest

from embodied_active_learning.errors import SessionError
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.session import atomic, identifications
from embodied_active_learning.session.identifications import load_identification, save_identification
from embodied_active_learning.session.session import Session
from sample_session import fingerprints, make_sample, observation


@pytest.fixture
def session(tmp_path):
    """A session with the identification "first", which has a figure."""
    path = make_sample(tmp_path)
    (path / "identification" / "first" / "evidence.png").write_bytes(b"figure")
    return Session.open_read_only(path)


def save_again(session):
    """Replace the identification with one of a single image."""
    config = session.config
    search = Identification([fingerprints(config)], config.workspace.box(), config.camera, config.identification)
    _, _, state, image = observation(9)
    search.observe(state[None], image[None])
    return save_identification(session.paths.path, "first", search, search.decide(state[None], image[None]))


def files_below(folder):
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def fail(*arguments):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_later_identification_replaces_the_first(session):
    folder = save_again(session)
    assert load_identification(session.paths.path, "first").images == 1
    assert not (folder / "evidence.png").exists()
    assert [path.name for path in session.paths.identification.iterdir()] == ["first"]


@pytest.mark.parametrize("write", ["write_finite_arrays", "write_text"])
def test_failed_write_keeps_previous_identification(session, monkeypatch, write):
    before = files_below(session.paths.identification)
    monkeypatch.setattr(identifications, write, fail)
    with pytest.raises(SessionError, match=r"first cannot be written \(No space left .* previous one is kept"):
        save_again(session)
    assert files_below(session.paths.identification) == before


def test_failed_rename_restores_previous_folder(tmp_path, monkeypatch):
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "old").touch()
    rename = os.replace

    def fail_for_new_folder(source, target):
        if (target, source.name.count("previous")) == (folder, 0):
            fail()
        rename(source, target)

    monkeypatch.setattr(atomic.os, "replace", fail_for_new_folder)
    with pytest.raises(SessionError, match="results cannot be written"), atomic.replace_folder(folder) as new:
        (new / "new").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["results", "old"]


def test_tables_have_headers_also_without_rows(session):
    folder = session.paths.identification / "first"
    save_again(session)
    assert (folder / "unknown.csv").read_text().splitlines()[0] == "x,y,area"
    assert (folder / "decisions.csv").read_text().startswith("session,fingerprint,")
