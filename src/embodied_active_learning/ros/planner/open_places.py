"""Places about which an identification needs more views, as the identifier publishes them."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import PoseArray

from embodied_active_learning.ros import names


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
