"""rviz markers of the simulated world and of beliefs."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from visualization_msgs.msg import Marker

from embodied_active_learning.config import Config
from embodied_active_learning.ros import names
from embodied_active_learning.ros.rviz.belief_markers import belief_markers
from embodied_active_learning.ros.rviz.world import world_markers
from embodied_active_learning.simulation.scene import SceneObject


def top_view(centre, size, width):
    """A picture whose upper half (y above the centre) is red and whose lower half is blue."""
    picture = np.zeros((width, width, 3), np.uint8)
    picture[: width // 2, :, 0] = 255
    picture[width // 2 :, :, 2] = 255
    return picture


def test_world_markers_show_table_and_objects():
    duck = SceneObject("duck", "duck", (0.4, 0.1, 0.02), math.pi / 2, (0.08, 0.06, 0.04))
    workspace = Config().workspace.box()
    table, box, label = world_markers(SimpleNamespace(top_view=top_view, objects=[duck]), workspace).markers
    assert {marker.header.frame_id for marker in (table, box, label)} == {names.FRAMES.base}
    assert len(table.points) == len(table.colors) == 6 * 100**2
    for corners, colour in zip(np.reshape([point.y for point in table.points], (-1, 6)), table.colors[::6]):
        assert (colour.r, colour.b) == ((1, 0) if corners.mean() > 0 else (0, 1))
    half = max(abs(point.x) for point in table.points)
    assert table.pose.position.x - half < workspace.lower[0]
    assert (box.pose.position.x, box.pose.position.y, box.pose.position.z) == (0.4, 0.1, 0.02)
    assert (box.scale.x, box.scale.y, box.scale.z) == duck.extent
    assert box.pose.orientation.z == pytest.approx(math.sin(math.pi / 4))
    assert label.text == "duck"
    assert label.pose.position.z > 0.21  # above the clouds


def target(name):
    grid = SimpleNamespace(x=np.array([0.3, 0.4, 0.5]), y=np.array([0.0, 0.1]))
    return SimpleNamespace(session="a", fingerprint=SimpleNamespace(name=name), grid=grid)


def test_belief_markers_show_high_cells_of_each_fingerprint():
    relief = np.array([[0.0, 0.0], [0.0, 0.2], [0.0, 0.01]])
    duck, plant = belief_markers(rospy.Time(1), [target("duck"), target("plant")], [relief, 0.0 * relief], 0.2).markers
    assert (duck.ns, duck.action) == ("a/duck", Marker.ADD)
    assert [(point.x, point.y) for point in duck.points] == [(0.4, 0.1)]
    assert duck.colors[0].a == pytest.approx(0.7)
    assert (plant.ns, plant.action) == ("a/plant", Marker.DELETE)
