"""What rviz shows of fingerprints, decisions and unknown objects: a disc and a label each, made by `markers`."""

from __future__ import annotations

from typing import List, Sequence

import rospy
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK, FingerprintSet
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.ros.rviz.markers import (
    BLANK_COLOUR,
    FOUND_COLOUR,
    OBJECT_COLOUR,
    UNKNOWN_COLOUR,
    disc_marker,
    label_marker,
)


def fingerprint_markers(stamp: rospy.Time, found: FingerprintSet) -> MarkerArray:
    """Return a disc and a name for each fingerprint; earlier markers are deleted."""
    markers = [Marker(action=Marker.DELETEALL)]
    for number, item in enumerate(found.fingerprints):
        colour = BLANK_COLOUR if item.kind == BLANK else OBJECT_COLOUR
        markers.append(disc_marker(stamp, "fingerprints", number, item.centre, colour))
        markers.append(label_marker(stamp, "fingerprint_names", number, item.centre, item.name))
    return MarkerArray(markers)


def decision_markers(
    stamp: rospy.Time, decisions: Sequence[Decision], unknown: Sequence[UnknownObject] = ()
) -> MarkerArray:
    """Return a disc and a text for each found and each unknown object; earlier markers are deleted."""
    markers: List[Marker] = [Marker(action=Marker.DELETEALL)]
    for number, decision in enumerate(item for item in decisions if item.found):
        colour = BLANK_COLOUR if decision.kind == BLANK else FOUND_COLOUR
        text = f"{decision.session}/{decision.fingerprint} {decision.confidence_text}"
        markers.append(disc_marker(stamp, "decisions", number, decision.pose, colour))
        markers.append(label_marker(stamp, "decision_names", number, decision.pose, text))
    for number, item in enumerate(unknown):
        markers.append(disc_marker(stamp, "unknown", number, item.place, UNKNOWN_COLOUR))
        markers.append(label_marker(stamp, "unknown_names", number, item.place, "unknown"))
    return MarkerArray(markers)
