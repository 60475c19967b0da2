"""Markers of beliefs for rviz: a coloured relief per fingerprint, all with the same scale."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.ros.rviz.markers import marker

COLOURS = ((0.84, 0.15, 0.16), (0.12, 0.47, 0.71), (0.17, 0.63, 0.17), (0.58, 0.40, 0.74), (1.0, 0.5, 0.05))
"""RGB of the fingerprints in their order, repeated if there are more."""
_HEIGHT = 0.08  # m of a cell at the end of the scale
_MIN_SHOWN = 0.1  # of the scale; lower cells are left out
_OPACITY = 0.7


def belief_markers(
    stamp: rospy.Time, targets: Sequence[SearchTarget], reliefs: Sequence[np.ndarray], scale: float
) -> MarkerArray:
    """Return one marker per fingerprint, whose namespace is its name, so that rviz can hide it.

    Args:
        stamp: of the markers.
        targets: the fingerprints with their beliefs.
        reliefs: (nx, ny) value of each cell, for each fingerprint.
        scale: value with full height and opacity.
    """
    markers: List[Marker] = []
    for number, (target, relief) in enumerate(zip(targets, reliefs)):
        name = f"{target.session}/{target.fingerprint.name}"
        markers.append(_relief_marker(stamp, name, target, relief / scale, COLOURS[number % len(COLOURS)]))
    return MarkerArray(markers)


def _relief_marker(
    stamp: rospy.Time, name: str, target: SearchTarget, shares: np.ndarray, colour: Sequence[float]
) -> Marker:
    """Points above the table, higher and more opaque where the belief is higher."""
    x, y = target.grid.x, target.grid.y
    size = Vector3(float(x[1] - x[0]), float(y[1] - y[0]), 0.0)
    relief = marker(stamp, name, 0, Marker.POINTS, Point(), size, ColorRGBA(*colour, 1.0))
    for i, j in np.argwhere(shares > _MIN_SHOWN):
        share = float(min(shares[i, j], 1.0))
        relief.points.append(Point(float(x[i]), float(y[j]), _HEIGHT * share))
        relief.colors.append(ColorRGBA(*colour, _OPACITY * share))
    if not relief.points:
        relief.action = Marker.DELETE
    return relief
