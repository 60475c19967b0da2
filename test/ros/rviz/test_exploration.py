"""rviz displays of exploration, without a master."""

import numpy as np
import pytest
import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.ros import names
from embodied_active_learning.ros.rviz import exploration
from embodied_active_learning.ros.rviz.exploration import RvizExploration

STAMP = rospy.Time(3)
PLAN = np.array([[0.45, 0.01, 0.1], [0.46, 0.02, 0.2]])


class Publisher:
    """Keeps the messages of a topic; `subscribers` is their number."""

    def __init__(self, topic, message_class, **options):
        self.messages = []
        self.subscribers = 1
        TOPICS[topic] = self

    def publish(self, message):
        self.messages.append(message)

    def get_num_connections(self):
        return self.subscribers


TOPICS = {}


@pytest.fixture
def displays(monkeypatch):
    monkeypatch.setattr(exploration.rospy, "Publisher", Publisher)
    return RvizExploration(Config())


def test_plan_published_at_camera_height(displays):
    displays.show_plan(STAMP, PLAN)
    [path] = TOPICS[names.PLANNED_PATH].messages
    assert [(pose.pose.position.x, pose.pose.position.y) for pose in path.poses] == [(0.45, 0.01), (0.46, 0.02)]
    assert {pose.pose.position.z for pose in path.poses} == {0.3}


def test_second_plan_throttled(displays):
    displays.show_plan(STAMP, PLAN)
    displays.show_plan(STAMP, PLAN)
    assert len(TOPICS[names.PLANNED_PATH].messages) == 1


def test_empty_plan_or_plan_without_subscribers_not_published(displays):
    displays.show_plan(STAMP, np.empty((0, 3)))
    TOPICS[names.PLANNED_PATH].subscribers = 0
    displays.show_plan(STAMP, PLAN)
    assert TOPICS[names.PLANNED_PATH].messages == []


def test_workspace_published_once(displays):
    assert len(TOPICS[names.WORKSPACE_MARKER].messages) == 1
