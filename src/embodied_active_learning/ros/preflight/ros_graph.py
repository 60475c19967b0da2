"""Observation of the ROS graph, of topics and of tf, without side effects."""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from typing import Any, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple, Union
from urllib.parse import urlparse

import numpy as np
import rosgraph
import rospy
import tf2_ros

from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.conversions import pose_matrix
from embodied_active_learning.ros.preflight.network import Peer
from embodied_active_learning.ros.preflight.topics import TopicStatistics
from embodied_active_learning.ros.runtime.master import connection_error

MAX_MESSAGES = 30
"""Number of newest messages kept for each topic."""
_BUFFER = 2**26  # bytes; with a buffer smaller than an image, old images queue up in the socket
_POLL_PERIOD = 0.05  # s


class RosGraph(NamedTuple):
    """Publishers and service providers by name, and all nodes, without this one."""

    publishers: Dict[str, List[str]]
    services: Dict[str, List[str]]
    nodes: Tuple[str, ...]


def read_graph() -> RosGraph:
    """Return the graph as the master knows it."""
    publishers, subscribers, services = (
        {name: [node for node in nodes if node != rospy.get_name()] for name, nodes in part}
        for part in rosgraph.Master(rospy.get_name()).getSystemState()
    )
    nodes = {node for part in (publishers, subscribers, services) for some in part.values() for node in some}
    return RosGraph(publishers, services, tuple(sorted(nodes)))


def find_peers(nodes: Sequence[str]) -> List[Peer]:
    """Return address and reachability of nodes."""
    master = rosgraph.Master(rospy.get_name())
    peers = []
    for node in nodes:
        with suppress(rosgraph.MasterException):  # the node has ended meanwhile
            uri = master.lookupNode(node)
            host = urlparse(uri).hostname or uri
            peers.append(Peer(node, host, connection_error(uri), is_local(host)))
    return peers


def is_local(host: str) -> bool:
    """Return whether a host name or address belongs to this computer."""
    return is_loopback(host) or rosgraph.network.is_local_address(host)


def is_loopback(host: str) -> bool:
    """Return whether a host name or address means the computer that uses it."""
    return host == "localhost" or host.startswith("127.") or host == "::1"


class TopicMonitor:
    """Subscribes to a topic; keeps statistics and the newest messages."""

    def __init__(self, name: str, message_class: Any, graph: RosGraph) -> None:
        self.topic = rospy.resolve_name(name)
        self.messages: Deque[Any] = deque(maxlen=MAX_MESSAGES)
        self._published = bool(graph.publishers.get(self.topic))
        self._arrivals: List[float] = []
        self._ages: List[float] = []
        self._started_at = time.monotonic()
        self._subscriber = rospy.Subscriber(
            name, message_class, self._on_message, queue_size=MAX_MESSAGES, buff_size=_BUFFER
        )

    @property
    def is_complete(self) -> bool:
        """Whether a message has arrived, or none can be expected."""
        return bool(self._arrivals) or not self._published

    def close(self) -> TopicStatistics:
        """Unsubscribe and return the statistics."""
        self._subscriber.unregister()
        duration = time.monotonic() - self._started_at
        count = min(len(self._arrivals), len(self._ages))
        return TopicStatistics(self.topic, duration, self._arrivals[:count], self._ages[:count], self._published)

    def _on_message(self, message: Any) -> None:
        self.messages.append(message)
        self._ages.append((rospy.Time.now() - message.header.stamp).to_sec())
        self._arrivals.append(time.monotonic() - self._started_at)


class TfMonitor:
    """Listens to tf and returns the pose of the camera in the base frame."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    @property
    def is_complete(self) -> bool:
        """Whether the camera's pose is known."""
        return self._has_pose(rospy.Time())

    def camera_pose(self, states: Sequence[PlanarState]) -> Tuple[np.ndarray, Optional[PlanarState]]:
        """Return the camera's pose (4, 4) at the stamp of the newest possible state, and that state.

        The newest pose and None if tf covers none of the stamps. Raises tf2_ros.TransformException.
        """
        for state in reversed(states):
            if self._has_pose(state.header.stamp):
                return self._pose(state.header.stamp), state
        return self._pose(rospy.Time()), None

    def _has_pose(self, stamp: rospy.Time) -> bool:
        return self._buffer.can_transform(names.FRAMES.base, names.CAMERA_FRAME, stamp)

    def _pose(self, stamp: rospy.Time) -> np.ndarray:
        transform = self._buffer.lookup_transform(names.FRAMES.base, names.CAMERA_FRAME, stamp).transform
        return pose_matrix(transform.translation, transform.rotation)


def collect(monitors: Sequence[Union[TopicMonitor, TfMonitor]], seconds: float, stop_early: bool) -> None:
    """Wait some seconds of wall time while the monitors receive messages; stop_early: until all are complete."""
    ends_at = time.monotonic() + seconds
    while time.monotonic() < ends_at and not rospy.is_shutdown():
        if stop_early and all(monitor.is_complete for monitor in monitors):
            return
        time.sleep(_POLL_PERIOD)
