"""A thread that must keep time: it calls a function at a rate of wall time, and counts how late it was."""

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
    """Calls a function at a rate. What it raises ends the pulse, and with it the node: an arm hangs on it."""

    def __init__(self, rate: float, function: Callable[[], None]) -> None:
        """Rate: Hz of wall time."""
        self._period = 1.0 / rate
        self._function = function
        self._late: Deque[float] = deque(maxlen=_KEPT)
        self._ended = threading.Event()
        self.failure: Optional[BaseException] = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Let no further call begin."""
        self._ended.set()

    def lateness(self, share: float) -> float:
        """Seconds by which this share of the last calls, 0 to 1, was late at most."""
        late = sorted(self._late)
        return late[max(0, math.ceil(share * len(late)) - 1)] if late else 0.0

    def _run(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            # A call that was late is not made up for: the next comes a whole period after it was due, or now.
            due = max(due + self._period, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
            self._late.append(time.monotonic() - due)
            try:
                self._function()
            except Exception as error:
                if not is_shutting_down():
                    self.failure = error
                    rospy.signal_shutdown(f"no set-points any more: {error!r}")
                return
