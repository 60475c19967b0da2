"""What a node does on request, one call at a time."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import Iterator

from embodied_active_learning.errors import BusyError
from embodied_active_learning.ros.runtime.diagnostics import Health

IDLE = "idle"


class ExclusiveTask:
    """Refuses a second call while one is under way, and knows what is being done for /diagnostics."""

    def __init__(self, name: str) -> None:
        """Name: what is under way during a call, as in "an identification"."""
        self._name = name
        self._busy = threading.Lock()
        self._since = 0.0
        self._finished = 0
        self._failed = 0
        self.doing = IDLE

    @contextmanager
    def call(self) -> Iterator[None]:
        """The time of one call. Raises BusyError while another one is under way."""
        if not self._busy.acquire(blocking=False):
            raise BusyError(f"{self._name} is under way ({self.doing}): wait for its answer")
        self._since = time.monotonic()
        try:
            yield
            self._finished += 1
        except BaseException:
            self._failed += 1
            raise
        finally:
            self.doing = IDLE
            self._busy.release()

    def health(self, **values: object) -> Health:
        """What is being done, and for how long; further figures are put behind."""
        busy = round(time.monotonic() - self._since, 1) if self._busy.locked() else 0.0
        calls = {"busy for [s]": busy, "calls finished": self._finished, "calls failed": self._failed}
        return Health(message=self.doing, values={**calls, **values}, idle=not self._busy.locked())
