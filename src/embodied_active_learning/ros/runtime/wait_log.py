"""What a node is waiting for: said on its log, and told to /diagnostics, from this one place."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import Callable, Iterator, List, NamedTuple, Optional

import rospy

from embodied_active_learning.ros.runtime.timers import REPEAT_AFTER

_LOOK_PERIOD = 0.2  # s of wall time between two looks at whether something has to be said


class Wait(NamedTuple):
    """One thing that is awaited: in words, and for how many seconds of wall time by now."""

    what: str
    seconds: float


class _Entry:
    def __init__(self, what: Callable[[], str], first_after: float) -> None:
        self.what = what
        self.since = time.monotonic()
        self.say_at = self.since + first_after
        self.said = False

    def say(self) -> None:
        now = time.monotonic()
        if now < self.say_at:
            return
        self.say_at = now + REPEAT_AFTER
        rospy.loginfo("waiting for %s%s", self.what(), f", for {now - self.since:.0f} s now" if self.said else "")
        self.said = True


class _Waits:
    """All that the threads of this process are waiting for, and a thread that says it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entries: List[_Entry] = []
        self._thread: Optional[threading.Thread] = None

    def add(self, entry: _Entry) -> None:
        with self._lock:
            self._entries.append(entry)
            if self._thread is None:
                self._thread = threading.Thread(target=self._say, daemon=True)
                self._thread.start()

    def remove(self, entry: _Entry) -> None:
        with self._lock:
            self._entries.remove(entry)

    def longest(self) -> Optional[_Entry]:
        with self._lock:
            return self._entries[0] if self._entries else None

    def _say(self) -> None:
        while not rospy.is_shutdown():
            time.sleep(_LOOK_PERIOD)
            with self._lock:
                entries = list(self._entries)
            for entry in entries:
                entry.say()


_WAITS = _Waits()


@contextmanager
def awaiting(what: Callable[[], str], first_after: float = REPEAT_AFTER) -> Iterator[None]:
    """The time of a wait: what() is said after first_after seconds of wall time, and again every few seconds."""
    entry = _Entry(what, first_after)
    _WAITS.add(entry)
    try:
        yield
    finally:
        _WAITS.remove(entry)


def longest_wait() -> Optional[Wait]:
    """What this node has been waiting for longest; None when it waits for nothing."""
    entry = _WAITS.longest()
    return None if entry is None else Wait(entry.what(), time.monotonic() - entry.since)
