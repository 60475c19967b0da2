"""Log throttling: on change, then periodically."""

from __future__ import annotations

import math
import re
import threading
import time
from typing import Callable

LOG_PERIOD = 5.0
"""Wall seconds after which an unchanged message is logged again."""
_NUMBER = re.compile(r"(?<![\w/])\d+(\.\d+)?")
"""A measured number, not the digit of a name such as panda_joint4."""


class LogThrottle:
    """Decides whether a message is logged: if it differs from the last one, or once a period has passed.

    Messages that differ in numbers only, such as the age of an image, count as the same one. Wall time is used,
    because simulated time stands still between two commands of the arm.
    """

    def __init__(self, period: float = LOG_PERIOD, clock: Callable[[], float] = time.monotonic) -> None:
        """Log the same message again after `period` seconds."""
        self._period = period
        self._clock = clock
        self._lock = threading.Lock()
        self._message = ""
        self._logged_at = -math.inf

    def should_log(self, message: str) -> bool:
        """Return whether to log the message now, and count it as logged if so."""
        kind = _NUMBER.sub("#", message)
        with self._lock:
            if kind == self._message and self._clock() < self._logged_at + self._period:
                return False
            self._message, self._logged_at = kind, self._clock()
            return True

    def reset(self) -> None:
        """Treat the next message as new."""
        with self._lock:
            self._message = ""
