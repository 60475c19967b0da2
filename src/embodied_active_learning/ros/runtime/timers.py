"""Something done again and again in a thread of its own, on wall time."""

from __future__ import annotations

import threading
import time
from typing import Callable

import rospy

REPEAT_AFTER = 5.0
"""Wall seconds after which a node says again what is still the case."""


class WallTimer:
    """Calls a function every period of wall time in a thread of its own, until the node ends.

    What the function raises is said, every few seconds while it lasts, and does not end the thread.
    """

    def __init__(self, period: float, function: Callable[[], None]) -> None:
        self._period = period
        self._function = function
        self._ended = threading.Event()
        self._say_at = 0.0
        rospy.on_shutdown(self._ended.set)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while not self._ended.wait(self._period):
            try:
                self._function()
            except Exception as error:
                self._say(error)

    def _say(self, error: Exception) -> None:
        # A node that ends closes its topics under the feet of whoever still publishes.
        if not self._ended.is_set() and time.monotonic() >= self._say_at:
            what = getattr(self._function, "__qualname__", self._function)
            rospy.logerr("%s went wrong, and is tried again every %g s: %r", what, self._period, error)
            self._say_at = time.monotonic() + REPEAT_AFTER
