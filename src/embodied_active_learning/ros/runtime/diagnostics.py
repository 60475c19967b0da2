"""Diagnostic status of a node on /diagnostics at 1 Hz of wall time."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Callable, Deque, Dict, Optional, Tuple

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import Updater

from embodied_active_learning.ros.runtime.log_throttle import LOG_PERIOD
from embodied_active_learning.ros.runtime.timers import WallTimer
from embodied_active_learning.ros.runtime.wait_log import Wait, longest_wait

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

_PERIOD = 1.0  # s


@dataclass
class Health:
    """Content of a DiagnosticStatus. `idle` marks a node that has nothing to do, so that waiting is no warning."""

    level: int = OK
    message: str = ""
    values: Dict[str, object] = field(default_factory=dict)
    idle: bool = False


def report_health(name: str, health: Callable[[], Health]) -> None:
    """Publish health(), and what the node is waiting for, at 1 Hz until the node shuts down."""

    def fill(status: DiagnosticStatus) -> DiagnosticStatus:
        current = add_wait(health(), longest_wait())
        status.summary(current.level, current.message)
        for key, value in current.values.items():
            status.add(key, str(value))
        return status

    updater = Updater()
    updater.setHardwareID("none")
    updater.add(name, fill)
    WallTimer(_PERIOD, updater.force_update)


def add_wait(health: Health, wait: Optional[Wait]) -> Health:
    """Add a wait to the values; it becomes the message of a healthy node, with level WARN after LOG_PERIOD."""
    if wait is None or wait.seconds < _PERIOD:
        return health
    description = f"{wait.what} for {wait.seconds:.0f} s"
    health = replace(health, values={**health.values, "waiting for": description})
    if health.level > OK or health.idle:
        return health
    return replace(health, level=WARN if wait.seconds >= LOG_PERIOD else OK, message=f"waiting for {description}")


class Rate:
    """Counts events and measures their recent rate.

    Uses wall time: diagnostic_updater's FrequencyStatus divides by simulated time, which stands still between commands.
    """

    def __init__(self, window: float = 10.0, clock: Callable[[], float] = time.monotonic) -> None:
        """Average over the last `window` seconds, and at most 1000 ticks."""
        self._window = window
        self._clock = clock
        self._ticks: Deque[Tuple[float, int]] = deque(maxlen=1000)  # time and total count
        self.count = 0

    def tick(self, events: int = 1) -> None:
        """Count events that have just occurred."""
        self.count += events
        self._ticks.append((self._clock(), self.count))

    @property
    def per_second(self) -> float:
        """Events per second since the first tick in the window."""
        now = self._clock()
        recent = [(stamp, count) for stamp, count in list(self._ticks) if stamp >= now - self._window]
        if len(recent) < 2:
            return 0.0
        return (recent[-1][1] - recent[0][1]) / max(now - recent[0][0], 1e-6)

    @property
    def age(self) -> Optional[float]:
        """Seconds since the last event; None before the first."""
        return self._clock() - self._ticks[-1][0] if self._ticks else None


def rounded(seconds: Optional[float]) -> object:
    """Round a duration for /diagnostics; None becomes a dash."""
    return "-" if seconds is None else round(seconds, 1)
