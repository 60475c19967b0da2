"""Found objects as standard messages: a pose array and a tf frame for each."""

from __future__ import annotations

from typing import List, Sequence

import rospy
from geometry_msgs.msg import PoseArray, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import pose_message


class FoundObjects:
    """Latched publishers of the poses of found objects.

    A subscriber to tf keeps the frames of an earlier identification until it restarts; new subscribers get the frames
    of the last one.
    """

    def __init__(self) -> None:
        """Advertise the topics."""
        self._poses = rospy.Publisher(names.FOUND_OBJECTS, PoseArray, queue_size=1, latch=True)
        self._unknown = rospy.Publisher(names.UNKNOWN_OBJECTS, PoseArray, queue_size=1, latch=True)
        # Not a StaticTransformBroadcaster, which would repeat the frames of earlier identifications.
        self._frames = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)

    def publish(self, decisions: Sequence[Decision], unknown: Sequence[UnknownObject]) -> None:
        """Publish all found objects, without blanks, and all unknown ones."""
        found = found_objects(decisions)
        header = Header(stamp=rospy.Time.now(), frame_id=names.FRAMES.base)
        self._poses.publish(PoseArray(header, [pose_message(decision.pose) for decision in found]))
        self._unknown.publish(PoseArray(header, [pose_message([*item.place, 0.0]) for item in unknown]))
        self._frames.publish(TFMessage([frame_message(header, decision) for decision in found]))


def found_objects(decisions: Sequence[Decision]) -> List[Decision]:
    """Return the decisions with a found object, without blanks."""
    return [decision for decision in decisions if decision.found and decision.kind != BLANK]


def frame_message(header: Header, decision: Decision) -> TransformStamped:
    """Return the tf frame `found/<session>/<fingerprint>/<instance>` of a decision."""
    pose = pose_message(decision.pose)
    frame = f"found/{decision.session}/{decision.fingerprint}/{decision.instance}"
    position = Vector3(pose.position.x, pose.position.y, pose.position.z)
    return TransformStamped(header, frame, Transform(position, pose.orientation))
