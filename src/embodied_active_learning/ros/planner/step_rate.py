"""Rate and overruns of the exploration steps."""

from __future__ import annotations

import time
from typing import Callable, Dict, Optional

from embodied_active_learning.ros.runtime.diagnostics import Rate, rounded


class StepRate:
    """Measures the rate of the exploration steps and counts overruns."""

    def __init__(self, max_duration: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Count a step that takes longer than `max_duration` seconds of wall time as an overrun."""
        self._max_duration = max_duration
        self._clock = clock
        self._rate = Rate(clock=clock)
        self._step_began: Optional[float] = None
        self._overruns = 0
        self._last_overrun = 0.0

    def step(self) -> None:
        """Count the end of a step, which is the start of the next."""
        now = self._clock()
        if self._step_began is not None and now - self._step_began > self._max_duration:
            self._overruns += 1
            self._last_overrun = now - self._step_began
        self._step_began = now
        self._rate.tick()

    def interrupt(self) -> None:
        """Exclude the current step from the overruns, for example because of a pause."""
        self._step_began = None

    def values(self) -> Dict[str, object]:
        """Return the values for /diagnostics."""
        return {
            "steps per second": round(self._rate.per_second, 2),
            "age of the last observation [s]": rounded(self._rate.age),
            "overruns": self._overruns,
            "last overrun [s]": round(self._last_overrun, 2),
        }
