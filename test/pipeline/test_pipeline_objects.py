"""Fingerprints and identification through the launch files and services that users call, with a small model."""

import math
import subprocess
import sys
import threading
import time

import pytest
import yaml

from embodied_active_learning.config import Config
from embodied_active_learning.objects.report import nearest, true_kinds
from embodied_active_learning.session.fingerprints import has_fingerprints, load_fingerprints
from embodied_active_learning.session.identifications import load_identification, load_trace
from embodied_active_learning.session.session import Session
from embodied_active_learning.simulation.truth import true_objects
from launching import ROOT, environment, launch_to_the_end, launched

pytestmark = pytest.mark.ros

TINY = ROOT / "test" / "rostest" / "tiny.yaml"
IMAGES = 300


class Learning:
    """A learning run that stays up, and what was answered to calls while it ran."""

    def __init__(self, home):
        self.home = home
        self.path = home / "tiny"
        self.variables = environment(home)

    def call(self, service, request="{}"):
        """What rosservice prints, as values."""
        command = ["rosservice", "call", "--wait", service, request]
        run = subprocess.run(command, env=self.variables, capture_output=True, text=True, timeout=240, check=False)
        assert run.returncode == 0, run.stderr
        return yaml.safe_load(run.stdout)

    def rows(self):
        table = self.path / "exploration.csv"
        return len(table.read_text().splitlines()) - 1 if table.exists() else 0

    def wait_for(self, condition, timeout=240):
        ends_at = time.monotonic() + timeout
        while not condition():
            assert self.process.poll() is None, self.log()
            assert time.monotonic() < ends_at, self.log()
            time.sleep(0.1)

    def log(self):
        return (self.home / "launch.log").read_text()


@pytest.fixture(scope="module")
def learning(tmp_path_factory):
    """Learns the world diagonal; when asked for, it has just finished, after it was fingerprinted half way."""
    run = Learning(tmp_path_factory.mktemp("objects"))
    arguments = [f"profile:={TINY}", f"session_root:={run.home}", "session:=tiny", "seed:=3", "stay:=true"]
    with launched(run.home, "learn.launch", *arguments, variables=run.variables) as process:
        run.process = process
        run.wait_for(lambda: run.rows() >= 350)
        run.answers = []
        first = threading.Thread(target=lambda: run.answers.append(run.call("/fingerprint")))
        first.start()
        run.wait_for(lambda: "view 10 of 40" in run.log())
        run.before = run.rows()
        run.answers.append(run.call("/fingerprint"))
        first.join()
        run.early = load_fingerprints(run.path)
        run.wait_for((run.path / "summary.yaml").exists)
        yield run


@pytest.fixture(scope="module")
def fingerprinted(learning):
    """The finished session with the fingerprints of its final model."""
    answer = learning.call("/fingerprint")
    assert answer["success"], answer["message"]
    return learning


def distances(found, path):
    truth = true_objects(Session.open_read_only(path).config)
    objects = [item for item in found.fingerprints if item.kind == "object"]
    return sorted(min(math.hypot(item.centre[0] - x, item.centre[1] - y) for _, x, y in truth) for item in objects)


def test_of_two_calls_at_once_one_is_served_and_the_other_told_why_not(learning):
    refused, served = sorted(learning.answers, key=lambda answer: answer["success"])
    assert served["success"]
    assert len(served["fingerprints"]) == len(learning.early.fingerprints) > 1
    assert not refused["success"]
    assert "fingerprinting is under way (" in refused["message"]


def test_exploration_pauses_for_the_views_and_then_goes_on_to_its_end(learning):
    assert 350 <= learning.before < 600
    assert learning.rows() == 600
    assert learning.early.updates < 1800


def test_fingerprints_of_the_final_model_replace_the_earlier_ones(fingerprinted):
    found = load_fingerprints(fingerprinted.path)
    assert found.updates == 1800
    assert found.observations == 600
    assert len(list((fingerprinted.path / "fingerprints").glob("[0-9]*"))) == 1
    assert (fingerprinted.path / "figures" / "fingerprints.png").stat().st_size > 50_000


def test_there_is_one_fingerprint_for_each_object_and_one_blank(fingerprinted):
    found = load_fingerprints(fingerprinted.path)
    assert [item.kind for item in found.fingerprints] == ["object", "object", "blank"]
    assert all(len(item.states) == 40 for item in found.fingerprints)
    assert distances(found, fingerprinted.path)[-1] < 0.02


def test_a_stop_while_views_are_taken_fails_the_call_and_keeps_what_was_stored(fingerprinted):
    before = load_fingerprints(fingerprinted.path).created
    stored = sorted((fingerprinted.path / "fingerprints").rglob("*"))
    lines = fingerprinted.log().count("view 10 of 40")
    answers = []
    call = threading.Thread(target=lambda: answers.append(fingerprinted.call("/fingerprint")))
    call.start()
    fingerprinted.wait_for(lambda: fingerprinted.log().count("view 10 of 40") > lines)
    fingerprinted.call("/arm/stop")
    call.join()
    fingerprinted.call("/arm/recover")
    assert not answers[0]["success"]
    assert "the arm was stopped by" in answers[0]["message"]
    assert load_fingerprints(fingerprinted.path).created == before
    assert sorted((fingerprinted.path / "fingerprints").rglob("*")) == stored


