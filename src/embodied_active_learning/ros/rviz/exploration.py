"""What rviz shows of exploration, as standard messages: paths, distributions over the workspace, the workspace box."""

from __future__ import annotations

import time

import numpy as np
import rospy
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from embodied_active_learning.config import Config
from embodied_active_learning.pipeline.exploration import Assessment, ExplorationRun
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import cloud_message, path_message, workspace_marker

PERIOD = 0.3
"""Wall seconds between two pictures: a long path takes a while to pack."""
RELIEF = 0.06
"""Height [m] of the largest value of a distribution above its plane."""


class RvizExploration:
    """Publishes paths and clouds while somebody looks, and the workspace once."""

    def __init__(self, config: Config) -> None:
        self._height = config.camera.distance
        self._travelled = rospy.Publisher(names.TRAVELLED_PATH, Path, queue_size=1, latch=True)
        self._planned = rospy.Publisher(names.PLANNED_PATH, Path, queue_size=1, latch=True)
        self._target = rospy.Publisher(names.TARGET_CLOUD, PointCloud2, queue_size=1, latch=True)
        self._time_average = rospy.Publisher(names.TIME_AVERAGE_CLOUD, PointCloud2, queue_size=1, latch=True)
        self._workspace = rospy.Publisher(names.WORKSPACE_MARKER, Marker, queue_size=1, latch=True)
        self._workspace.publish(workspace_marker(config.workspace.box(), self._height))
        self._shown_at = 0.0

    def show(self, stamp: rospy.Time, run: ExplorationRun, assessment: Assessment, last: bool = False) -> None:
        """Publish the step, unless the last picture is fresh or nobody looks; the last step of a run always."""
        if not last and (time.monotonic() < self._shown_at + PERIOD or not self._is_watched()):
            return
        self._shown_at = time.monotonic()
        samples = run.sample_states
        self._travelled.publish(path_message(stamp, run.travelled_states, self._height))
        self._planned.publish(path_message(stamp, run.planned_states, self._height))
        self._target.publish(_relief(stamp, samples, assessment.target, 0.0))
        self._time_average.publish(_relief(stamp, samples, assessment.time_average, self._height / 2.0))

    def _is_watched(self) -> bool:
        publishers = (self._travelled, self._planned, self._target, self._time_average)
        return any(publisher.get_num_connections() for publisher in publishers)


def _relief(stamp: rospy.Time, states: np.ndarray, values: np.ndarray, base: float) -> PointCloud2:
    """Values (S,) at states (S, 3) as a relief above the plane at height base [m]."""
    shares = values / values.max()
    points = np.column_stack([states[:, :2], base + RELIEF * shares])
    return cloud_message(stamp, points, shares)
