"""Periodic callbacks on wall time."""

from __future__ import annotations

import threading
from typing import Callable

import rospy

from embodied_active_learning.ros.runtime.log_throttle import LogThrottle


class WallTimer:
    """Calls a function every `period` seconds of wall time, in its own thread, until the node shuts down.

    An exception of the function is logged (throttled) and does not end the thread.
    """

    def __init__(self, period: float, function: Callable[[], None]) -> None:
        self._period = period
        self._function = function
        self._shutdown = threading.Event()
        self._throttle = LogThrottle()
        rospy.on_shutdown(self._shutdown.set)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while not self._shutdown.wait(self._period):
            try:
                self._function()
            except Exception as error:
                self._log(error)

    def _log(self, error: Exception) -> None:
        """Log an exception, except those of publishing to a topic that the shutdown has closed."""
        name = getattr(self._function, "__qualname__", str(self._function))
        message = f"{name} failed: {error!r}; retrying every {self._period:g} s"
        if not self._shutdown.is_set() and self._throttle.should_log(message):
            rospy.logerr("%s", message)
