"""Publishes the outputs of the identification: beliefs, decisions, objects, open places, markers for rviz."""

from __future__ import annotations

import re
from typing import Dict, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import OccupancyGrid
from scipy.interpolate import RegularGridInterpolator
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from embodied_active_learning.msg import BeliefArray
from embodied_active_learning.objects.beliefs import BeliefGrid, shared_scale
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.objects.unknown import UnknownObject
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import occupancy_grid_message, pose_message
from embodied_active_learning.ros.objects.found_objects import FoundObjects
from embodied_active_learning.ros.objects.messages import belief_message
from embodied_active_learning.ros.rviz.belief_markers import belief_markers
from embodied_active_learning.ros.rviz.object_markers import decision_markers


class IdentificationOutput:
    """Latched publishers of the results; beliefs on the way are published for subscribers only."""

    def __init__(self) -> None:
        """Advertise the topics; those of the grids once their fingerprints are known."""
        self._beliefs = rospy.Publisher(names.BELIEFS, BeliefArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(names.DECISION_MARKERS, MarkerArray, queue_size=1, latch=True)
        self._reliefs = rospy.Publisher(names.BELIEF_MARKERS, MarkerArray, queue_size=1, latch=True)
        self._open_places = rospy.Publisher(names.OPEN_PLACES, PoseArray, queue_size=1, latch=True)
        self._published_places: np.ndarray = np.empty((0, 2))
        self._found = FoundObjects()
        self._grids: Dict[str, rospy.Publisher] = {}

    def publish_beliefs(self, targets: Sequence[SearchTarget], images: int) -> None:
        """Publish the beliefs after a number of images, on topics with subscribers."""
        self._publish_grids(targets, always=False)
        if self._beliefs.get_num_connections():
            self._publish_array(targets, images, (), finished=False)

    def publish_open_places(self, places: np.ndarray) -> None:
        """Publish the places (P, 2) [m] that need more views, unless they are those published last."""
        if not np.array_equal(places, self._published_places):
            poses = [pose_message([*place, 0.0]) for place in places]
            self._open_places.publish(PoseArray(Header(stamp=rospy.Time.now(), frame_id=names.FRAMES.base), poses))
            self._published_places = places

    def publish_result(
        self,
        targets: Sequence[SearchTarget],
        images: int,
        decisions: Sequence[Decision],
        unknown: Sequence[UnknownObject],
    ) -> None:
        """Publish the final beliefs, the decisions and the unknown objects."""
        self._publish_grids(targets, always=True)
        self._publish_array(targets, images, decisions, finished=True)
        self._markers.publish(decision_markers(rospy.Time.now(), decisions, unknown))
        self._found.publish(decisions, unknown)

    def _publish_array(
        self, targets: Sequence[SearchTarget], images: int, decisions: Sequence[Decision], finished: bool
    ) -> None:
        """Publish all beliefs in one message."""
        header = Header(stamp=rospy.Time.now(), frame_id=names.FRAMES.base)
        beliefs = [belief_message(target, decisions) for target in targets]
        self._beliefs.publish(BeliefArray(header, images, finished, beliefs))

    def _publish_grids(self, targets: Sequence[SearchTarget], always: bool) -> None:
        """Publish a grid and a marker per target, all with the same scale."""
        publishers = [self._grid_publisher(target) for target in targets]
        if not (always or any(item.get_num_connections() for item in [*publishers, self._reliefs])):
            return
        stamp = rospy.Time.now()
        maps = [target.grid.above_median() for target in targets]
        scale = shared_scale(maps)
        for target, publisher in zip(targets, publishers):
            if always or publisher.get_num_connections():
                publisher.publish(grid_message(stamp, target.grid, scale))
        self._reliefs.publish(belief_markers(stamp, targets, maps, scale))

    def _grid_publisher(self, target: SearchTarget) -> rospy.Publisher:
        """Publisher of a target's grid."""
        parts = (re.sub("[^a-zA-Z0-9]", "_", part) for part in (target.session, target.fingerprint.name))
        # ROS names begin with a letter; names of sessions may begin with a digit.
        topic = "/".join([names.BELIEF_GRIDS, *(part if part[0].isalpha() else f"s{part}" for part in parts)])
        if topic not in self._grids:
            self._grids[topic] = rospy.Publisher(topic, OccupancyGrid, queue_size=1, latch=True)
        return self._grids[topic]


def grid_message(stamp: rospy.Time, grid: BeliefGrid, scale: float) -> OccupancyGrid:
    """Return a belief as an occupancy grid: 0 at the median of the map and below, 100 at `scale` above it.

    An occupancy grid has square cells, so a belief with other cells is interpolated.
    """
    shown = np.clip(grid.above_median() / scale, 0.0, 1.0)
    cell = float(min(grid.x[1] - grid.x[0], grid.y[1] - grid.y[0]))
    x, y = (np.arange(axis[0], axis[-1] + 0.5 * cell, cell) for axis in (grid.x, grid.y))
    points = np.stack(np.meshgrid(x.clip(grid.x[0], grid.x[-1]), y.clip(grid.y[0], grid.y[-1]), indexing="ij"), axis=-1)
    return occupancy_grid_message(stamp, RegularGridInterpolator((grid.x, grid.y), shown)(points), x[0], y[0], cell)
