"""One line that says how far a run is, and an honest guess of how long it will take."""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass
from typing import Callable, Deque, Tuple


@dataclass(frozen=True)
class Progress:
    """How far a run is. Values that are not known yet are NaN."""

    step: int
    steps: int
    updates: int
    updates_planned: int
    loss: float = math.nan
    active_units: float = math.nan
    latent_size: int = 0
    ergodic_measure: float = math.nan

    @property
    def share(self) -> float:
        """Part of the work that is done, 0 to 1: updates, for they take nearly all the time, and steps before them."""
        if self.updates_planned == 0:
            return self.step / self.steps
        return (self.updates + self.step) / (self.updates_planned + self.steps)


class ProgressLine:
    """Words for progress, with the time left as the last minutes suggest it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, window: int = 24) -> None:
        self._clock = clock
        self._recent: Deque[Tuple[float, float]] = deque(maxlen=window)

    def describe(self, progress: Progress) -> str:
        """The line for this moment."""
        self._recent.append((self._clock(), progress.share))
        parts = [
            f"step {progress.step}/{progress.steps}",
            f"updates {progress.updates}/{progress.updates_planned}",
            f"loss {_number(progress.loss, '.3f')}",
            f"active units {_number(progress.active_units, '.0f')}/{progress.latent_size}",
            f"ergodic measure {_number(progress.ergodic_measure, '.3f')}",
            f"left {duration(self._left())}",
        ]
        return "  ".join(parts)

    def _left(self) -> float:
        (start, share_then), (now, share_now) = self._recent[0], self._recent[-1]
        if share_now <= share_then:
            return math.nan
        return (1.0 - share_now) * (now - start) / (share_now - share_then)


def duration(seconds: float) -> str:
    """Seconds as minutes:seconds, or a dash when nobody knows."""
    if not math.isfinite(seconds):
        return "-"
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "-"
