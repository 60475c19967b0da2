"""Publication of stored fingerprints; no ROS master."""

import runpy
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.ros import names
from embodied_active_learning.ros.objects import fingerprint_output
from embodied_active_learning.ros.objects.fingerprint_output import FingerprintOutput
from launching import ROOT
from sample_fingerprints import make_set


@pytest.fixture
def published(monkeypatch):
    """Messages by topic."""
    published = {}

    def publisher(name, _message_class, **_options):
        return SimpleNamespace(publish=lambda message: published.setdefault(name, []).append(message))

    monkeypatch.setattr(fingerprint_output.rospy, "Publisher", publisher)
    monkeypatch.setattr(fingerprint_output.rospy.Time, "now", lambda: rospy.Time(1))
    return published


def test_response_has_the_published_fingerprints(published):
    found = make_set()
    messages = FingerprintOutput().publish(found)
    assert [message.name for message in messages] == [item.name for item in found.fingerprints]
    [array] = published[names.FINGERPRINTS]
    assert array.fingerprints == messages
    assert len(array.thumbnails) == len(messages)


def test_session_without_fingerprints_publishes_nothing(published, tmp_path):
    FingerprintOutput().publish_stored(tmp_path)
    assert published == {}


@pytest.mark.parametrize("once", [True, False])
def test_fingerprints_to_be_replaced_at_once_are_not_read(monkeypatch, once):
    """They may be outdated, which the user is about to change."""
    node = runpy.run_path(str(ROOT / "nodes" / "fingerprinter"))["Fingerprinter"]
    stubs = {name: Mock() for name in ("FingerprintOutput", "ViewCollector", "TaskServer", "report_health")}
    for name, stub in stubs.items():
        monkeypatch.setitem(node.__init__.__globals__, name, stub)
    monkeypatch.setattr(rospy, "Publisher", Mock())
    monkeypatch.setattr(rospy, "get_param", {"~once": once}.get)
    node(Config.from_dict({"session": {"name": "run"}}), False)
    assert stubs["FingerprintOutput"]().publish_stored.called == (not once)
