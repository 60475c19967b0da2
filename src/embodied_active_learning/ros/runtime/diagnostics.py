"""A node's own account of itself on /diagnostics, once a second of wall time."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Callable, Deque, Dict, Optional, Tuple

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import Updater

from embodied_active_learning.ros.runtime.timers import REPEAT_AFTER, WallTimer
from embodied_active_learning.ros.runtime.wait_log import Wait, longest_wait

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

PERIOD = 1.0


@dataclass
class Health:
    """One diagnosis: a level, a sentence and its figures."""

    level: int = OK
    message: str = ""
    values: Dict[str, object] = field(default_factory=dict)
    idle: bool = False  # whether standing idle is what the node is meant to do: then no wait is worth the sentence


def report_health(name: str, health: Callable[[], Health]) -> None:
    """Publish what health() answers as the diagnosis called name, every second until the node ends.

    What the node is waiting for, if anything, is put in.
    """

    def fill(status):
        diagnosis = with_wait(health(), longest_wait())
        status.summary(diagnosis.level, diagnosis.message)
        for key, value in diagnosis.values.items():
            status.add(key, str(value))
        return status

    updater = Updater()
    updater.setHardwareID("none")
    updater.add(name, fill)
    WallTimer(PERIOD, updater.force_update)


def with_wait(health: Health, wait: Optional[Wait]) -> Health:
    """The health of a node that waits: a long wait is its sentence unless there is worse, and soon a warning."""
    if wait is None or wait.seconds < PERIOD:
        return health
    waiting = f"{wait.what}, for {wait.seconds:.0f} s now"
    health = replace(health, values={**health.values, "waiting for": waiting})
    if health.level > OK or health.idle:
        return health
    return replace(health, level=WARN if wait.seconds >= REPEAT_AFTER else OK, message=f"waiting for {waiting}")


class Rate:
    """Counts events, and tells how many there were lately in a second of wall time.

    diagnostic_updater's FrequencyStatus divides by simulated time, which stands still between two motions.
    """

    def __init__(self, window: float = 10.0, clock: Callable[[], float] = time.monotonic) -> None:
        """Window [s]: how far back is looked, over the last 1000 ticks at most."""
        self._window = window
        self._clock = clock
        self._ticks: Deque[Tuple[float, int]] = deque(maxlen=1000)  # when, and how many there were by then
        self.count = 0

    def tick(self, events: int = 1) -> None:
        """Count events that have just happened."""
        self.count += events
        self._ticks.append((self._clock(), self.count))

    @property
    def per_second(self) -> float:
        """Events per second from the first tick in the window until now."""
        now = self._clock()
        recent = [(when, count) for when, count in list(self._ticks) if when >= now - self._window]
        if len(recent) < 2:
            return 0.0
        return (recent[-1][1] - recent[0][1]) / max(now - recent[0][0], 1e-6)

    @property
    def age(self) -> Optional[float]:
        """Seconds since the last event [s]; None before the first."""
        return self._clock() - self._ticks[-1][0] if self._ticks else None


class Pace:
    """How fast steps follow each other, and how many took longer than they should."""

    def __init__(self, longest: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Longest [s of wall time] that a step should take."""
        self._longest = longest
        self._clock = clock
        self._rate = Rate(clock=clock)
        self._began: Optional[float] = None
        self._overruns = 0
        self._last_overrun = 0.0

    def step(self) -> None:
        """Count the end of a step, and with it the beginning of the next."""
        now = self._clock()
        if self._began is not None and now - self._began > self._longest:
            self._overruns += 1
            self._last_overrun = now - self._began
        self._began = now
        self._rate.tick()

    def interrupt(self) -> None:
        """The time until the next step does not count: something else was meant to be done in it."""
        self._began = None

    def values(self) -> Dict[str, object]:
        """Figures for /diagnostics."""
        return {
            "steps per second": round(self._rate.per_second, 2),
            "age of the last observation [s]": rounded(self._rate.age),
            "overruns": self._overruns,
            "last overrun [s]": round(self._last_overrun, 2),
        }


def rounded(seconds: Optional[float]) -> object:
    """Seconds as a figure for /diagnostics; a dash for what has not happened yet."""
    return "-" if seconds is None else round(seconds, 1)
