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
    """A wait in progress. `what` describes it; empty once it is about to end."""

    def __init__(self, what: Callable[[], str], delay: float) -> None:
        self.what = what
        self.started_at = time.monotonic()
        self._log_at = self.started_at + delay
        self._logged = False

    def log_if_due(self) -> None:
        now = time.monotonic()
        if now >= self._log_at:
            what = self.what()
            if what:
                duration = f" for {now - self.started_at:.0f} s" if self._logged else ""
                rospy.loginfo("waiting for %s%s", what, duration)
            self._log_at, self._logged = now + LOG_PERIOD, True


_entries: List[_Entry] = []  # of all threads, oldest first
_lock = threading.Lock()
_timers: List[WallTimer] = []  # one, started by the first wait


@contextmanager
def log_wait(what: Callable[[], str], delay: float = LOG_PERIOD) -> Iterator[None]:
    """Log what() every few seconds while the block runs, first after `delay` seconds of wall time.

    An empty text is not logged.
    """
    entry = _Entry(what, delay)
    with _lock:
        _entries.append(entry)
        if not _timers:
            _timers.append(WallTimer(_CHECK_PERIOD, _log_all))
    try:
        yield
    finally:
        with _lock:
            _entries.remove(entry)


def longest_wait() -> Optional[Wait]:
    """Return the longest wait in progress, or None."""
    with _lock:
        oldest = _entries[0] if _entries else None
    if oldest is None:
        return None
    what = oldest.what()
    return Wait(what, time.monotonic() - oldest.started_at) if what else None


def _log_all() -> None:
    with _lock:
        entries = list(_entries)
    for entry in entries:
        entry.log_if_due()
