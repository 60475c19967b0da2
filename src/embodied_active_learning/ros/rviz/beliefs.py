"""What the identifier tells: beliefs as messages, and grids and markers for rviz."""

from __future__ import annotations

import re
from typing import Dict, List, Sequence

import numpy as np
import rospy
from nav_msgs.msg import OccupancyGrid
from scipy.interpolate import RegularGridInterpolator
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from embodied_active_learning.msg import Belief, BeliefArray
from embodied_active_learning.msg import Decision as DecisionMessage
from embodied_active_learning.objects.beliefs import BeliefGrid
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.search_target import SearchTarget
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import occupancy_grid_message
from embodied_active_learning.ros.rviz.fingerprints import BLANK_COLOUR, disc_marker, label_marker

FOUND_COLOUR = ColorRGBA(0.1, 0.7, 0.2, 0.6)


class RvizBeliefs:
    """Publishes beliefs while somebody looks, and the last ones always; latched."""

    def __init__(self) -> None:
        self._beliefs = rospy.Publisher(names.BELIEFS, BeliefArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(names.DECISION_MARKERS, MarkerArray, queue_size=1, latch=True)
        self._grids: Dict[str, rospy.Publisher] = {}

    def publish(
        self, sought: Sequence[SearchTarget], images: int, decisions: Sequence[Decision], finished: bool
    ) -> None:
        """Publish what is believed after so many images; decisions are empty before all are looked at."""
        stamp = rospy.Time.now()
        for item in sought:
            publisher = self._grid_publisher(item)
            if finished or publisher.get_num_connections():
                publisher.publish(grid_message(stamp, item.grid))
        if finished or self._beliefs.get_num_connections():
            header = Header(stamp=stamp, frame_id=names.BASE_FRAME)
            beliefs = [belief_message(item, decisions) for item in sought]
            self._beliefs.publish(BeliefArray(header, images, finished, beliefs))
        if finished:
            self._markers.publish(decision_markers(stamp, decisions))

    def _grid_publisher(self, item: SearchTarget) -> rospy.Publisher:
        parts = (re.sub("[^a-zA-Z0-9]", "_", part) for part in (item.session, item.fingerprint.name))
        # A name in ROS begins with a letter, that of a session may begin with a digit.
        topic = "/".join([names.BELIEF_GRIDS, *(part if part[0].isalpha() else f"s{part}" for part in parts)])
        if topic not in self._grids:
            self._grids[topic] = rospy.Publisher(topic, OccupancyGrid, queue_size=1, latch=True)
        return self._grids[topic]


def belief_message(item: SearchTarget, decisions: Sequence[Decision]) -> Belief:
    """The belief about one fingerprint, and what was decided about it."""
    grid = item.grid
    axes = (grid.x, grid.y, grid.yaw)
    return Belief(
        item.session,
        item.fingerprint.name,
        [len(axis) for axis in axes],
        [float(axis[0]) for axis in axes],
        [float(axis[1] - axis[0]) for axis in axes],
        grid.mean.astype(np.float32).ravel(),
        grid.std.astype(np.float32).ravel(),
        [decision_message(decision) for decision in decisions_about(decisions, item.session, item.fingerprint.name)],
    )


def decision_message(decision: Decision) -> DecisionMessage:
    """A decision as a message."""
    x, y, theta = map(float, decision.pose)
    return DecisionMessage(
        session=decision.session,
        fingerprint=decision.fingerprint,
        kind=decision.kind,
        found=decision.found,
        instance=decision.instance,
        x=x,
        y=y,
        theta=theta,
        confidence=decision.confidence,
        residual=decision.residual,
        belief_mean=decision.belief_mean,
        belief_std=decision.belief_std,
        views=decision.views,
        reason=decision.reason,
    )


def grid_message(stamp: rospy.Time, grid: BeliefGrid) -> OccupancyGrid:
    """The largest mean over yaw at each place, stretched from its median, 0, to its maximum, 100.

    The differences that matter are a few hundredths of a belief: unstretched, nothing would be seen. An occupancy grid
    has square cells, so a grid whose cells are not is interpolated.
    """
    values, _ = grid.over_yaw()
    low, high = float(np.median(values)), float(values.max())
    shown = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0)
    cell = float(min(grid.x[1] - grid.x[0], grid.y[1] - grid.y[0]))
    x, y = (np.arange(axis[0], axis[-1] + 0.5 * cell, cell) for axis in (grid.x, grid.y))
    points = np.stack(np.meshgrid(x.clip(grid.x[0], grid.x[-1]), y.clip(grid.y[0], grid.y[-1]), indexing="ij"), axis=-1)
    return occupancy_grid_message(stamp, RegularGridInterpolator((grid.x, grid.y), shown)(points), x[0], y[0], cell)


def decision_markers(stamp: rospy.Time, decisions: Sequence[Decision]) -> MarkerArray:
    """A disc and a text for each place where something was found, in place of all earlier markers."""
    markers: List[Marker] = [Marker(action=Marker.DELETEALL)]
    for number, decision in enumerate(item for item in decisions if item.found):
        colour = BLANK_COLOUR if decision.kind == BLANK else FOUND_COLOUR
        text = f"{decision.session}/{decision.fingerprint} {decision.confidence:.2f}"
        markers.append(disc_marker(stamp, "decisions", number, decision.pose, colour))
        markers.append(label_marker(stamp, "decision_names", number, decision.pose, text))
    return MarkerArray(markers)
