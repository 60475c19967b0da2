"""A commander's hold on the arm: it lasts for a while after each command, and longer while signs of life are sent."""

from __future__ import annotations

import math
import threading
import time
from typing import Callable

import rospy

from embodied_active_learning.errors import CommandError
from embodied_active_learning.ros.runtime.timers import WallTimer

SIGNS_OF_LIFE = 3
"""Sent in the time after which the arm takes its commander for dead."""


class Lease:
    """Whether this node has the arm, as far as it knows. A thread extends the hold until it is ended.

    That thread stops with the process: an arm whose commander is killed or frozen is free after the timeout.
    """

    def __init__(self, timeout: float, keep: Callable[[], bool]) -> None:
        """Timeout: wall seconds that the arm grants. keep() asks it for more, and answers whether that was granted."""
        self._timeout = timeout
        self._keep = keep
        self._lock = threading.Lock()
        self._granted_at = -math.inf
        WallTimer(timeout / SIGNS_OF_LIFE, self.extend)

    @property
    def is_held(self) -> bool:
        """Whether the arm is still ours; if not, others may have moved it."""
        return time.monotonic() <= self._granted_at + self._timeout

    def renew(self) -> None:
        """Count the timeout from now on: the arm has taken a command."""
        with self._lock:
            self._granted_at = time.monotonic()

    def end(self) -> None:
        """Hold nothing any more: the arm was given back."""
        with self._lock:
            self._granted_at = -math.inf

    def extend(self) -> None:
        """Ask for more time, if there is anything to extend."""
        known, asked_at = self._granted_at, time.monotonic()
        if asked_at > known + self._timeout:
            return
        try:
            granted = self._keep()
        except CommandError as error:
            rospy.logdebug("%s", error)
            return
        with self._lock:
            if self._granted_at == known:  # else a command, or the end, came in between and says more
                self._granted_at = asked_at if granted else -math.inf
