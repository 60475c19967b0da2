"""Checks of topics: publisher, rate, age of the messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Optional, Sequence

import numpy as np

from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok


@dataclass(frozen=True)
class TopicStatistics:
    """Messages received on a topic during some seconds of wall time."""

    topic: str
    duration: float  # [s]
    arrivals: Sequence[float] = ()  # [s] since the start
    ages: Sequence[float] = ()  # [s] of their stamps on arrival
    published: bool = True

    @property
    def rate(self) -> float:
        """Messages per second; 0 for fewer than two."""
        if len(self.arrivals) < 2:
            return 0.0
        return (len(self.arrivals) - 1) / max(self.arrivals[-1] - self.arrivals[0], 1e-6)

    @property
    def max_gap(self) -> float:
        """Longest time without a message after the first one [s]."""
        return float(np.diff([*self.arrivals, self.duration]).max())

    @property
    def age(self) -> float:
        """Median age on arrival [s]."""
        return float(np.median(self.ages))


class TopicLimits(NamedTuple):
    """Limits of a topic in seconds."""

    max_age: float  # also of the time without a message
    max_future: float  # of a stamp ahead of this computer's clock


def check_topic(
    name: str, statistics: TopicStatistics, reason: str, remedy: str, limits: Optional[TopicLimits]
) -> CheckResult:
    """Check that messages arrive within the limits.

    Args:
        name: name of the check.
        statistics: the messages received.
        reason: what the topic is needed for.
        remedy: command that starts a publisher.
        limits: None with simulated time, which stands still between commands.
    """
    topic = statistics.topic
    if not statistics.published:
        return error(name, f"{topic} has no publisher", reason, remedy)
    if not statistics.arrivals:
        message = f"no message on {topic} in {statistics.duration:.1f} s"
        return error(name, message, reason, f"see the log of its publisher, or {remedy}")
    return ok(name, f"{topic} is published") if limits is None else _check_limits(name, statistics, limits)


def _check_limits(name: str, statistics: TopicStatistics, limits: TopicLimits) -> CheckResult:
    message = f"{statistics.topic} at {statistics.rate:.1f} Hz, {statistics.age:.3f} s old"
    if statistics.age < -limits.max_future:
        return error(
            name,
            f"stamps on {statistics.topic} are {-statistics.age:.2f} s in the future",
            "images and poses are matched by their stamps",
            "synchronise the clocks of the computers with chrony or ntp",
        )
    if statistics.age > limits.max_age:
        return error(
            name,
            f"{message} (limit {limits.max_age:g} s)",
            "older messages are rejected, and the arm does not move",
            "synchronise the clocks of the computers, use a cable instead of WLAN, or reduce the CPU load",
        )
    if statistics.max_gap > limits.max_age:
        return error(
            name,
            f"{message}, longest gap {statistics.max_gap:.2f} s (limit {limits.max_age:g} s)",
            "the arm stops during such a gap",
            "see the log of its publisher, and check the network",
        )
    return ok(name, message)
