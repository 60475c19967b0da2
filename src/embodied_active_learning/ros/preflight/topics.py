"""Checks of topics: whether somebody publishes, often enough, and with stamps of now."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Optional, Sequence

import numpy as np

from embodied_active_learning.ros.preflight.check_result import CheckResult, fine, missing


@dataclass(frozen=True)
class Stream:
    """What was heard on a topic: when messages arrived (wall time, s), and how old their stamps were then, s."""

    topic: str
    listened: float  # s
    arrivals: Sequence[float] = ()  # s since listening began
    ages: Sequence[float] = ()
    published: bool = True

    @property
    def rate(self) -> float:
        """Messages per second; 0 when there were not two."""
        if len(self.arrivals) < 2:
            return 0.0
        return (len(self.arrivals) - 1) / max(self.arrivals[-1] - self.arrivals[0], 1e-6)

    @property
    def longest_gap(self) -> float:
        """Longest time without a message since the first one, s."""
        return float(np.diff([*self.arrivals, self.listened]).max())

    @property
    def age(self) -> float:
        """Median age of the messages when they arrived, s."""
        return float(np.median(self.ages))


class Limits(NamedTuple):
    """What a stream has to keep, in seconds."""

    longest_gap: float  # without a message, and the highest age of one
    future: float  # that a stamp may be ahead, because two computers' clocks differ


def check_stream(about: str, stream: Stream, why: str, start: str, limits: Optional[Limits]) -> CheckResult:
    """Whether messages come within limits; None where time may stand still, as simulated time does.

    why: what the topic is needed for; start: how to have it published.
    """
    topic = stream.topic
    if not stream.published:
        return missing(about, f"nobody publishes {topic}", why, start)
    if not stream.arrivals:
        return missing(
            about, f"nothing came on {topic} in {stream.listened:.1f} s", why, f"look at its node's log; or {start}"
        )
    return fine(about, f"{topic} is there") if limits is None else _check_times(about, stream, limits)


def _check_times(about: str, stream: Stream, limits: Limits) -> CheckResult:
    found = f"{stream.topic} at {stream.rate:.1f} Hz, {stream.age:.3f} s old"
    if stream.age < -limits.future:
        return missing(
            about,
            f"{stream.topic} is stamped {-stream.age:.2f} s in the future",
            "images and poses are paired by their stamps",
            "synchronise the computers' clocks: chrony or ntp on both",
        )
    if stream.age > limits.longest_gap:
        return missing(
            about,
            f"{found}; {limits.longest_gap:g} s are allowed",
            "what is that old is not used, and the arm is held still",
            "synchronise the computers' clocks, take a cable in place of wireless, or free the computer",
        )
    if stream.longest_gap > limits.longest_gap:
        return missing(
            about,
            f"{found}, with a gap of {stream.longest_gap:.2f} s; {limits.longest_gap:g} s are allowed",
            "without it the arm is held still",
            "look at the publisher's log and at the network between here and there",
        )
    return fine(about, found)
