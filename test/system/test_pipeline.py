"""Whole runs of learn.launch: results, refusals, killed nodes, namespaces."""

import os
import signal
from contextlib import ExitStack

import pytest
import rosbag
import yaml

import embodied_active_learning as eal
from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.session.session import Session
from launching import ROOT, Run, environment, is_finished, launch_to_the_end, launched, rows, started

pytestmark = pytest.mark.ros

SHORT = ROOT / "test" / "rostest" / "short.yaml"


def arguments(root, session="run", **overrides):
    values = {"profile": SHORT, "session_root": root, "session": session, "max_lag": 0, "seed": 1, **overrides}
    return ["learn.launch", *(f"{name}:={value}" for name, value in values.items())]


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A short run, for tests of its results."""
    home = tmp_path_factory.mktemp("first")
    output = launch_to_the_end(home, *arguments(home, record="true"))
    return home / "run", output


def test_run_ends_with_figures_and_summary(first):
    path, output = first
    assert is_finished(path), output
    assert "active units" in output
    assert str(path / "figures" / "learning_metrics.png") in output


def test_run_without_ros_gives_the_same_content(first, tmp_path):
    path, _ = first
    session = eal.learn(eal.load_config(str(SHORT), root=str(tmp_path), name="run", seed=1, max_lag=0))
    for name in ("exploration.csv", "training.csv", "evaluation.csv", "model.safetensors"):
        assert (session.paths.path / name).read_bytes() == (path / name).read_bytes(), name


def recorded(path):
    """The recording of a session, which must have been closed, and hold the observations that were stored."""
    recording, session = Recording(path / "bags"), Session.open_read_only(path)
    found = list(recording.observations(session.config))
    assert recording.warnings() == []
    with session.open_observations() as store:
        assert [item.image.data for item in found] == [image.tobytes() for image in store.images]
        assert [(item.state.x, item.state.y, item.state.theta) for item in found] == list(map(tuple, store.raw_states))
        assert [item.header.stamp.to_sec() for item in found] == store.stamps.tolist()
    return recording


def test_recording_equals_stored_observations(first):
    path, _ = first
    recording, config = recorded(path), Session.open_read_only(path).config
    assert recording.settings()["training"] == config.to_dict()["training"]
    with rosbag.Bag(str(next((path / "bags").glob("*.bag")))) as bag:
        topics = set(bag.get_type_and_topic_info().topics)
    assert topics >= {"/camera/image_raw", "/camera/camera_info", "/arm/state", "/joint_states", "/tf", "/tf_static"}
    assert topics >= {"/target_distribution", "/training_status", "/diagnostics"}


def test_invalid_argument_refused_before_nodes_start(tmp_path):
    output = launch_to_the_end(tmp_path, *arguments(tmp_path, explorer="ergodyc"), timeout=60)
    assert "nothing was started" in output
    assert "did you mean ergodic?" in output
    assert "process[" not in output


def test_run_with_killed_trainer_ends_unfinished(tmp_path):
    path = tmp_path / "run"
    with launched(tmp_path, *arguments(tmp_path, steps=80)) as process:
        run = Run(tmp_path, "run", process, None)
        run.wait_for(lambda: rows(path / "training.csv") > 5)
        os.kill(run.pid("trainer"), signal.SIGKILL)
        process.wait(60)
    assert not is_finished(path)
    stored = len(Session.open_read_only(path).open_observations())
    assert 8 < stored < 80


def test_two_namespaces_under_one_master(tmp_path):
    """One of the runs has a second trainer, which is killed and restarted."""
    profile = yaml.safe_load(SHORT.read_text())
    profile["training"]["updates_per_round"] = 2
    (tmp_path / "rounds.yaml").write_text(yaml.safe_dump(profile))
    more = {"left": {"steps": 20}, "right": {"trainers": 2, "profile": tmp_path / "rounds.yaml"}}
    variables = environment(tmp_path)
    port = variables["ROS_MASTER_URI"].rsplit(":", 1)[1]
    with started(["roscore", "-p", port], tmp_path / "core.log", variables):
        homes = {name: tmp_path / name for name in ("left", "right")}
        with ExitStack() as both:
            runs = []
            for name, home in homes.items():
                home.mkdir()
                inside = {**variables, "ROS_HOME": str(home), "ROS_NAMESPACE": name}
                words = arguments(home, record="true", **more[name])
                process = both.enter_context(launched(home, "--wait", *words, variables=inside))
                runs.append(Run(home, "run", process, inside))
            several = runs[1]
            several.wait_for(lambda: rows(several.path / "rounds.csv") > 2)
            os.kill(several.pid("trainer_worker_1"), signal.SIGKILL)
            for run in runs:
                run.process.wait(180)
    for run in runs:
        assert is_finished(run.path), run.log
        recorded(run.path)
    assert "training with 2 of 2 trainers" in several.log
    assert Session.open_read_only(several.path).read_table("rounds")["trainers"].max() == 2
