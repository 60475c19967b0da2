"""Markers of the clusters that the stopping criterion watches while learning."""

from __future__ import annotations

from typing import List

import numpy as np
import rospy
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.objects.stability import MAX_DRIFT, StopCheck
from embodied_active_learning.ros.rviz.markers import (
    BLANK_COLOUR,
    FOUND_COLOUR,
    OBJECT_COLOUR,
    disc_marker,
    label_marker,
)


def cluster_markers(stamp: rospy.Time, check: StopCheck) -> MarkerArray:
    """Return a disc and a text for each cluster of a check; earlier markers are deleted.

    A disc is grey if the cluster is new, orange while it drifts, and green once it is stable.
    """
    markers: List[Marker] = [Marker(action=Marker.DELETEALL)]
    for number, (centre, drift) in enumerate(zip(check.centres, check.drifts)):
        is_new = bool(np.isnan(drift))
        colour = BLANK_COLOUR if is_new else FOUND_COLOUR if drift <= MAX_DRIFT else OBJECT_COLOUR
        text = "new" if is_new else f"drift {100.0 * drift:.1f} cm"
        markers.append(disc_marker(stamp, "clusters", number, centre, colour))
        markers.append(label_marker(stamp, "cluster_drifts", number, centre, text))
    return MarkerArray(markers)
