"""Training progress as messages and diagnostics, without a master."""

from types import SimpleNamespace

import numpy as np
import pytest
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.config import Config
from embodied_active_learning.distributed.remote_worker import WorkerStatus
from embodied_active_learning.errors import SessionError
from embodied_active_learning.ros.runtime.diagnostics import ERROR, OK, WARN
from embodied_active_learning.ros.rviz.markers import BLANK_COLOUR, FOUND_COLOUR, OBJECT_COLOUR
from embodied_active_learning.ros.trainer import status as status_module
from embodied_active_learning.ros.trainer.status import TrainerStatus

CONFIG = Config()


def make_check(drifts):
    centres = np.full((len(drifts), 2), 0.4)
    return SimpleNamespace(describe=lambda: f"objects {len(drifts)}", centres=centres, drifts=np.array(drifts))


@pytest.fixture
def run(tmp_path):
    """A training run with 80 observations that has made 10 of 48 updates due."""
    values = {"observations": 80, "updates": 10, "updates_due": 48, "skipped": 0, "rollbacks": 0, "finished": False}
    run = SimpleNamespace(folder=tmp_path, config=CONFIG, stop_check=None, pool=None, **values)
    run.latent_contribution = 0.25
    return run


@pytest.fixture
def status(run, monkeypatch):
    messages = []
    markers = []

    def advertise(name, kind, **_options):
        return SimpleNamespace(publish=(markers if kind is MarkerArray else messages).append)

    monkeypatch.setattr(status_module.rospy, "Publisher", advertise)
    monkeypatch.setattr(status_module.rospy.Time, "now", lambda: status_module.rospy.Time(1))
    monkeypatch.setattr(status_module, "WallTimer", lambda period, function: None)
    monkeypatch.setattr(status_module, "report_health", lambda name, health: None)
    status = TrainerStatus(run, CONFIG)
    status.messages, status.markers = messages, markers
    return status


def test_message_before_first_update_has_nan_losses(status):
    status.publish()
    [message] = status.messages
    assert (message.observations, message.updates, message.updates_due, message.finished) == (80, 10, 48, False)
    assert message.loss != message.loss
    assert message.latent_contribution == 0.25


def test_message_shows_the_stopping_criterion(status, run):
    run.config, run.stop_check = CONFIG.with_steps(320), make_check([0.003, np.nan])
    status.publish()
    [message] = status.messages
    assert (message.steps, message.updates_planned, message.stopping) == (320, 960, "objects 2")
    assert status.health().values["stopping"] == "objects 2"


def test_clusters_are_shown_with_their_drift_once_per_check(status, run):
    run.stop_check = make_check([0.003, np.nan, 0.02])
    status.publish()
    status.publish()
    [message] = status.markers
    assert [marker.text for marker in message.markers if marker.text] == ["drift 0.3 cm", "new", "drift 2.0 cm"]
    discs = [marker.color for marker in message.markers if marker.type == Marker.CYLINDER]
    assert discs == [FOUND_COLOUR, BLANK_COLOUR, OBJECT_COLOUR]
    run.stop_check = make_check([])
    status.publish()
    assert [marker.action for marker in status.markers[1].markers] == [Marker.DELETEALL]


def test_message_contains_newest_update(status):
    terms = ("loss", "reconstruction", "conditional_reconstruction", "kl", "beta", "gamma", "active_units")
    status.on_update(SimpleNamespace(**{term: float(index) for index, term in enumerate(terms)}))
    status.publish()
    assert [getattr(status.messages[0], term) for term in terms] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


@pytest.mark.parametrize(
    ("changes", "level", "message"),
    [
        ({}, OK, "training"),
        ({"updates": 48}, OK, "waiting for observation 81"),
        ({"observations": 3, "updates": 0, "updates_due": 0}, OK, "observation 4; training starts with number 64"),
        ({"finished": True}, OK, "finished"),
        ({"rollbacks": 2}, WARN, "rolled back 2 times"),
        ({"rollbacks": 2, "finished": True}, OK, "finished"),
    ],
)
def test_health_reports_activity(status, run, changes, level, message):
    run.__dict__.update(changes)
    health = status.health()
    assert health.level == level
    assert message in health.message


def test_health_reports_full_disk_as_warning(status, monkeypatch):
    def refuse(*arguments):
        raise SessionError("disk full")

    monkeypatch.setattr(status_module, "check_space", refuse)
    assert (status.health().level, status.health().message) == (WARN, "disk full")


def test_health_reports_failed_training_as_error(status):
    status.error = RuntimeError("training failed")
    assert (status.health().level, status.health().message) == (ERROR, "training failed")


def test_health_shows_each_worker_and_warns_if_one_is_missing(status, run):
    status._config = Config.from_dict({"training": {"trainers": 3}})
    workers = [WorkerStatus(slot=2, rounds=7, updates=175)]
    run.pool = SimpleNamespace(status=lambda: workers)
    health = status.health()
    assert (health.level, health.values["worker 2"].split(",")[0]) == (WARN, "7 rounds")
    assert "2 of 3 trainers" in health.message
    workers.append(WorkerStatus(slot=1))
    assert status.health().level == OK
