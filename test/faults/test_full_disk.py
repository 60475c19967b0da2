"""A full or read-only disk: a clear error, and everything that was acknowledged before loads."""

from __future__ import annotations

import contextlib
import re
import shutil
import subprocess
from contextlib import ExitStack
from dataclasses import replace

import genpy
import numpy as np
import pytest
import rosbag
from std_msgs.msg import String

from embodied_active_learning.errors import BagError, SessionError
from embodied_active_learning.figures.fingerprint_sheet import draw_fingerprints
from embodied_active_learning.objects.identification import Identification
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.ros.bags.writer import BagWriter
from embodied_active_learning.session import disk as disk_module
from embodied_active_learning.session import lock
from embodied_active_learning.session.atomic import is_leftover
from embodied_active_learning.session.checkpoints import load_latest, save_checkpoint, save_model
from embodied_active_learning.session.conclusion import summarise
from embodied_active_learning.session.disk import free_bytes
from embodied_active_learning.session.fingerprints import load_fingerprints, save_fingerprints
from embodied_active_learning.session.identifications import load_identification, save_identification
from embodied_active_learning.session.observations import ObservationStore
from embodied_active_learning.session.session import Session, check_session
from embodied_active_learning.session.summary import read_summary, write_summary
from sample_session import KINDS, NAME, configuration, fingerprints, make_sample, network, observation
from small_disk import SmallDisk, enter_own_mounts

STORED = [kind for kind in KINDS if not kind.path.startswith("user")]


@pytest.fixture(scope="module")
def own_mounts():
    enter_own_mounts()


@pytest.fixture
def small_disk(own_mounts, tmp_path, monkeypatch, request):
    made = SmallDisk(tmp_path / "disk", kilobytes=getattr(request, "param", 600))
    monkeypatch.setattr(disk_module, "SPARE_BYTES", 0)
    yield made
    made.remove()


@pytest.fixture
def sample(small_disk):
    return make_sample(small_disk.folder)


def contents(path):
    return {kind.path: kind.read(path) for kind in STORED}


def leftovers(path):
    return [entry.name for entry in path.rglob("*") if is_leftover(entry.name)]


def write_checkpoint(session):
    tensors = {f"network/{name}": tensor for name, tensor in network(session.config).state_dict().items()}
    save_checkpoint(session.paths.checkpoints, 7, 4, tensors, {"updates": 7})


def write_model(session):
    save_model(session.paths.model, network(session.config).state_dict(), {"updates": 7, "observations": 4})


def write_fingerprints(session):
    save_fingerprints(session.paths.path, fingerprints(session.config, number=7))


def write_identification(session):
    config = session.config
    search = Identification([fingerprints(config)], config.workspace.box(), config.camera, config.identification)
    _, _, state, image = observation(9)
    search.observe(state[None], image[None])
    save_identification(session.paths.path, "second", search, search.decide(state[None], image[None]))


def write_figure(session):
    found = fingerprints(session.config)
    draw_fingerprints(session.paths.figures / "fingerprints.png", found, [])


def write_end(session):
    write_summary(session.paths.summary, summarise(session, True, 99.0))


KEPT = {
    write_checkpoint: "the previous file is kept",
    write_model: "the previous file is kept",
    write_fingerprints: "free disk space, or make the folder writable; the previous one is kept",
    write_identification: "free disk space, or make the folder writable; the previous one is kept",
    write_figure: "",
    write_end: "the previous file is kept",
}
WRITERS = list(KEPT)


def refusal_of(write, session):
    """Return the error message of writing; empty if it succeeds."""
    try:
        write(session)
    except SessionError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("leave", [0, 4096])
@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_full_disk_keeps_previous_files(small_disk, sample, write, leave):
    session, before = Session.open_read_only(sample), contents(sample)
    small_disk.fill(leave)
    refusal = refusal_of(write, session)
    assert leave or refusal  # a small file fits into one block
    if refusal:
        assert "No space left on device" in refusal
        assert KEPT[write] in refusal
        assert contents(sample) == before
    assert leftovers(sample) == []
    small_disk.free()
    write(session)


def test_observations_and_rows_survive_full_disk(small_disk):
    config = configuration(small_disk.folder)
    with ExitStack() as held:
        session = held.enter_context(Session.open_for_writing(config))
        store = held.enter_context(session.open_observations())
        table = held.enter_context(session.open_table("exploration"))
        small_disk.fill(leave=16384)
        stored = count_until_refused(
            lambda number: store.append(*observation(number)),
            r"record \d+ could not be stored \(No space left on device\): free disk space",
        )
        rows = count_until_refused(
            lambda number: table.append({"step": number, "x": 1 / 3}),
            r"exploration.csv cannot be written \(No space left on device\): free disk space",
        )
        assert 0 < stored < 200
        assert 0 < rows < 2000
        assert "No space left on device" in refusal_of(lambda _: store.append(*observation(stored)), session)
        small_disk.free()
        store.append(*observation(stored))
        table.append({"step": rows})
        small_disk.fill()
    reader = Session.open_read_only(small_disk.folder / NAME)
    with reader.open_observations() as seen:
        assert len(seen) == stored + 1
        assert all(np.array_equal(seen.images[index], observation(index)[3]) for index in range(stored + 1))
    assert reader.read_table("exploration")["step"].tolist() == list(range(rows + 1))


def count_until_refused(append, message):
    """Return how many can be appended before an error."""
    for number in range(10_000):
        refusal = refusal_of(append, number)
        if refusal:
            assert re.search(message, refusal)
            return number
    raise AssertionError("the disk was not full")


