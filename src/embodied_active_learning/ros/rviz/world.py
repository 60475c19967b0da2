"""Markers of a simulated world for rviz: a picture of the table, and a box with a name for each object."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.ros.conversions import pose_message
from embodied_active_learning.ros.rviz.markers import label_marker, marker
from embodied_active_learning.simulation.scene import SceneObject
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.workspace import Workspace

_CELLS = 100  # of the table along each side
_TABLE_DEPTH = 0.001  # m below the objects, so that discs on the table are visible
_MARGIN = 0.1  # m of table around the workspace
_LABEL_HEIGHT = 0.23  # m, above the clouds and below the labels of fingerprints and decisions
_BOX_COLOUR = ColorRGBA(0.2, 0.4, 0.8, 0.25)


def world_markers(simulation: Simulation, workspace: Workspace) -> MarkerArray:
    """Return the markers of the simulated world around the workspace."""
    stamp = rospy.Time()  # valid at all times
    lower, upper = np.array(workspace.lower[:2]), np.array(workspace.upper[:2])
    centre, size = (lower + upper) / 2.0, float(np.max(upper - lower)) + 2.0 * _MARGIN
    markers = [_table_marker(stamp, simulation.top_view(centre, size, _CELLS), centre, size)]
    for number, item in enumerate(simulation.objects):
        markers.append(_box_marker(stamp, number, item))
        markers.append(label_marker(stamp, "world_names", number, np.array(item.centre), item.name, _LABEL_HEIGHT))
    return MarkerArray(markers)


def _table_marker(stamp: rospy.Time, picture: np.ndarray, centre: np.ndarray, size: float) -> Marker:
    """Two triangles per pixel of a picture (N, N, 3) uint8 from above; right is +x, up is +y."""
    edges = (np.linspace(-0.5, 0.5, len(picture) + 1) * size).tolist()
    position = Point(float(centre[0]), float(centre[1]), -_TABLE_DEPTH)
    white = ColorRGBA(1.0, 1.0, 1.0, 1.0)
    table = marker(stamp, "table", 0, Marker.TRIANGLE_LIST, position, Vector3(1.0, 1.0, 1.0), white)
    for bottom, top, row in zip(edges[:-1], edges[1:], (picture[::-1] / 255.0).tolist()):
        for left, right, pixel in zip(edges[:-1], edges[1:], row):
            corners = [Point(x, y, 0.0) for x, y in ((left, bottom), (right, bottom), (right, top), (left, top))]
            table.points += [corners[index] for index in (0, 1, 2, 0, 2, 3)]
            table.colors += [ColorRGBA(*pixel, 1.0)] * 6
    return table


def _box_marker(stamp: rospy.Time, number: int, item: SceneObject) -> Marker:
    """The box around an object's mesh."""
    width, depth, height = item.extent
    position = Point(float(item.centre[0]), float(item.centre[1]), height / 2.0)
    box = marker(stamp, "objects", number, Marker.CUBE, position, Vector3(width, depth, height), _BOX_COLOUR)
    box.pose.orientation = pose_message((0.0, 0.0, item.yaw)).orientation
    return box
