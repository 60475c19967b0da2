"""Publication of stored fingerprints; no ROS master."""

from types import SimpleNamespace

import pytest
import rospy

from embodied_active_learning.ros import names
from embodied_active_learning.ros.objects import fingerprint_output
from embodied_active_learning.ros.objects.fingerprint_output import FingerprintOutput
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
