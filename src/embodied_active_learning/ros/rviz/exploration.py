"""rviz displays of exploration as standard messages: paths, distributions over the workspace, the workspace box."""

from __future__ import annotations

import time

import numpy as np
import rospy
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from embodied_active_learning.config import Config
from embodied_active_learning.pipeline.exploration import ExplorationRun, StepMetrics
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import cloud_message, path_message, workspace_marker

PERIOD = 0.3
"""Wall seconds between two updates of the display: serialising a long path takes a while."""
RELIEF = 0.06
"""Height [m] of the largest value of a distribution above its plane."""


class RvizExploration:
    """Publishes paths and clouds while they have subscribers, and the workspace once."""

    def __init__(self, config: Config) -> None:
        self._height = config.camera.distance
        self._travelled = rospy.Publisher(names.TRAVELLED_PATH, Path, queue_size=1, latch=True)
        self._planned = rospy.Publisher(names.PLANNED_PATH, Path, queue_size=1, latch=True)
        self._target = rospy.Publisher(names.TARGET_CLOUD, PointCloud2, queue_size=1, latch=True)
        self._time_average = rospy.Publisher(names.TIME_AVERAGE_CLOUD, PointCloud2, queue_size=1, latch=True)
        self._workspace = rospy.Publisher(names.WORKSPACE_MARKER, Marker, queue_size=1, latch=True)
        self._workspace.publish(workspace_marker(config.workspace.box(), self._height))
        self._step_shown_at = 0.0
        self._plan_shown_at = 0.0

    def show_step(self, stamp: rospy.Time, run: ExplorationRun, metrics: StepMetrics, last: bool = False) -> None:
        """Publish the step unless the display is recent or has no subscribers; always publish the last step."""
        now = time.monotonic()
        is_watched = any(p.get_num_connections() for p in (self._travelled, self._target, self._time_average))
        if not last and (now < self._step_shown_at + PERIOD or not is_watched):
            return
        self._step_shown_at = now
        samples = run.sample_states
        self._travelled.publish(path_message(stamp, run.travelled_states, self._height))
        self._target.publish(_relief(stamp, samples, metrics.target, 0.0))
        self._time_average.publish(_relief(stamp, samples, metrics.time_average, self._height / 2.0))

    def show_plan(self, stamp: rospy.Time, states: np.ndarray) -> None:
        """Publish the planned states (H, 3) [m, m, rad], if any, unless the display is recent or has no subscribers."""
        now = time.monotonic()
        if len(states) and now >= self._plan_shown_at + PERIOD and self._planned.get_num_connections():
            self._plan_shown_at = now
            self._planned.publish(path_message(stamp, states, self._height))


def _relief(stamp: rospy.Time, states: np.ndarray, values: np.ndarray, base: float) -> PointCloud2:
    """Draw values (S,) at states (S, 3) as a relief above the plane at height base [m]."""
    shares = values / values.max()
    points = np.column_stack([states[:, :2], base + RELIEF * shares])
    return cloud_message(stamp, points, shares)
