"""The model that is learned while identifying is stored at the end; no ROS master."""

import pytest

from embodied_active_learning.config import Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.ros.objects import image_search
from embodied_active_learning.ros.objects.image_search import ImageSearch


@pytest.fixture
def log(monkeypatch):
    lines = []
    for level in ("loginfo", "logwarn"):
        monkeypatch.setattr(image_search.rospy, level, lambda text, *values: lines.append(text % values))
    monkeypatch.setattr(image_search, "IdentificationOutput", lambda: None)
    return lines


def store(tmp_path, updates):
    values = {"session": {"name": "seen", "root": str(tmp_path)}, "training": {"updates_per_observation": updates}}
    ImageSearch(Config.from_dict(values)).store_model()


def test_learned_model_is_stored(monkeypatch, tmp_path, log):
    saved = []
    monkeypatch.setattr(image_search, "save_model", lambda: saved.append(1))
    store(tmp_path, 3)
    assert len(saved) == 1
    assert "session seen" in log[0]


def test_search_without_training_stores_no_model(monkeypatch, tmp_path, log):
    monkeypatch.setattr(image_search, "save_model", lambda: pytest.fail("nothing to store"))
    store(tmp_path, 0)
    assert log == []


def test_model_that_cannot_be_stored_is_a_warning(monkeypatch, tmp_path, log):
    def refuse():
        raise SessionError("disk full")

    monkeypatch.setattr(image_search, "save_model", refuse)
    store(tmp_path, 3)
    assert log == ["the model of the searched workspace is not stored: disk full"]
