"""Whole runs of learn.launch: results, refusals, killed nodes, namespaces."""

import os
import signal
import subprocess
import sys
from contextlib import ExitStack

import pytest
import rosbag
import yaml

import embodied_active_learning as eal
from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.session.session import Session
from launching import ROOT, environment, launch_to_the_end, launched, pid_of, started
from threads import wait_while_running

pytestmark = pytest.mark.ros

SHORT = ROOT / "test" / "rostest" / "short.yaml"


def arguments(root, session="run", **overrides):
    values = {"profile": SHORT, "session_root": root, "session": session, "max_lag": 0, "seed": 1, **overrides}
    return ["learn.launch", *(f"{name}:={value}" for name, value in values.items())]


def finished(path):
    check = [sys.executable, ROOT / "tools" / "check_session.py", "learned", path]
    return subprocess.run(check, check=False, capture_output=True).returncode == 0


def wait_for_size(path, size, process):
    """Return once a file of a running launch has more characters than `size`."""
    wait_while_running(
        process, lambda: path.exists() and len(path.read_text()) > size, 120, lambda: f"{path.name} does not grow"
    )


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A short run, for tests of its results."""
    home = tmp_path_factory.mktemp("first")
    output = launch_to_the_end(home, *arguments(home, record="true"))
    return home / "run", output


def test_run_ends_with_figures_and_summary(first):
    path, output = first
    assert finished(path), output
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


def test_finished_session_not_overwritten(first, tmp_path):
    path, _ = first
    before = {entry: entry.stat().st_mtime_ns for entry in path.rglob("*")}
    output = launch_to_the_end(tmp_path, *arguments(path.parent))
    assert "nothing was started" in output
    assert f"session {path} exists" in output
    assert {entry: entry.stat().st_mtime_ns for entry in path.rglob("*")} == before


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ({"world": "diagonale"}, "diagonal"),
        ({"explorer": "ergodyc"}, "did you mean ergodic?"),
        ({"steps": 0}, "exploration/steps is 0"),
        ({"session": "../elsewhere"}, "session/name is '../elsewhere'"),
        ({"session": "nothing-there", "resume": "true"}, "there is no session nothing-there in"),
    ],
)
def test_invalid_arguments_refused_before_nodes_start(overrides, expected, tmp_path):
    output = launch_to_the_end(tmp_path, *arguments(tmp_path, **overrides), timeout=60)
    assert "nothing was started" in output
    assert expected in output
    assert "process[" not in output


def test_run_with_killed_trainer_ends_unfinished(tmp_path):
    path = tmp_path / "run"
    with launched(tmp_path, *arguments(tmp_path, steps=80)) as process:
        wait_for_size(path / "training.csv", 1500, process)
        os.kill(pid_of("trainer", process.pid), signal.SIGKILL)
        process.wait(60)
    assert not finished(path)
    stored = len(Session.open_read_only(path).open_observations())
    assert 8 < stored < 80


def test_run_finishes_after_its_worker_is_killed(tmp_path):
    path, profile, steps = tmp_path / "run", yaml.safe_load(SHORT.read_text()), 60
    profile["training"]["updates_per_round"] = 2
    (tmp_path / "profile.yaml").write_text(yaml.safe_dump(profile))
    several = arguments(tmp_path, profile=tmp_path / "profile.yaml", steps=steps, trainers=2)
    with launched(tmp_path, *several) as process:
        wait_for_size(path / "rounds.csv", 100, process)
        os.kill(pid_of("trainer_worker_1", process.pid), signal.SIGKILL)
        process.wait(180)
    output = (tmp_path / "launch.log").read_text()
    assert finished(path), output
    assert "training with 2 of 2 trainers" in output
    assert "trainer worker 1 dropped" in output
    session = Session.open_read_only(path)
    rounds = session.read_table("rounds")
    assert (int(rounds["trainers"].max()), int(rounds["trainers"].min())) == (2, 1)
    assert rounds["updates"].sum() == steps
    assert len(session.open_observations()) == steps


def test_two_namespaces_under_one_master(tmp_path):
    variables = environment(tmp_path)
    port = variables["ROS_MASTER_URI"].rsplit(":", 1)[1]
    with started(["roscore", "-p", port], tmp_path / "core.log", variables):
        homes = {name: tmp_path / name for name in ("left", "right")}
        with ExitStack() as both:
            processes = []
            for name, home in homes.items():
                home.mkdir()
                inside = {**variables, "ROS_HOME": str(home), "ROS_NAMESPACE": name}
                launch = launched(home, "--wait", *arguments(home, steps=20, record="true"), variables=inside)
                processes.append(both.enter_context(launch))
            for process in processes:
                process.wait(180)
    for home in homes.values():
        assert finished(home / "run"), (home / "launch.log").read_text()
        recorded(home / "run")
