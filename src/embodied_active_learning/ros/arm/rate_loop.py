"""A thread that calls a function at a fixed rate of wall time and measures how late each call was."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from typing import Callable, Deque, Optional

import rospy

from embodied_active_learning.ros.runtime.node import is_shutting_down

_KEPT = 1000
"""Calls whose lateness is kept."""


class RateLoop:
    """Calls a function at a fixed rate. An exception ends the loop and shuts the node down: an arm depends on it."""

    def __init__(self, rate: float, function: Callable[[], None]) -> None:
        """Rate: Hz of wall time."""
        self._period = 1.0 / rate
        self._function = function
        self._lateness: Deque[float] = deque(maxlen=_KEPT)
        self._ended = threading.Event()
        self.failure: Optional[BaseException] = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Start no further call."""
        self._ended.set()

    def lateness(self, fraction: float) -> float:
        """Return the quantile `fraction`, 0 to 1, of the lateness of the last calls, in seconds."""
        lateness = sorted(self._lateness)
        return lateness[max(0, math.ceil(fraction * len(lateness)) - 1)] if lateness else 0.0

    def _run(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            # A late call is not made up for: the next one is due a whole period after the last was, or now.
            due = max(due + self._period, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            self._lateness.append(time.monotonic() - due)
            try:
                self._function()
            except Exception as error:
                if not is_shutting_down():
                    self.failure = error
                    rospy.signal_shutdown(f"set-point thread failed: {error!r}")
                return
