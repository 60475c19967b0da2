"""What the fingerprinter tells: the stored fingerprints as messages, and as markers for rviz."""

from __future__ import annotations

from typing import List

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.msg import Fingerprint as FingerprintMessage
from embodied_active_learning.msg import FingerprintArray
from embodied_active_learning.objects.fingerprint import BLANK, Fingerprint, FingerprintSet
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import image_message

DISC_RADIUS = 0.045  # m
LABEL_HEIGHT = 0.10  # m above the table: over the objects
LABEL_SIZE = 0.02  # m
OBJECT_COLOUR = ColorRGBA(0.95, 0.6, 0.1, 0.5)
BLANK_COLOUR = ColorRGBA(0.5, 0.5, 0.5, 0.4)


class RvizFingerprints:
    """Latched publishers of the fingerprints that are stored."""

    def __init__(self) -> None:
        self._array = rospy.Publisher(names.FINGERPRINTS, FingerprintArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(names.FINGERPRINT_MARKERS, MarkerArray, queue_size=1, latch=True)

    def publish(self, found: FingerprintSet) -> List[FingerprintMessage]:
        """Publish a set in place of the last one -> its messages."""
        stamp = rospy.Time.now()
        messages = [fingerprint_message(stamp, found, item) for item in found.fingerprints]
        self._array.publish(FingerprintArray(Header(stamp=stamp, frame_id=names.BASE_FRAME), messages))
        self._markers.publish(fingerprint_markers(stamp, found))
        return messages


def fingerprint_message(stamp: rospy.Time, found: FingerprintSet, item: Fingerprint) -> FingerprintMessage:
    """One fingerprint of a set as a message."""
    return FingerprintMessage(
        Header(stamp=stamp, frame_id=names.BASE_FRAME),
        found.session,
        item.name,
        item.kind,
        *item.centre.tolist(),
        len(item.states),
        found.updates,
        item.importance,
        image_message(stamp, item.thumbnail),
    )


def fingerprint_markers(stamp: rospy.Time, found: FingerprintSet) -> MarkerArray:
    """A disc and a name for each fingerprint, in place of all earlier markers."""
    markers = [Marker(action=Marker.DELETEALL)]
    for number, item in enumerate(found.fingerprints):
        colour = BLANK_COLOUR if item.kind == BLANK else OBJECT_COLOUR
        markers.append(disc_marker(stamp, "fingerprints", number, item.centre, colour))
        markers.append(label_marker(stamp, "fingerprint_names", number, item.centre, item.name))
    return MarkerArray(markers)


def disc_marker(stamp: rospy.Time, space: str, number: int, centre, colour: ColorRGBA) -> Marker:
    """A flat disc on the table at a centre (x, y, ...) [m]."""
    size = Vector3(2.0 * DISC_RADIUS, 2.0 * DISC_RADIUS, 0.002)
    return _marker(
        stamp, space, number, Marker.CYLINDER, Point(float(centre[0]), float(centre[1]), 0.001), size, colour
    )


def label_marker(stamp: rospy.Time, space: str, number: int, centre, text: str) -> Marker:
    """A text over the object at a centre (x, y, ...) [m]."""
    place = Point(float(centre[0]), float(centre[1]), LABEL_HEIGHT)
    size, black = Vector3(0.0, 0.0, LABEL_SIZE), ColorRGBA(0.05, 0.05, 0.05, 1.0)
    marker = _marker(stamp, space, number, Marker.TEXT_VIEW_FACING, place, size, black)
    marker.text = text
    return marker


def _marker(
    stamp: rospy.Time, space: str, number: int, kind: int, place: Point, size: Vector3, colour: ColorRGBA
) -> Marker:
    marker = Marker(type=kind, action=Marker.ADD, ns=space, id=number, scale=size, color=colour)
    marker.header = Header(stamp=stamp, frame_id=names.BASE_FRAME)
    marker.pose = Pose(place, Quaternion(0.0, 0.0, 0.0, 1.0))
    return marker