@pytest.fixture(scope="module")
def identified(fingerprinted, tmp_path_factory):
    """An identification in another world, by the launch file."""
    home = tmp_path_factory.mktemp("identified")
    output = launch_to_the_end(home, "identify.launch", *identify_arguments(fingerprinted, world="star_plant_duck"))
    return fingerprinted.home / "seen", output


def identify_arguments(learning, **values):
    values = {"sessions": "tiny", "session_root": learning.home, "name": "first", "images": IMAGES, **values}
    if "replay" not in values:
        values.update(profile=TINY, session="seen", explorer="uniform_ergodic")
    return [f"{name}:={value}" for name, value in values.items()]


def test_learned_objects_are_found_where_they_stand_in_another_world(identified):
    path, output = identified
    result = load_identification(path, "first")
    assert result.images == IMAGES
    truth = true_objects(Config.from_dict({"simulation": {"world": "star_plant_duck"}}))
    learned = load_fingerprints(path.parent / "tiny")
    kinds = true_kinds(learned, true_objects(learned.config))
    # The star is not asked about: a model as small as this one may take it for what it knows.
    for kind in ("duck", "plant"):
        standing = [item for item in truth if item[0] == kind]
        found = [item.pose for item in result.decisions if item.found and kinds[item.fingerprint] == kind]
        assert any(nearest(pose, standing)[1] < 0.03 for pose in found), output


def test_identification_leaves_a_table_a_picture_and_a_trace_of_every_image(identified):
    path, output = identified
    assert "really there" in output
    assert (path / "figures" / "beliefs.png").stat().st_size > 50_000
    folder = path / "identification" / "first"
    assert len((folder / "decisions.csv").read_text().splitlines()) >= 4
    assert len(list(folder.glob("trace-tiny-*.png"))) == 3
    assert all(len(values) == IMAGES for values in load_trace(path, "first").values())
    check = [sys.executable, ROOT / "tools" / "check_session.py", "identified", path, "first"]
    assert subprocess.run(check, check=False, capture_output=True).returncode == 0


def test_the_same_images_replayed_give_the_same_decisions(identified, fingerprinted, tmp_path):
    path, _ = identified
    arguments = identify_arguments(fingerprinted, replay="seen", name="again", images=0)
    launch_to_the_end(tmp_path, "identify.launch", *arguments)
    first, again = load_identification(path, "first"), load_identification(path, "again")
    assert again.images == IMAGES
    assert [(d.fingerprint, d.found, d.pose.tolist(), d.confidence) for d in first.decisions] == [
        (d.fingerprint, d.found, d.pose.tolist(), d.confidence) for d in again.decisions
    ]


def test_a_replay_beside_a_running_system_leaves_its_configuration_alone(identified, fingerprinted):
    arguments = identify_arguments(fingerprinted, replay="seen", name="again", images=0)
    dump = ["roslaunch", "--dump-params", "embodied_active_learning", "identify.launch", *arguments]
    parameters = yaml.safe_load(subprocess.run(dump, check=True, capture_output=True, text=True).stdout)
    assert "/config" not in parameters
    assert parameters["/identifier/config"]["session"]["name"] == "seen"


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ({"sessions": "seen"}, "has no fingerprints yet"),
        ({"replay": "seen", "images": 5000}, f"holds {IMAGES} images only, 5000 were asked for"),
    ],
)
def test_what_cannot_be_identified_is_said_and_leaves_nothing_behind(identified, fingerprinted, overrides, expected):
    home = fingerprinted.home / "refused"
    home.mkdir(exist_ok=True)
    values = {"replay": "seen", "name": "refused", "images": 0, **overrides}
    output = launch_to_the_end(home, "identify.launch", *identify_arguments(fingerprinted, **values), timeout=90)
    assert expected in output
    assert not (identified[0] / "identification" / "refused").exists()


def test_fingerprinting_a_finished_session_by_its_launch_file_ends_by_itself(fingerprinted, tmp_path):
    # The session is still held by the learning run, which stays up: that has to be said.
    output = launch_to_the_end(tmp_path, "fingerprint.launch", "session:=tiny", f"session_root:={fingerprinted.home}")
    assert "is in use" in output
    fingerprinted.process.send_signal(2)
    fingerprinted.process.wait(60)
    before = load_fingerprints(fingerprinted.path).created
    launch_to_the_end(tmp_path, "fingerprint.launch", "session:=tiny", f"session_root:={fingerprinted.home}")
    assert has_fingerprints(fingerprinted.path)
    assert load_fingerprints(fingerprinted.path).created > before
