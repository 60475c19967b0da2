"""Saying what stays the case: when it is new, and now and then afterwards."""

from __future__ import annotations

import math
import threading
import time
from typing import Callable

from embodied_active_learning.ros.runtime.timers import REPEAT_AFTER


class LogThrottle:
    """Tells whether a sentence is due. On wall time, because simulated time stands still while nobody moves the arm."""

    def __init__(self, period: float = REPEAT_AFTER, clock: Callable[[], float] = time.monotonic) -> None:
        """Period [s] after which the same sentence is due again."""
        self._period = period
        self._clock = clock
        self._lock = threading.Lock()
        self._sentence = ""
        self._said_at = -math.inf

    def is_due(self, sentence: str) -> bool:
        """Whether to say it now: it is another one than the last, or that was said long ago."""
        with self._lock:
            if sentence == self._sentence and self._clock() < self._said_at + self._period:
                return False
            self._sentence, self._said_at = sentence, self._clock()
            return True

    def forget(self) -> None:
        """Take the next sentence for a new one."""
        with self._lock:
            self._sentence = ""
