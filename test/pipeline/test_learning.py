"""The Python API: learn, fingerprint and identify in one process, without ROS."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace

import genpy
import numpy as np
import pytest
import torch

import embodied_active_learning as eal
from embodied_active_learning.errors import ConfigError, CorruptFileError, ObservationError, SessionError
from embodied_active_learning.objects.stability import Measurement
from embodied_active_learning.pipeline import learning, stopping
from embodied_active_learning.pipeline.learning import learn, ros_seconds
from embodied_active_learning.session import lock
from embodied_active_learning.session.checkpoints import load_latest, load_model, save_checkpoint
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.stored_config import write_stored_config
from embodied_active_learning.session.summary import read_summary
from embodied_active_learning.simulation.world import find_world
from embodied_active_learning.sweep.run_records import load_record
from tiny import STEPS, TINY


def tiny(root, name="run", **overrides):
    return eal.load_config("", root=str(root), name=name, **{**TINY, **overrides})


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """A finished session, and the progress reports of its run."""
    reports = []
    session = learn(tiny(tmp_path_factory.mktemp("learned")), reports.append)
    return session, reports


def test_run_ends_with_model_and_summary(learned):
    session, _ = learned
    summary = read_summary(session.paths.summary)
    assert summary.finished
    assert (summary.steps, summary.updates) == (STEPS, 3 * STEPS)
    assert summary.wall_time > 0.0
    assert eal.load_model(session).latent_size == 2
    with session.open_observations() as store:
        assert len(store) == STEPS
        np.testing.assert_array_equal(session.read_table("exploration")["x"], store.raw_states[:, 0])


@pytest.mark.parametrize("setting", ["explorer", "measure"])
def test_unusable_explorer_or_measure_creates_no_session(tmp_path, setting):
    with pytest.raises(ConfigError, match="check PYTHONPATH"):
        learn(tiny(tmp_path, **{setting: "no_such_module:Thing"}))
    assert list(tmp_path.iterdir()) == []


def test_progress_is_reported_after_each_step(learned):
    _, reports = learned
    assert [report.step for report in reports[:STEPS]] == list(range(1, STEPS + 1))
    assert reports[STEPS - 1].updates_planned == 3 * STEPS
    assert reports[-1].share == pytest.approx(1.0)
    assert reports[-1].latent_contribution <= 1.0


def test_run_that_ends_early_is_a_shorter_run(tmp_path, monkeypatch):
    """It has the files of a run of that many steps, and an interrupted one ends after as many."""
    monkeypatch.setattr(stopping, "CHECK_EVERY", 2)
    found = Measurement(0, 0, np.array([[0.4, 0.0]]), 0, 5.0, 0.9, 0.9)
    monkeypatch.setattr(stopping, "measure", lambda config, model, evaluation, coverage, stored: replace(
        found, update=evaluation.update, observations=evaluation.observations
    ))  # fmt: skip
    reports = []
    session = learn(tiny(tmp_path, "early", stop="stable"), reports.append)
    summary = read_summary(session.paths.summary)
    assert summary.ended == "objects stable"
    assert summary.steps == reports[-1].steps < STEPS
    assert reports[-1].stopping.startswith("objects 1 for 3/3 checks")
    again = learn(tiny(tmp_path, "fixed", steps=summary.steps))
    for name in ("exploration.csv", "training.csv", "evaluation.csv"):
        assert (again.paths.path / name).read_bytes() == (session.paths.path / name).read_bytes(), name
    weights, expected = (load_model(found.paths.model)[0] for found in (session, again))
    assert all(torch.equal(weights[name], expected[name]) for name in expected)


def test_interrupted_run_is_resumed(tmp_path, capsys):
    """An exception in the callback stands for Ctrl-C."""

    def interrupt(progress):
        if progress.step == 15:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn(tiny(tmp_path), interrupt)
    interrupted = read_summary(tmp_path / "run" / "summary.yaml")
    assert (interrupted.finished, interrupted.steps) == (False, 15)
    recorded = load_record(tmp_path / "run").summary
    assert (recorded.finished, recorded.wall_time) == (False, interrupted.wall_time)
    session = learn(eal.load_config("", root=str(tmp_path), name="run", resume=True))
    assert f"step 16/{STEPS}  " in capsys.readouterr().err, "progress is printed by default"
    summary = read_summary(session.paths.summary)
    assert summary.finished
    assert summary.wall_time > interrupted.wall_time > 0.0
    table = session.read_table("exploration")
    assert list(table["step"]) == list(range(1, STEPS + 1))
    assert (np.diff(table["time"]) > 0.0).all()


def test_training_error_ends_the_run(tmp_path, monkeypatch):
    def fail(*arguments):
        raise SessionError("the disk is full")

    monkeypatch.setattr(learning.TrainingRun, "train", fail)
    with pytest.raises(SessionError, match="the disk is full"):
        learn(tiny(tmp_path))


def test_failed_summary_does_not_hide_the_error(tmp_path, monkeypatch):
    def fail(*arguments):
        raise OSError("no summary")

    monkeypatch.setattr(learning, "conclude_launch", fail)
    with pytest.raises(ZeroDivisionError):
        learn(tiny(tmp_path), lambda progress: 1 // 0)
    assert lock.holder(tmp_path / "run" / ".lock") is None


def test_refused_run_restores_torch_threads(learned):
    session, _ = learned
    before = torch.get_num_threads()
    config = session.config  # the session exists, and is not to be resumed
    with pytest.raises(SessionError, match="exists"):
        learn(replace(config, training=replace(config.training, threads=before + 1)))
    assert torch.get_num_threads() == before


def test_step_without_row_counts(learned, tmp_path):
    """The process was killed after the last observation, before its row."""
    shutil.copytree(learned[0].paths.path, tmp_path / "run")
    table = tmp_path / "run" / "exploration.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-1]))
    session = learn(tiny(tmp_path, resume=True))
    summary = read_summary(session.paths.summary)
    assert (summary.finished, summary.steps) == (True, STEPS)
    Session.open_for_writing(session.config).close()
    assert read_summary(session.paths.summary).finished


def test_real_robot_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="arm/robot is franka: only the simulation"):
        learn(tiny(tmp_path, robot="franka"))


def test_fingerprints_are_found_in_another_session(learned, tmp_path):
    session, _ = learned
    found = eal.fingerprint(session, views=2)
    assert [len(item.images) for item in found.fingerprints] == [2] * len(found.fingerprints)
    other = learn(tiny(tmp_path, "other", explorer="uniform_ergodic", updates_per_observation=0, world="right"))
    decisions = eal.identify(session, images_of=other, images=10, name="first", decision="belief", min_belief=0.0)
    assert {decision.fingerprint for decision in decisions} <= {item.name for item in found.fingerprints}
    with pytest.raises(SessionError, match="first"):
        eal.identify(session, images_of=other, name="first")
    with pytest.raises(SessionError, match="too few images: 25 requested"):
        eal.identify([session], images_of=other, images=STEPS + 1)


@pytest.fixture(scope="module")
def fingerprinted(learned):
    """A session, and its fingerprints."""
    session, _ = learned
    return session, eal.fingerprint(session, from_stored=True, views=2)


def test_fingerprinting_a_real_session_needs_stored_views(fingerprinted, tmp_path):
    session, found = fingerprinted
    assert [len(item.images) for item in found.fingerprints] == [2] * len(found.fingerprints)
    path = tmp_path / "real"
    shutil.copytree(session.paths.path, path)
    write_stored_config(path / "config.yaml", replace(session.config, arm=replace(session.config.arm, robot="franka")))
    before = load_fingerprints(path).created
    with pytest.raises(ConfigError, match=r"arm/robot of session real is franka.*use from_stored=True"):
        eal.fingerprint(path)
    assert load_fingerprints(path).created == before
    assert eal.fingerprint(path, from_stored=True, views=2).session == "real"


def test_too_few_stored_views_are_refused(learned):
    expected = r"(object|blank)-1: too few stored views: \d+ of 50 \(fingerprint/views\) within 0.1 m"
    with pytest.raises(ObservationError, match=expected):
        eal.fingerprint(learned[0], from_stored=True, views=50)


def test_identification_accepts_any_form_of_sessions(fingerprinted):
    """Each session is searched for once."""
    session, found = fingerprinted
    path = str(session.paths.path)
    results = [
        eal.identify(sources, images_of=session, images=10.0, name=f"form-{number}", decision="belief")
        for number, sources in enumerate([session, found, path, (session,), [found, found], [session, path]])
    ]
    labels = [[(item.session, item.fingerprint) for item in decisions] for decisions in results]
    assert labels == [labels[0]] * len(results)


@pytest.mark.parametrize(
    ("sources", "message"),
    [([], "no sessions given"), (5, "session is 5: expected sessions"), ([5], "session is 5: expected")],
)
def test_identification_without_sessions_is_refused(learned, sources, message):
    session, _ = learned
    with pytest.raises(SessionError, match=message):
        eal.identify(sources, images_of=session, name="nothing")
    assert not (session.paths.identification / "nothing").exists()


@pytest.mark.parametrize("images", [1.5, "ten", float("nan")])
def test_invalid_number_of_images_is_refused(fingerprinted, images):
    session, _ = fingerprinted
    with pytest.raises(ConfigError, match=r"images is .*: expected a whole number"):
        eal.identify(session, images_of=session, images=images)


def test_session_is_loaded_by_object_path_and_name(learned, tmp_path, monkeypatch):
    session, _ = learned
    assert eal.load_session(session) is session
    assert eal.load_session(session.paths.path).name == "run"
    assert eal.load_session(str(session.paths.path)).name == "run"
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(SessionError, match="session is 'run', but there is no such session"):
        eal.load_session("run")


def test_config_keys_are_given_by_name_or_section(tmp_path):
    config = eal.load_config(
        "demo", root=tmp_path, steps=80, world=find_world("right"), exploration={"steps": 90, "seed": 5}
    )
    assert (config.exploration.seed, config.exploration.steps) == (5, 80)
    assert config.simulation.world.endswith("right.yaml")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"stepps": 3}, "unknown key stepps: did you mean steps"),
        ({"samples": 3}, r"samples is a key of several sections: give exploration={'samples': ...} or fingerprint="),
        ({"exploration": {"stepps": 3}}, "unknown key exploration/stepps: did you mean exploration/steps"),
        ({"planner": 5}, "section planner is 5: give a dictionary of its keys"),
        ({"seed": "x"}, "exploration/seed is 'x': expected a whole number"),
    ],
)
def test_wrong_config_key_is_refused(tmp_path, overrides, message):
    with pytest.raises(ConfigError, match=message):
        eal.load_config("demo", root=str(tmp_path), **overrides)


def test_times_are_rounded_like_ros_times():
    for seconds in (0.0, 1.2, 0.1 + 0.2, 1234.567890123):
        assert ros_seconds(seconds) == genpy.Time.from_sec(seconds).to_sec()


def test_package_import_is_fast():
    """Nothing heavy is imported before the first use."""
    code = """
import json, sys
import embodied_active_learning as eal
early = [name for name in ("numpy", "torch", "pybullet", "rospy") if name in sys.modules]
print(json.dumps([early, "learn" in dir(eal), hasattr(eal, "nothing")]))
"""
    output = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert json.loads(output.splitlines()[-1]) == [[], True, False]


def test_checkpoint_with_invalid_counter_is_refused(learned, tmp_path):
    """Its checksum is right, as if a program had written it; the session is not locked afterwards."""
    session, _ = learned
    path = tmp_path / "run"
    shutil.copytree(session.paths.path, path)
    newest = load_latest(path / "checkpoints")
    for other in (path / "checkpoints").iterdir():
        other.unlink()
    counters = {**newest.counters, "schedule": None}
    save_checkpoint(path / "checkpoints", newest.updates, newest.observations, newest.tensors, counters)
    config = tiny(tmp_path, resume=True)
    with pytest.raises(CorruptFileError, match=r"checkpoint_\d+\.safetensors"):
        learning.TrainingRun(config)
    assert lock.holder(path / ".lock") is None
