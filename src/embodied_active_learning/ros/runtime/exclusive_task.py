"""A long service call of which only one runs at a time."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import Iterator

from embodied_active_learning.errors import BusyError
from embodied_active_learning.ros.runtime.diagnostics import Health

IDLE = "idle"


class ExclusiveTask:
    """Rejects a second call while one is running, and reports the progress of the running one.

    Attributes:
        status: what the running call is doing; set by the caller.
    """

    def __init__(self, name: str) -> None:
        """Name the task in error messages, for example "an identification"."""
        self._name = name
        self._lock = threading.Lock()
        self._started_at = 0.0
        self._finished = 0
        self._failed = 0
        self.status = IDLE

    @contextmanager
    def call(self) -> Iterator[None]:
        """Run one call as the block. Raises BusyError if another one is running."""
        if not self._lock.acquire(blocking=False):
            raise BusyError(f"{self._name} is already running ({self.status}): wait until it has finished")
        self._started_at = time.monotonic()
        try:
            yield
            self._finished += 1
        except BaseException:
            self._failed += 1
            raise
        finally:
            self.status = IDLE
            self._lock.release()

    def health(self, **values: object) -> Health:
        """Return status, duration and counts of calls, followed by further values."""
        running = round(time.monotonic() - self._started_at, 1) if self._lock.locked() else 0.0
        calls = {"running for [s]": running, "calls finished": self._finished, "calls failed": self._failed}
        return Health(message=self.status, values={**calls, **values}, idle=not self._lock.locked())
