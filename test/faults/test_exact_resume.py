"""A run that is stopped or killed and resumed through the launch file ends as if nothing had happened to it."""

import signal
import time

import pytest

from crashing import acknowledged, kill_everything
from embodied_active_learning.session.checkpoints import load_model
from launching import ROOT, launch_to_the_end, launched

SHORT = ROOT / "test" / "rostest" / "short.yaml"
TABLES = ("exploration.csv", "training.csv", "evaluation.csv")


def arguments(root, **more):
    values = {"profile": SHORT, "session_root": root, "session": "run", "seed": 1, **more}
    return ["learn.launch", *(f"{name}:={value}" for name, value in values.items())]


def wait_for_step(path, step, process):
    ends_at = time.monotonic() + 120
    while acknowledged(path) < step:
        assert process.poll() is None, "the launch ended"
        assert time.monotonic() < ends_at, f"step {step} was not reached"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    home = tmp_path_factory.mktemp("undisturbed")
    launch_to_the_end(home, *arguments(home))
    return home / "run"


def check_same_outcome(path, undisturbed):
    for name in TABLES:
        assert (path / name).read_bytes() == (undisturbed / name).read_bytes(), name
    weights = [load_model(folder / "model.safetensors")[0] for folder in (path, undisturbed)]
    assert weights[0].keys() == weights[1].keys()
    assert all((weights[0][name] == weights[1][name]).all() for name in weights[0])


def test_a_run_that_is_stopped_and_one_that_is_killed_end_like_one_that_was_left_alone(undisturbed, tmp_path):
    path = tmp_path / "run"
    with launched(tmp_path, *arguments(tmp_path)) as process:
        wait_for_step(path, 20, process)
        process.send_signal(signal.SIGINT)
        process.wait(60)
    with launched(tmp_path, *arguments(tmp_path, resume="true")) as process:
        wait_for_step(path, 40, process)
        kill_everything(process)
    output = launch_to_the_end(tmp_path, *arguments(tmp_path, resume="true"))
    assert "other random draws" not in output
    check_same_outcome(path, undisturbed)
