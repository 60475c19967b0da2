"""A progress line with an estimate of the remaining time, and the summary at the end."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Callable, Deque, Optional, Tuple

from embodied_active_learning.session.summary import Summary

_STANDSTILL = 15.0
"""Seconds without progress after which a run counts as paused or held."""
_PRINT_PERIOD = 30.0
"""Seconds between printed progress lines."""


@dataclass(frozen=True)
class Progress:
    """Progress of a run. Unknown values are NaN."""

    step: int
    steps: int
    updates: int
    updates_planned: int
    loss: float = math.nan
    active_units: float = math.nan
    latent_size: int = 0
    ergodic_measure: float = math.nan
    latent_contribution: float = math.nan
    """Share of the reconstruction error that the latent removes, at the newest evaluation."""
    stopping: str = ""
    """How far the stopping criterion is; empty if the number of steps is fixed."""
    paused_by: str = ""
    """Names of the nodes that have paused the planner; empty if it is not paused."""

    @property
    def share(self) -> float:
        """Completed share of the work, 0 to 1, in updates and steps; updates take most of the time."""
        if self.updates_planned == 0:
            return self.step / self.steps
        return (self.updates + self.step) / (self.updates_planned + self.steps)


class TimeLeft:
    """Estimates the remaining time from the last reports of the completed share, without standstills."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, window: int = 24) -> None:
        self._clock = clock
        self._recent: Deque[Tuple[float, float]] = deque(maxlen=window)  # seconds of work, completed share
        self._reported_at = self._advanced_at = clock()

    def estimate(self, share: float) -> float:
        """Return the seconds left at a completed share (0 to 1); NaN while there was no progress."""
        now = self._clock()
        work, reached = self._recent[-1] if self._recent else (0.0, -math.inf)
        if share > reached:
            stood_still = self._reported_at - self._advanced_at > _STANDSTILL
            self._recent.append((work + now - (self._reported_at if stood_still else self._advanced_at), share))
            self._advanced_at = now
        self._reported_at = now
        (start, share_then), (end, share_now) = self._recent[0], self._recent[-1]
        if share_now <= share_then:
            return math.nan
        return (1.0 - share_now) * (end - start) / (share_now - share_then)


class ProgressLine:
    """Formats progress, with the remaining time estimated from the last minutes."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._left = TimeLeft(clock)

    def describe(self, progress: Progress) -> str:
        """Return the line for the current progress."""
        # The stopping criterion may end the run earlier.
        left = f"left {'at most ' if progress.stopping else ''}{duration(self._left.estimate(progress.share))}"
        known = math.isfinite(progress.latent_contribution) and not progress.stopping  # which contains it
        latent = f"latent {100.0 * progress.latent_contribution:.0f} %" if known else ""
        parts = [
            f"step {progress.step}/{progress.steps}",
            f"updates {progress.updates}/{progress.updates_planned}",
            f"loss {_number(progress.loss, '.3f')}",
            f"active units {_number(progress.active_units, '.0f')}/{progress.latent_size}",
            f"ergodic measure {_number(progress.ergodic_measure, '.3f')}",
            latent,
            f"paused by {progress.paused_by}" if progress.paused_by else left,
            progress.stopping,
        ]
        return "  ".join(part for part in parts if part)


class ProgressPrinter:
    """Prints the progress line to stderr, at once and then every 30 s."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._due, self._line = clock, -math.inf, ProgressLine(clock)

    def __call__(self, progress: Progress) -> None:
        """Print the line if it is due."""
        if self._clock() >= self._due:
            self._due = self._clock() + _PRINT_PERIOD
            print(self._line.describe(progress), file=sys.stderr, flush=True)  # noqa: T201 - default of learn


def duration(seconds: float) -> str:
    """Format seconds as minutes:seconds, or a dash if they are unknown."""
    if not math.isfinite(seconds):
        return "-"
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def describe_summary(summary: Summary) -> str:
    """Return the summary of a run as text."""

    def number(value: Optional[float]) -> str:
        return "-" if value is None else f"{value:.3g}"

    reason = f", {summary.ended}" if summary.ended else ""
    return (
        f"finished: {summary.steps} steps and {summary.updates} updates in {duration(summary.wall_time)} min{reason}\n"
        f"  active units {number(summary.active_units)}, ergodic measure {number(summary.ergodic_measure)}, "
        f"coverage {number(summary.coverage)}, distance {number(summary.distance)} m\n"
        f"  mean squared error with own / shuffled / no latent: "
        f"{number(summary.mse_own)} / {number(summary.mse_shuffled)} / {number(summary.mse_none)}\n"
        f"  verdict  {summary.verdict}"
    )


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "-"