def test_training_resumes_after_full_disk(small_disk):
    config = configuration(small_disk.folder)
    config = replace(
        config,
        exploration=replace(config.exploration, steps=12),
        training=replace(config.training, checkpoint_every=5, evaluate_every=5),
    )
    with pytest.raises(SessionError, match="No space left on device"):
        train(config, on_update=lambda report: small_disk.fill() if report.update == 12 else None)
    last = load_latest(small_disk.folder / NAME / "checkpoints")
    assert last.updates >= 10
    assert last.refused == ()
    assert leftovers(small_disk.folder) == []

    small_disk.free()
    resumed = replace(config, session=replace(config.session, resume=True))
    assert train(resumed) == config.update_plan.total
    with Session.open_read_only(small_disk.folder / NAME).open_observations() as store:
        assert len(store) == 12
    assert contents_of_table(small_disk, "training") == list(range(1, config.update_plan.total + 1))


def train(config, on_update=lambda report: None):
    """Make all updates of a run whose observations come at once; return their number."""
    run = TrainingRun(config)
    try:
        for index in range(config.exploration.steps):
            run.observe(*observation(index))
        run.train(on_update, run.stop)
        return run.updates
    finally:
        run.close()


def contents_of_table(small_disk, name):
    return Session.open_read_only(small_disk.folder / NAME).read_table(name)["update"].tolist()


def test_new_session_on_full_disk_is_rejected(small_disk):
    small_disk.fill()
    for attempt in (check_session, Session.open_for_writing):
        with pytest.raises(SessionError, match=r"needs about .* but 0.0 GB are free: free disk space"):
            attempt(configuration(small_disk.folder))
    assert [entry.name for entry in small_disk.folder.iterdir()] == ["filler"]


def test_session_creation_can_be_retried_after_full_disk(small_disk, monkeypatch):
    monkeypatch.setattr(disk_module, "free_bytes", lambda path: 10**12)
    small_disk.fill()
    with pytest.raises(SessionError, match="No space left on device"):
        Session.open_for_writing(configuration(small_disk.folder))
    small_disk.free()
    Session.open_for_writing(configuration(small_disk.folder)).close()
    assert leftovers(small_disk.folder) == []


def test_exhausted_inodes_keep_previous_files(small_disk, sample):
    session, before = Session.open_read_only(sample), contents(sample)
    with contextlib.suppress(OSError):
        for number in range(1000):
            (small_disk.folder / f"file-{number}").touch()
    for write in (write_checkpoint, write_fingerprints, write_identification, write_figure, write_end):
        with pytest.raises(SessionError, match="No space left on device"):
            write(session)
    assert contents(sample) == before
    assert leftovers(sample) == []


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_read_only_disk_is_unchanged(small_disk, sample, write):
    session, before = Session.open_read_only(sample), contents(sample)
    small_disk.set_writable(False)
    with pytest.raises(SessionError, match="Read-only file system"):
        write(session)
    assert contents(sample) == before


def test_run_on_read_only_disk_is_rejected(small_disk, sample):
    small_disk.set_writable(False)
    folder = small_disk.folder
    for config in (
        configuration(folder, resume=True),
        configuration(folder, name="new"),
        configuration(folder / "deeper" / "root", name="new"),
    ):
        for attempt in (check_session, Session.open_for_writing):
            with pytest.raises(SessionError, match="is mounted read-only: fix that, or choose another session/root"):
                attempt(config)
    assert read_summary(sample / "summary.yaml").finished


def test_growing_files_on_read_only_disk_are_named(small_disk, sample):
    session, before = Session.open_read_only(sample), contents(sample)
    box = session.config.workspace.box()
    small_disk.set_writable(False)
    for name, attempt in (
        ("observations.bin", lambda: ObservationStore.open_for_writing(session.paths.observations, box, (12, 12, 3))),
        ("training.csv", lambda: session.open_table("training")),
        (".lock", lambda: lock.acquire(session.paths.lock)),
    ):
        with pytest.raises(SessionError, match=rf"{name} cannot be .* \(Read-only file system\)"):
            attempt()
    assert contents(sample) == before


def test_free_space_of_missing_folder_is_known(small_disk):
    assert free_bytes(small_disk.folder / "not" / "yet") == free_bytes(small_disk.folder) > 500_000
    small_disk.fill()
    assert free_bytes(small_disk.folder) == 0


def test_results_load_from_full_disk(small_disk, sample):
    small_disk.fill()
    assert load_fingerprints(sample).fingerprints
    assert load_identification(sample, "first").decisions


def record(bag, messages):
    """Messages of 5 kB, one a second from second 1 on."""
    for second in range(1, messages + 1):
        bag.write("/told", String("x" * 5000), genpy.Time(second))


@pytest.mark.parametrize("small_disk", [3000], indirect=True)  # kB, some of the chunks in which rosbag writes
def test_bag_of_full_disk_is_recoverable(small_disk, tmp_path):
    bag = BagWriter(small_disk.folder / "run.bag")
    with pytest.raises(BagError, match=r"cannot write .*run\.bag\.active: No space left"):
        record(bag, 1000)
    written = bag.messages
    record(bag, 1)
    bag.close()
    assert bag.messages == written
    [left] = small_disk.folder.iterdir()
    saved = shutil.copy(str(left), str(tmp_path))
    subprocess.run(["rosbag", "reindex", "--quiet", saved], check=True)
    with rosbag.Bag(saved) as found:
        seconds = [time.secs for _, _, time in found.read_messages("/told")]
    assert seconds == list(range(1, len(seconds) + 1))
    assert len(seconds) > written // 2
