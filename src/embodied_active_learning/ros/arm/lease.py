"""A commander's lease on the arm: granted for a while with each command and heartbeat."""

from __future__ import annotations

import math
import threading
import time
from typing import Callable

import rospy

from embodied_active_learning.errors import CommandError
from embodied_active_learning.ros.runtime.timers import WallTimer

HEARTBEATS = 3
"""Heartbeats per timeout of the lease."""


class Lease:
    """Whether this node is in control of the arm, as far as it knows. A thread sends heartbeats until it is ended.

    The thread dies with the process, so the arm is free after the timeout if its commander is killed or frozen.
    """

    def __init__(self, timeout: float, heartbeat: Callable[[], bool]) -> None:
        """Timeout: wall seconds that the arm grants. heartbeat() asks for an extension and returns whether granted."""
        self._timeout = timeout
        self._heartbeat = heartbeat
        self._lock = threading.Lock()
        self._granted_at = -math.inf
        WallTimer(timeout / HEARTBEATS, self.extend)

    @property
    def is_held(self) -> bool:
        """Whether the lease has not expired; once it has, other nodes may have moved the arm."""
        return time.monotonic() <= self._granted_at + self._timeout

    def renew(self) -> None:
        """Start the timeout: the arm has accepted a command."""
        with self._lock:
            self._granted_at = time.monotonic()

    def end(self) -> None:
        """Give up the lease: control was released."""
        with self._lock:
            self._granted_at = -math.inf

    def extend(self) -> None:
        """Send a heartbeat while the lease is held, and adopt the arm's response."""
        known, asked_at = self._granted_at, time.monotonic()
        if asked_at > known + self._timeout:
            return
        try:
            granted = self._heartbeat()
        except CommandError as error:
            rospy.logdebug("%s", error)
            return
        with self._lock:
            if self._granted_at == known:  # else a command, or the end, came in between and is more recent
                self._granted_at = asked_at if granted else -math.inf
