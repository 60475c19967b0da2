"""kill -9 at any moment: everything that was acknowledged is complete, and partly written files are removed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import killed_writer
from embodied_active_learning.session.atomic import is_leftover
from embodied_active_learning.session.checkpoints import load_latest, load_model, save_checkpoint
from embodied_active_learning.session.fingerprints import load_fingerprints, save_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.summary import read_summary
from killed_writer import PARTS
from sample_session import NAME, configuration, fingerprints, observation

ROUNDS = 40
DEATHS = 12  # of each part, at different bytes
MAX_FILES = 13  # that a writer finishes before it is killed: two of each kind
MAX_LEAVE = 0.01  # s that it then still has, in the middle of what comes next
# Bytes of what is written of each part, as far as they are of interest. A row is written by one call of the kernel.
LARGEST = {
    "config": 2500, "observation": 476, "checkpoint": 3000, "model": 2900, "fingerprints": 3000,
    "summary": 250,
}  # fmt: skip
SCRIPT = Path(killed_writer.__file__)


class Writers:
    """Short-lived writers, and what they reported as written."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        command = [sys.executable, str(SCRIPT)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, env=environment
        )
        self._expect("ready")

    def begin_at(self, root: Path) -> None:
        """Write below another folder from now on."""
        self._root = root
        self.acknowledged = {part: set() for part in PARTS}

    def live(self, files: int, leave: float) -> None:
        """Let a writer write a number of files, wait for some seconds, and kill it."""
        child = self._begin()
        for _ in range(files):
            assert self._note(*self._read()), "the writer ended before it was killed"
        time.sleep(leave)  # so that it is killed in the middle of a write
        os.kill(child, signal.SIGKILL)
        while self._note(*self._read()):
            pass

    def die_at_byte(self, part: str, byte: int) -> bool:
        """Let a writer write a part until it exceeds a byte of a file; return whether that killed it."""
        self._begin(part, str(byte))
        finished = False
        while self._note(*self._read()):
            finished = True
        return not finished

    def _begin(self, *wish: str) -> int:
        self._process.stdin.write(" ".join((str(self._root), *wish)) + "\n")
        self._process.stdin.flush()
        return self._expect("writer")

    def _note(self, what: str, number: int) -> bool:
        """Record an acknowledgement; return whether the line was one."""
        if what != "ended":
            self.acknowledged[what].add(number)
        return what != "ended"

    def close(self) -> None:
        """End the process that forks them."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _expect(self, what: str) -> int:
        part, number = self._read()
        assert part == what
        return number

    def _read(self):
        what, number = self._process.stdout.readline().split()
        return what, int(number)


@pytest.fixture(scope="module")
def forked():
    made = Writers()
    yield made
    made.close()


@pytest.fixture
def writers(forked, tmp_path):
    forked.begin_at(tmp_path)
    return forked


def test_acknowledged_data_survives_sigkill(tmp_path, writers):
    moments = random.Random(5)
    for _ in range(ROUNDS):
        writers.live(moments.randrange(MAX_FILES), moments.uniform(0.0, MAX_LEAVE))
        check(tmp_path / NAME, writers.acknowledged)
    assert all(len(numbers) > 10 for numbers in writers.acknowledged.values())
    open_and_write_everything(tmp_path)
    assert [path for path in tmp_path.rglob("*") if is_leftover(path.name)] == []


@pytest.mark.parametrize("part", LARGEST)
def test_file_is_old_or_new_after_death_at_any_byte(tmp_path, writers, part):
    writers.live(len(PARTS), leave=0.0)
    store = tmp_path / NAME / "observations" / "observations.bin"
    bytes_, deaths = random.Random(6), 0
    for _ in range(DEATHS):
        begin = store.stat().st_size if part == "observation" else 0
        deaths += writers.die_at_byte(part, begin + bytes_.randrange(LARGEST[part]))
        check(tmp_path / NAME, writers.acknowledged)
    assert deaths > DEATHS // 2
    writers.live(2 * len(PARTS), leave=0.0)
    check(tmp_path / NAME, writers.acknowledged)
    open_and_write_everything(tmp_path)
    assert [path for path in tmp_path.rglob("*") if is_leftover(path.name)] == []


def check(path, acknowledged):
    """Check that every part is complete and at least as new as was acknowledged."""
    if not (path / "config.yaml").exists():
        assert not any(acknowledged.values())
        return
    session = Session.open_read_only(path)
    newest = {part: max(numbers, default=-1) for part, numbers in acknowledged.items()}
    if newest["observation"] >= 0:
        with session.open_observations() as store:
            assert len(store) > newest["observation"]
            assert all(np.array_equal(image, observation(index)[3]) for index, image in enumerate(store.images))
    rows = session.read_table("training")
    assert acknowledged["row"] <= set(rows["update"].tolist())
    np.testing.assert_array_equal(rows["loss"], rows["update"] / 7)
    if newest["checkpoint"] >= 0:
        checkpoint = load_latest(session.paths.checkpoints)
        number = checkpoint.counters["number"]
        assert number >= newest["checkpoint"]
        assert checkpoint.refused == ()
        assert all((tensor == number).all() for tensor in checkpoint.tensors.values())
    if newest["model"] >= 0:
        tensors, facts = load_model(session.paths.model)
        assert facts["updates"] >= newest["model"]
        assert all((tensor == facts["updates"]).all() for tensor in tensors.values())
    if newest["fingerprints"] >= 0:
        found = load_fingerprints(path)
        assert found.updates >= newest["fingerprints"]
        expected = fingerprints(session.config, found.updates).fingerprints[0]
        assert np.array_equal(found.fingerprints[0].images, expected.images)
    if session.paths.summary.exists():  # it is deleted when a run resumes
        read_summary(session.paths.summary)


def open_and_write_everything(root):
    """Do what the next run does, which removes partly written files."""
    with Session.open_for_writing(configuration(root, resume=True)) as session:
        last = load_latest(session.paths.checkpoints)
        save_checkpoint(session.paths.checkpoints, last.updates + 1, last.observations, last.tensors, last.counters)
        save_fingerprints(session.paths.path, fingerprints(session.config))
