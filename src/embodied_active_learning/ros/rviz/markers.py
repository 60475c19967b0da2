"""Shapes and colours that the markers of this package share: a disc on the table, a label above, a plain marker."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from embodied_active_learning.ros import names

OBJECT_COLOUR = ColorRGBA(0.95, 0.6, 0.1, 0.5)
FOUND_COLOUR = ColorRGBA(0.1, 0.7, 0.2, 0.6)
UNKNOWN_COLOUR = ColorRGBA(0.6, 0.2, 0.7, 0.6)
BLANK_COLOUR = ColorRGBA(0.5, 0.5, 0.5, 0.4)
_LABEL_COLOUR = ColorRGBA(0.05, 0.05, 0.05, 1.0)
_DISC_RADIUS, _DISC_THICKNESS = 0.045, 0.002  # m
LABEL_HEIGHT = 0.28
"""Height of labels above the table [m]: above objects and clouds."""
_LABEL_SIZE = 0.025  # m


def disc_marker(stamp: rospy.Time, namespace: str, number: int, centre: np.ndarray, colour: ColorRGBA) -> Marker:
    """Return a flat disc on the table at a centre (x, y, ...) [m]."""
    size = Vector3(2.0 * _DISC_RADIUS, 2.0 * _DISC_RADIUS, _DISC_THICKNESS)
    position = Point(float(centre[0]), float(centre[1]), _DISC_THICKNESS / 2.0)
    return marker(stamp, namespace, number, Marker.CYLINDER, position, size, colour)


def label_marker(
    stamp: rospy.Time, namespace: str, number: int, centre: np.ndarray, text: str, height: float = LABEL_HEIGHT
) -> Marker:
    """Return a text above a centre (x, y, ...) [m] at a height [m]."""
    position = Point(float(centre[0]), float(centre[1]), height)
    size = Vector3(0.0, 0.0, _LABEL_SIZE)
    label = marker(stamp, namespace, number, Marker.TEXT_VIEW_FACING, position, size, _LABEL_COLOUR)
    label.text = text
    return label


def marker(
    stamp: rospy.Time, namespace: str, number: int, kind: int, position: Point, size: Vector3, colour: ColorRGBA
) -> Marker:
    """Return a marker without rotation, at a position relative to the base in x and y and to the table in z [m]."""
    above_base = Point(position.x, position.y, position.z + names.FRAMES.table_height)
    return Marker(
        header=Header(stamp=stamp, frame_id=names.FRAMES.base),
        ns=namespace,
        id=number,
        type=kind,
        action=Marker.ADD,
        pose=Pose(above_base, Quaternion(0.0, 0.0, 0.0, 1.0)),
        scale=size,
        color=colour,
    )
