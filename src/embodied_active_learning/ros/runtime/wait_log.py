"""What the node is waiting for: logged periodically and included in its diagnostics."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import Callable, Iterator, List, NamedTuple, Optional

import rospy

from embodied_active_learning.ros.runtime.log_throttle import LOG_PERIOD
from embodied_active_learning.ros.runtime.timers import WallTimer

_CHECK_PERIOD = 0.2  # s of wall time


class Wait(NamedTuple):
    """Description of a wait and its duration so far [s of wall time]."""

    what: str
    seconds: float


class _Entry:
    """A wait in progress."""

    def __init__(self, describe: Callable[[], str], delay: float) -> None:
        self._describe = describe
        self._started = time.monotonic()
        self._log_at = self._started + delay
        self._logged = False

    @property
    def wait(self) -> Wait:
        return Wait(self._describe(), time.monotonic() - self._started)

    def log_if_due(self) -> None:
        if time.monotonic() < self._log_at:
            return
        self._log_at = time.monotonic() + LOG_PERIOD
        what, seconds = self.wait
        rospy.loginfo("waiting for %s%s", what, f" (since {seconds:.0f} s)" if self._logged else "")
        self._logged = True


class _WaitLog:
    """The waits of all threads of this process, oldest first."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entries: List[_Entry] = []
        self._timer: Optional[WallTimer] = None

    def add(self, entry: _Entry) -> None:
        with self._lock:
            self._entries.append(entry)
            if self._timer is None:
                self._timer = WallTimer(_CHECK_PERIOD, self._log)

    def remove(self, entry: _Entry) -> None:
        with self._lock:
            self._entries.remove(entry)

    def oldest(self) -> Optional[_Entry]:
        with self._lock:
            return self._entries[0] if self._entries else None

    def _log(self) -> None:
        with self._lock:
            entries = list(self._entries)
        for entry in entries:
            entry.log_if_due()


_WAIT_LOG = _WaitLog()


@contextmanager
def log_wait(what: Callable[[], str], delay: float = LOG_PERIOD) -> Iterator[None]:
    """Log what() every few seconds while the block runs, first after `delay` seconds of wall time."""
    entry = _Entry(what, delay)
    _WAIT_LOG.add(entry)
    try:
        yield
    finally:
        _WAIT_LOG.remove(entry)


def longest_wait() -> Optional[Wait]:
    """Return the longest wait in progress, or None."""
    entry = _WAIT_LOG.oldest()
    return None if entry is None else entry.wait
