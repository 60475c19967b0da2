"""replay.launch: learning from the shipped bag, without a robot."""

import math
import os
import signal
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from embodied_active_learning.config import Config
from embodied_active_learning.pipeline.identification import IdentificationRun, read_sets
from embodied_active_learning.pipeline.training import TrainingRun
from embodied_active_learning.ros.bags.recording import Recording
from embodied_active_learning.ros.conversions import image_array, state_arrays
from embodied_active_learning.session.fingerprints import load_fingerprints
from embodied_active_learning.session.session import Session
from embodied_active_learning.session.session_model import load_session_model
from embodied_active_learning.session.summary import read_summary
from embodied_active_learning.simulation.truth import true_objects
from launching import ROOT, Run, launch_to_the_end, launched, rows

pytestmark = pytest.mark.ros

BAG = ROOT / "bags" / "diagonal-small.bag"
OBSERVATIONS = 400
QUICK = {
    "training": {"updates_per_observation": 1, "learning_rate": 0.003},
    "model": {"channels": [8, 8, 12], "hidden_sizes": [96, 48], "latent_size": 8},
}
"""A smaller model, and a third of the updates of the recorded run, each three times as large."""


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """The folder of the sessions, with a fast profile."""
    folder = tmp_path_factory.mktemp("replay")
    (folder / "quick.yaml").write_text(yaml.safe_dump(QUICK))
    return folder


def arguments(home, **values):
    values = {"bag": BAG, "profile": home / "quick.yaml", "session_root": home, "session": "again", **values}
    return [f"{name}:={value}" for name, value in values.items()]


@pytest.fixture(scope="module")
def replayed(home):
    """Replay, killed in the middle and resumed -> its folder, and the output of the launch."""
    chosen = arguments(home, respawn="true", fingerprint="true")
    with launched(home, "replay.launch", *chosen) as process:
        run = Run(home, "again", process, None)
        run.wait_for(lambda: rows(run.path / "training.csv") >= 60)
        for node in ("replay", "trainer"):
            os.kill(run.pid(node), signal.SIGKILL)
        assert 60 <= run.steps < OBSERVATIONS
        process.wait(240)
    return run.path, run.log


def test_replay_gives_the_weights_of_its_observations(replayed, home):
    path, output = replayed
    config = Session.open_read_only(path).config
    threads = torch.get_num_threads()
    torch.set_num_threads(config.training.threads)
    run = TrainingRun(replace(config, session=replace(config.session, name="alone", resume=False)))
    try:
        for item in Recording(BAG).observations(config):
            image = image_array(item.image, config.camera.height, config.camera.width)
            run.observe(item.index, item.header.stamp.to_sec(), state_arrays(item.state)[0], image)
        run.train(lambda report: None, run.stop)
    finally:
        run.close()
        torch.set_num_threads(threads)
    found, alone = (load_session_model(Session.open_read_only(folder)) for folder in (path, home / "alone"))
    assert found.updates == alone.updates == OBSERVATIONS, output
    assert all(torch.equal(found.weights[name], weight) for name, weight in alone.weights.items())


def test_replay_leaves_a_complete_session(replayed):
    path, output = replayed
    session = Session.open_read_only(path)
    table = session.read_table("exploration")
    assert table["step"].tolist() == list(range(1, OBSERVATIONS + 1)), output
    assert table["ergodic_measure"][-1] < 0.3 < table["ergodic_measure"][0]
    assert np.isnan(table["effort"]).all(), "the commands are unknown"
    assert session.config.arm.robot == "recording"
    assert true_objects(session.config) == []
    assert read_summary(session.paths.summary).finished
    loss = session.read_table("training")["loss"]
    assert loss[-20:].mean() < loss[:20].mean() - 1.0
    for name in ("learning_metrics", "entropy", "reconstructions", "fingerprints"):
        assert (session.paths.figures / f"{name}.png").stat().st_size > 10_000, name


def centres(fingerprints):
    return [item.centre for item in fingerprints if item.kind == "object"]


def nearest(place, truth):
    return min(math.hypot(place[0] - item.x, place[1] - item.y) for item in truth)


TRUTH = true_objects(Config.from_dict({"simulation": {"world": "diagonal"}}))


def test_objects_are_fingerprinted_from_recorded_images(replayed):
    path, output = replayed
    found = load_fingerprints(path)
    assert [item.kind for item in found.fingerprints] == ["object", "object", "blank"], output
    assert max(nearest(place, TRUTH) for place in centres(found.fingerprints)) < 0.02
    with Session.open_read_only(path).open_observations() as store:
        states = {tuple(state) for state in store.raw_states}
    for item in found.fingerprints:
        assert len(item.states) == 20
        assert {tuple(state) for state in item.states} <= states


def test_fingerprints_are_found_in_a_bag(replayed, home):
    convert = ["rosrun", "embodied_active_learning", "bag_to_session", BAG, "seen", "--root", home]
    subprocess.run(convert, check=True, timeout=60, stdout=subprocess.DEVNULL)
    settings = Session.open_read_only(home / "seen").config.identification
    run = IdentificationRun(home / "seen", read_sets(home, ["again"]), "first", 0, settings)
    try:
        while not run.complete:
            run.advance()
        decisions = run.decide()
    finally:
        run.close()
    assert 0 < run.processed <= OBSERVATIONS  # fewer once all is decided
    found = [item for item in decisions if item.found and item.kind == "object"]
    assert len(found) >= 2
    assert max(nearest(item.pose, TRUTH) for item in found) < 0.03


def test_unusable_bag_ends_launch_before_any_node(home, tmp_path):
    output = launch_to_the_end(tmp_path, "replay.launch", *arguments(home, bag=home / "quick.yaml", session="other"))
    assert "nothing was started" in output
    assert "is not a ROS bag" in output
    assert not (home / "other").exists()
