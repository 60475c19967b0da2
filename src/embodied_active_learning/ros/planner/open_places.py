"""Places about which an identification needs more views, from the identifier to the planner."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import PoseArray
from std_msgs.msg import Header

from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import pose_message


class OpenPlacesPublisher:
    """Publishes the places, latched, whenever they change."""

    def __init__(self) -> None:
        """Advertise the topic."""
        self._publisher = rospy.Publisher(names.OPEN_PLACES, PoseArray, queue_size=1, latch=True)
        self._published: np.ndarray = np.empty((0, 2))

    def publish(self, places: np.ndarray) -> None:
        """Publish places (P, 2) [m] unless they are those published last."""
        if not np.array_equal(places, self._published):
            poses = [pose_message([*place, 0.0]) for place in places]
            self._publisher.publish(PoseArray(Header(stamp=rospy.Time.now(), frame_id=names.FRAMES.base), poses))
            self._published = places


class OpenPlaces:
    """The places published last; none without an identification."""

    def __init__(self) -> None:
        """Subscribe to the topic."""
        self.places: np.ndarray = np.empty((0, 2))
        """(P, 2) [m]; replaced, never changed, by the subscriber's thread."""
        rospy.Subscriber(names.OPEN_PLACES, PoseArray, self._on_message, queue_size=1)

    def _on_message(self, message: PoseArray) -> None:
        places = np.array([[pose.position.x, pose.position.y] for pose in message.poses]).reshape(-1, 2)
        self.places = places[np.isfinite(places).all(axis=1)]
