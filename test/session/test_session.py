"""A session folder: one writer, no overwriting, no surprises when it is continued."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import yaml

from embodied_active_learning import __version__
from embodied_active_learning.config import CONFIG_VERSION, Config, merge
from embodied_active_learning.errors import CorruptFileError, SessionError
from embodied_active_learning.session import disk
from embodied_active_learning.session.checksummed_yaml import checksummed_text, write_checksummed
from embodied_active_learning.session.conclusion import conclude_launch, summarise
from embodied_active_learning.session.session import Session, check_session, list_sessions
from embodied_active_learning.session.summary import Summary, read_summary, write_summary

MAX_PROCESS_ID = 2**22  # that Linux gives a number to
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def make_config(root, name="a", resume=False, **sections):
    values = {
        "session": {"root": str(root), "name": name, "resume": resume},
        "camera": {"width": 45, "height": 45},
        "exploration": {"steps": 100},
    }
    return Config.from_dict(merge(values, sections))


def create(root, **keywords):
    Session.open_for_writing(make_config(root, **keywords)).close()


def files_below(folder):
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_new_session_stores_config_and_version(tmp_path):
    config = make_config(tmp_path)
    with Session.open_for_writing(config) as session:
        assert session.writable
        stored = yaml.safe_load(session.paths.config.read_text())
    assert stored["package_version"] == __version__
    assert Config.from_dict(stored["config"]) == config
    reader = Session.open_read_only(tmp_path / "a")
    assert (reader.name, reader.config, reader.writable) == ("a", config, False)


def test_running_session_is_readable(tmp_path):
    image = np.full((45, 45, 3), 3, np.uint8)
    with Session.open_for_writing(make_config(tmp_path)) as session, session.open_observations() as store:
        store.append(0, 0.0, (0.4, 0.0, 0.0), image)
        with session.open_table("exploration") as table:
            table.append({"step": 0, "x": 0.4})
            reader = Session.open_read_only(tmp_path / "a")
            with reader.open_observations() as seen:
                np.testing.assert_array_equal(seen.images, [image])
            assert reader.read_table("exploration")["x"].tolist() == [0.4]
            assert len(reader.read_table("training")["loss"]) == 0


def test_existing_session_is_not_overwritten(tmp_path):
    create(tmp_path)
    before = files_below(tmp_path)
    for attempt in (check_session, Session.open_for_writing):
        with pytest.raises(SessionError, match=r"exists: choose another session/name .* \(learn\.launch or"):
            attempt(make_config(tmp_path))
    assert files_below(tmp_path) == before


def test_resumed_session_may_become_longer(tmp_path):
    create(tmp_path)
    with Session.open_for_writing(make_config(tmp_path, resume=True, exploration={"steps": 200})):
        pass
    assert Session.open_read_only(tmp_path / "a").config.exploration.steps == 200


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("workspace", "x", [0.3, 0.6]),
        ("camera", "width", 60),
        ("camera", "distance", 0.4),
        ("model", "latent_size", 8),
        ("model", "hidden_sizes", [64, 32]),
        ("simulation", "world", "right"),
        ("exploration", "explorer", "random_walk"),
        ("exploration", "seed", 3),
    ],
)
def test_resume_with_incompatible_config_is_rejected(tmp_path, section, key, value):
    create(tmp_path)
    config = make_config(tmp_path, resume=True, **{section: {key: value}})
    with pytest.raises(SessionError, match=f"cannot be continued: {section}/{key} is .* but the session has"):
        check_session(config)


def test_resume_with_moved_world_is_accepted(tmp_path):
    create(tmp_path, simulation={"world": "/old/worlds/right.yaml"})
    check_session(make_config(tmp_path, resume=True, simulation={"world": "/new/worlds/right.yaml"}))


def test_resume_of_missing_session_lists_sessions(tmp_path):
    create(tmp_path, name="first")
    with pytest.raises(SessionError, match=r"there is no session b in .*: known are first"):
        check_session(make_config(tmp_path, name="b", resume=True))


def test_check_creates_nothing(tmp_path):
    check_session(make_config(tmp_path / "root"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["notes.txt", "config.yaml"])
def test_foreign_folder_is_rejected_untouched(tmp_path, name):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / name).write_text("mine: true\n")
    before = files_below(tmp_path)
    for resume in (False, True):
        with pytest.raises(SessionError, match="choose another"):
            Session.open_for_writing(make_config(tmp_path, resume=resume))
    assert files_below(tmp_path) == before


def test_file_or_link_as_session_is_rejected(tmp_path):
    (tmp_path / "a").write_text("file")
    create(tmp_path, name="target")
    (tmp_path / "b").symlink_to(tmp_path / "target")
    (tmp_path / "c").symlink_to(tmp_path / "nowhere")
    for name, message in (("a", "is not a session"), ("b", "b is a symbolic link"), ("c", "c is a symbolic link")):
        with pytest.raises(SessionError, match=message):
            Session.open_for_writing(make_config(tmp_path, name=name, resume=True))


def test_unusable_root_is_rejected(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SessionError, match="choose another session/root"):
        check_session(make_config(tmp_path / "file" / "root"))


def test_half_created_session_is_taken_over(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / ".lock").write_text("process 1 on elsewhere")
    leftover = tmp_path / "a" / f".config.yaml.{MAX_PROCESS_ID + 1}.2.tmp"
    beside = tmp_path / "a" / f".planner.safetensors.{os.getppid()}.2.tmp"
    for path in (leftover, beside):
        path.write_text("half")
    create(tmp_path)
    assert not leftover.exists()
    assert beside.exists(), "its writer still runs"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *(
            (
                {"version": version},
                rf"version is {version}, but this package reads version {CONFIG_VERSION} only: use the version of "
                "embodied_active_learning that wrote it; otherwise restore it, or choose another session",
            )
            for version in (CONFIG_VERSION - 1, CONFIG_VERSION + 1)
        ),
        ({"format": None}, "format is None: expected"),
        ({"config": {"camera": {"width": -3}}}, "camera/width is -3"),
        (
            {"config": {"camera": {"widht": 3}}},
            "did you mean camera/width.* written by embodied_active_learning 0",
        ),
        ({"config": None}, "the content is None"),
    ],
)
def test_invalid_description_names_file_and_field(tmp_path, change, message):
    create(tmp_path)
    path = tmp_path / "a" / "config.yaml"
    content = yaml.safe_load(path.read_text())
    del content["sha256"]
    write_checksummed(path, {**content, **change})
    with pytest.raises(CorruptFileError, match=f"config.yaml: .*{message}"):
        Session.open_read_only(tmp_path / "a")
    assert list_sessions(tmp_path) == []


HOLDER = """
import sys, yaml
from embodied_active_learning.config import Config
from embodied_active_learning.session.session import Session
session = Session.open_for_writing(Config.from_dict(yaml.safe_load(sys.argv[1])))
print("held", flush=True)
sys.stdin.read()
"""


def test_session_in_use_names_holder_until_sigkill(tmp_path):
    text = yaml.safe_dump(make_config(tmp_path).to_dict())
    command = [sys.executable, "-c", HOLDER, text]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT) as child:
        assert child.stdout.readline() == "held\n"
        again = make_config(tmp_path, resume=True)
        for attempt in (check_session, Session.open_for_writing):
            with pytest.raises(SessionError, match=f"in use by process {child.pid} on "):
                attempt(again)
        child.send_signal(signal.SIGKILL)
        child.wait()
        Session.open_for_writing(again).close()


def test_run_larger_than_disk_is_rejected(tmp_path, monkeypatch):
    config = make_config(tmp_path)
    usage = disk.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda path: usage._replace(free=1000))
    with pytest.raises(SessionError, match=r"needs about 0.2 GB for 100 observations .* 0.0 GB are free: free"):
        check_session(config)


def test_space_estimate_of_default_run():
    # 3000 images of 97,200 bytes; 4.3 million weights of 4 bytes, in each of 3 checkpoints with two moments and the
    # weights of the model before, and once in the model.
    assert disk.estimate_bytes(Config()) == pytest.approx(3000 * 97_200 + 13 * 4 * 4.3e6, rel=0.1)


def test_space_of_stored_data_is_subtracted(tmp_path, monkeypatch):
    config = make_config(tmp_path)
    usage = disk.shutil.disk_usage(tmp_path)
    free = disk.SPARE_BYTES + disk.estimate_bytes(config) - 500
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda path: usage._replace(free=free))
    disk.check_space(tmp_path, config, stored_bytes=501)
    with pytest.raises(SessionError, match="needs about"):
        disk.check_space(tmp_path, config, stored_bytes=499)


def test_only_sessions_are_listed(tmp_path):
    assert list_sessions(tmp_path / "missing") == []
    for name in ("b", "a"):
        create(tmp_path, name=name)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "config.yaml").write_text("something: else\n")
    assert [path.name for path in list_sessions(tmp_path)] == ["a", "b"]


def test_summary_has_the_last_values_of_the_tables(tmp_path):
    with Session.open_for_writing(make_config(tmp_path)) as session:
        with session.open_table("exploration") as table:
            for step in range(1, 5):
                table.append({"step": step, "ergodic_measure": 1.0 / step, "distance": 0.1 * step, "coverage": 0.5})
        with session.open_table("training") as table:
            table.append({"update": 12})
        with session.open_table("evaluation") as table:
            table.append({"update": 10, "active_units": 16, "mse_own": 0.001, "mse_shuffled": 0.02})
        expected = Summary(
            finished=True,
            steps=4,
            updates=12,
            wall_time=3.5,
            active_units=16,
            ergodic_measure=0.25,
            coverage=0.5,
            distance=pytest.approx(0.4),
            mse_own=0.001,
            mse_shuffled=0.02,
            mse_none=None,
            verdict="not evaluated: the run has no evaluation yet; finish it, or lower training/evaluate_every",
        )
        write_summary(session.paths.summary, summarise(session, finished=True, wall_time=3.5))
        assert read_summary(session.paths.summary) == expected


def write_finished_summary(config):
    with Session.open_for_writing(config) as session:
        with session.open_table("exploration") as table:
            for step in range(1, config.exploration.steps + 1):
                table.append({"step": step})
        with session.open_table("training") as table:
            table.append({"update": config.update_plan.total})
        conclude_launch(session, finished=True, wall_time=3.5)
    return session.paths.summary


def test_finished_summary_survives_resuming_a_finished_run(tmp_path):
    """A respawned trainer opens the session again after the end of the run."""
    path = write_finished_summary(make_config(tmp_path))
    content = path.read_bytes()
    Session.open_for_writing(make_config(tmp_path, resume=True)).close()
    assert path.read_bytes() == content


def test_summary_is_unfinished_while_a_run_is_extended(tmp_path):
    config = make_config(tmp_path)
    path = write_finished_summary(config)
    more = {"exploration": {"steps": config.exploration.steps + 1}}
    with Session.open_for_writing(
        Config.from_dict(merge(make_config(tmp_path, resume=True).to_dict(), more))
    ) as session:
        assert not read_summary(path).finished
        assert conclude_launch(session, finished=True, wall_time=2.0).wall_time == 5.5
    assert read_summary(path).wall_time == 5.5


def test_damaged_summary_is_removed_on_resume(tmp_path):
    path = write_finished_summary(make_config(tmp_path))
    path.write_text("finished: true\n")
    Session.open_for_writing(make_config(tmp_path, resume=True)).close()
    assert not path.exists()


def test_summary_counts_a_step_whose_row_was_lost(tmp_path):
    with Session.open_for_writing(make_config(tmp_path)) as session:
        with session.open_table("exploration") as table:
            for step in (1, 2, 4):
                table.append({"step": step})
        assert summarise(session, finished=False, wall_time=0.0).steps == 4


def test_summary_of_a_run_without_training_says_so(tmp_path):
    with Session.open_for_writing(make_config(tmp_path, training={"updates_per_observation": 0})) as session:
        assert summarise(session, finished=True, wall_time=0.0).verdict.startswith("images only")


def test_summary_of_empty_run_has_no_numbers(tmp_path):
    with Session.open_for_writing(make_config(tmp_path)) as session:
        summary = summarise(session, finished=False, wall_time=0.0)
    assert summary == Summary(finished=False, steps=0, updates=0, wall_time=0.0, verdict=summary.verdict)
    assert summary.verdict.startswith("not enough steps: no model update")
    write_summary(tmp_path / "summary.yaml", summary)
    assert read_summary(tmp_path / "summary.yaml") == summary


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", " is empty, expected fields"),
        ("[1]", " is a list, expected fields"),
        ("finished: true\n", ": sha256 is missing, so the end of the file was lost"),
        (checksummed_text({"finished": True}), ": steps is missing"),
        (checksummed_text({**vars(Summary(True, 1, 1, 1.0)), "other": 1}), ": unknown key other"),
    ],
)
def test_invalid_summary_is_rejected(tmp_path, text, complaint):
    path = tmp_path / "summary.yaml"
    path.write_text(text)
    with pytest.raises(CorruptFileError, match=f"summary.yaml{complaint}"):
        read_summary(path)


def test_summary_with_invalid_finished_is_rejected(tmp_path):
    path = tmp_path / "summary.yaml"
    write_summary(path, replace(Summary(True, 1, 1, 1.0), finished="yes"))
    with pytest.raises(CorruptFileError, match="finished is 'yes'"):
        read_summary(path)


def test_bags_do_not_count_as_stored_bytes(tmp_path):
    (tmp_path / "observations").mkdir()
    (tmp_path / "observations" / "observations.bin").write_bytes(bytes(300))
    (tmp_path / "bags").mkdir()
    (tmp_path / "bags" / "a.bag").write_bytes(bytes(5000))
    assert disk.folder_size(tmp_path) == 300
