"""Markers of a simulated world for rviz: a picture of the table, and a box with a name for each object."""

from __future__ import annotations

import math

import numpy as np
import rospy
from geometry_msgs.msg import Point, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.ros.rviz.markers import label_marker, marker
from embodied_active_learning.simulation.scene import SceneObject
from embodied_active_learning.simulation.simulation import Simulation
from embodied_active_learning.workspace import Workspace

_CELLS = 120  # of the table along each side
_CELL_THICKNESS = 0.001  # m, below the table's surface
_MARGIN = 0.1  # m of table around the workspace
_BOX_COLOUR = ColorRGBA(0.2, 0.4, 0.8, 0.25)


def world_markers(simulation: Simulation, workspace: Workspace) -> MarkerArray:
    """Return the markers of the simulated world around the workspace."""
    stamp = rospy.Time()  # valid at all times
    lower, upper = np.array(workspace.lower[:2]), np.array(workspace.upper[:2])
    centre, size = (lower + upper) / 2.0, float(np.max(upper - lower)) + 2.0 * _MARGIN
    markers = [_table_marker(stamp, simulation.top_view(centre, size, _CELLS), centre, size)]
    for number, item in enumerate(simulation.objects):
        markers.append(_box_marker(stamp, number, item))
        markers.append(label_marker(stamp, "world_names", number, np.array(item.centre), item.name))
    return MarkerArray(markers)


def _table_marker(stamp: rospy.Time, picture: np.ndarray, centre: np.ndarray, size: float) -> Marker:
    """One flat cube per pixel of a picture (N, N, 3) uint8 from above; right is +x, up is +y."""
    cell = size / len(picture)
    offsets = (np.arange(len(picture)) + 0.5) * cell - size / 2.0
    position = Point(float(centre[0]), float(centre[1]), -_CELL_THICKNESS / 2.0)
    shape, white = Vector3(cell, cell, _CELL_THICKNESS), ColorRGBA(1.0, 1.0, 1.0, 1.0)
    table = marker(stamp, "table", 0, Marker.CUBE_LIST, position, shape, white)
    for y, row in zip(offsets[::-1].tolist(), (picture / 255.0).tolist()):
        table.points += [Point(x, y, 0.0) for x in offsets.tolist()]
        table.colors += [ColorRGBA(*pixel, 1.0) for pixel in row]
    return table


def _box_marker(stamp: rospy.Time, number: int, item: SceneObject) -> Marker:
    """The box around an object's mesh."""
    width, depth, height = item.extent
    position = Point(float(item.centre[0]), float(item.centre[1]), height / 2.0)
    box = marker(stamp, "objects", number, Marker.CUBE, position, Vector3(width, depth, height), _BOX_COLOUR)
    box.pose.orientation = Quaternion(0.0, 0.0, math.sin(item.yaw / 2.0), math.cos(item.yaw / 2.0))
    return box
