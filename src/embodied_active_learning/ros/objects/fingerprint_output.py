"""Publishes the stored fingerprints as messages and as markers for rviz, and reports new ones."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import List

import rospy
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from embodied_active_learning.config import Config
from embodied_active_learning.errors import SessionError
from embodied_active_learning.msg import Fingerprint as FingerprintMessage
from embodied_active_learning.msg import FingerprintArray
from embodied_active_learning.objects.fingerprint import FingerprintSet
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import image_message
from embodied_active_learning.ros.objects.messages import fingerprint_message
from embodied_active_learning.ros.runtime.node import try_to_draw
from embodied_active_learning.ros.rviz.object_markers import fingerprint_markers
from embodied_active_learning.session.paths import SessionPaths
from embodied_active_learning.simulation.truth import true_scene


class FingerprintOutput:
    """Latched publishers of the stored fingerprints."""

    def __init__(self) -> None:
        """Advertise the topics."""
        self._array = rospy.Publisher(names.FINGERPRINTS, FingerprintArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(names.FINGERPRINT_MARKERS, MarkerArray, queue_size=1, latch=True)

    def publish(self, found: FingerprintSet) -> List[FingerprintMessage]:
        """Publish a set in place of the previous one. Return the messages of its fingerprints."""
        stamp = rospy.Time.now()
        header = Header(stamp=stamp, frame_id=names.FRAMES.base)
        messages = [fingerprint_message(stamp, found, item) for item in found.fingerprints]
        thumbnails = [image_message(stamp, item.thumbnail) for item in found.fingerprints]
        self._array.publish(FingerprintArray(header, messages, thumbnails))
        self._markers.publish(fingerprint_markers(stamp, found))
        return messages

    def publish_stored(self, session: Path) -> None:
        """Publish the fingerprints of a session folder, if it has any."""
        if not SessionPaths(session).fingerprints.exists():
            return
        stored = import_module("embodied_active_learning.session.fingerprints")  # slow, because of the model
        try:
            if stored.has_fingerprints(session):
                self.publish(stored.load_fingerprints(session))
        except SessionError as error:
            rospy.logerr("stored fingerprints are not published: %s", error)


def report_fingerprints(session: Path, found: FingerprintSet, config: Config) -> None:
    """Draw the fingerprints of a session folder, and log them with the path of the figure."""
    draw = import_module("embodied_active_learning.figures.fingerprint_sheet").draw_fingerprints  # slow
    path = SessionPaths(session).figures / "fingerprints.png"
    figure = try_to_draw(draw, path, found, true_scene(config).objects, config.session.pdf_figures) or "none"
    listed = ", ".join(item.name for item in found.fingerprints)
    rospy.loginfo("fingerprints: %s\n  session  %s\n  figure   %s", listed, session, figure)
