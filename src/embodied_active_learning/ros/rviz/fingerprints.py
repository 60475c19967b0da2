"""Publishes the stored fingerprints as messages, and as markers for rviz."""

from __future__ import annotations

from typing import List

import rospy
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.msg import Fingerprint as FingerprintMessage
from embodied_active_learning.msg import FingerprintArray
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint, FingerprintSet
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import image_message
from embodied_active_learning.ros.rviz.markers import BLANK_COLOUR, OBJECT_COLOUR, disc_marker, label_marker


class RvizFingerprints:
    """Latched publishers of the stored fingerprints."""

    def __init__(self) -> None:
        """Advertise the topics."""
        self._array = rospy.Publisher(names.FINGERPRINTS, FingerprintArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(names.FINGERPRINT_MARKERS, MarkerArray, queue_size=1, latch=True)

    def publish(self, found: FingerprintSet) -> List[FingerprintMessage]:
        """Publish a set in place of the previous one. Return the messages of its fingerprints."""
        stamp = rospy.Time.now()
        header = Header(stamp=stamp, frame_id=names.BASE_FRAME)
        messages = [fingerprint_message(stamp, found, item) for item in found.fingerprints]
        thumbnails = [image_message(stamp, item.thumbnail) for item in found.fingerprints]
        self._array.publish(FingerprintArray(header, messages, thumbnails))
        self._markers.publish(fingerprint_markers(stamp, found))
        return messages


def fingerprint_message(stamp: rospy.Time, found: FingerprintSet, item: Fingerprint) -> FingerprintMessage:
    """Return one fingerprint of a set as a message."""
    x, y, theta = map(float, item.centre)
    return FingerprintMessage(
        header=Header(stamp=stamp, frame_id=names.BASE_FRAME),
        session=found.session,
        name=item.name,
        kind=item.kind,
        x=x,
        y=y,
        theta=theta,
        views=len(item.states),
        updates=found.updates,
        importance=item.importance,
    )


def fingerprint_markers(stamp: rospy.Time, found: FingerprintSet) -> MarkerArray:
    """Return a disc and a name for each fingerprint; earlier markers are deleted."""
    markers = [Marker(action=Marker.DELETEALL)]
    for number, item in enumerate(found.fingerprints):
        colour = BLANK_COLOUR if item.kind == BLANK else OBJECT_COLOUR
        markers.append(disc_marker(stamp, "fingerprints", number, item.centre, colour))
        markers.append(label_marker(stamp, "fingerprint_names", number, item.centre, item.name))
    return MarkerArray(markers)
