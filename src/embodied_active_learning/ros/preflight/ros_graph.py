"""What one node can see of a running system without touching anything: topics, services, nodes, frames."""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from typing import Any, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple
from urllib.parse import urlparse

import numpy as np
import rosgraph
import rospy
import tf2_ros

from embodied_active_learning.geometry import rotation_matrix
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.preflight.computer import Peer
from embodied_active_learning.ros.preflight.topics import Stream
from embodied_active_learning.ros.runtime.master import connection_error

KEPT = 30
"""Newest messages of a topic that are kept."""
_BUFFER = 2**26  # bytes: with a buffer smaller than an image, old ones would queue up in the socket
_LOOK_PERIOD = 0.05  # s


class Graph(NamedTuple):
    """Who publishes and offers what, by the master."""

    publishers: Dict[str, List[str]]
    services: Dict[str, List[str]]
    nodes: Tuple[str, ...]


def look_at_graph() -> Graph:
    """What the master knows of others than this node."""
    publishers, subscribers, services = (
        {name: [node for node in nodes if node != rospy.get_name()] for name, nodes in part}
        for part in rosgraph.Master(rospy.get_name()).getSystemState()
    )
    nodes = {node for part in (publishers, subscribers, services) for some in part.values() for node in some}
    return Graph(publishers, services, tuple(sorted(nodes)))


def look_for_peers(nodes: Sequence[str]) -> List[Peer]:
    """Every node with its address, and whether it answers from here."""
    master = rosgraph.Master(rospy.get_name())
    peers = []
    for node in nodes:
        with suppress(rosgraph.MasterException):  # it has ended meanwhile
            uri = master.lookupNode(node)
            host = urlparse(uri).hostname or uri
            peers.append(Peer(node, host, connection_error(uri), is_local(host)))
    return peers


def is_local(host: str) -> bool:
    """Whether a host's name or address is this computer's."""
    return is_loopback(host) or rosgraph.network.is_local_address(host)


def is_loopback(host: str) -> bool:
    """Whether a host's name or address is one that every computer calls itself."""
    return host == "localhost" or host.startswith("127.") or host == "::1"


class TopicMonitor:
    """Listens to one topic."""

    def __init__(self, name: str, message_class: Any, graph: Graph) -> None:
        self.topic = rospy.resolve_name(name)
        self.messages: Deque[Any] = deque(maxlen=KEPT)
        self._published = bool(graph.publishers.get(self.topic))
        self._arrivals: List[float] = []
        self._ages: List[float] = []
        self._began = time.monotonic()
        self._subscriber = rospy.Subscriber(name, message_class, self._hear, queue_size=KEPT, buff_size=_BUFFER)

    @property
    def is_done(self) -> bool:
        """Whether nothing more is to be expected where messages may come only once."""
        return bool(self._arrivals) or not self._published

    def close(self) -> Stream:
        """Stop listening -> what was heard."""
        self._subscriber.unregister()
        listened = time.monotonic() - self._began
        count = min(len(self._arrivals), len(self._ages))
        return Stream(self.topic, listened, self._arrivals[:count], self._ages[:count], self._published)

    def _hear(self, message: Any) -> None:
        self.messages.append(message)
        self._ages.append((rospy.Time.now() - message.header.stamp).to_sec())
        self._arrivals.append(time.monotonic() - self._began)


class TfMonitor:
    """Where tf has the camera."""

    def __init__(self) -> None:
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)

    @property
    def is_done(self) -> bool:
        """Whether the camera's place is known."""
        return self._buffer.can_transform(names.BASE_FRAME, names.CAMERA_FRAME, rospy.Time())

    def camera_at(self, states: Sequence[PlanarState]) -> Tuple[np.ndarray, Optional[PlanarState]]:
        """(4, 4) pose of the camera in the base frame at the stamp of the newest possible state, and that state.

        The newest pose, and no state, where tf has none of their stamps. Raises tf2_ros.TransformException.
        """
        for state in reversed(states):
            stamp = state.header.stamp
            if self._buffer.can_transform(names.BASE_FRAME, names.CAMERA_FRAME, stamp):
                return self._pose(stamp), state
        return self._pose(rospy.Time()), None

    def _pose(self, stamp: rospy.Time) -> np.ndarray:
        transform = self._buffer.lookup_transform(names.BASE_FRAME, names.CAMERA_FRAME, stamp).transform
        place, turn = transform.translation, transform.rotation
        pose = np.eye(4)
        pose[:3, :3] = rotation_matrix(turn.x, turn.y, turn.z, turn.w)
        pose[:3, 3] = place.x, place.y, place.z
        return pose


def listen(ears: Sequence[Any], seconds: float, once: bool) -> None:
    """Let wall time pass while the ears hear; once: no longer than until each is done."""
    ends_at = time.monotonic() + seconds
    while time.monotonic() < ends_at and not rospy.is_shutdown():
        if once and all(ear.is_done for ear in ears):
            return
        time.sleep(_LOOK_PERIOD)
