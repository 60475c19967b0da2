"""The decision whether, and where, the object of a fingerprint was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence

import numpy as np

FOUND, NOT_HERE, UNDECIDED = "found", "not here", "undecided"
OUTCOMES = (FOUND, NOT_HERE, UNDECIDED)


@dataclass(frozen=True)
class Decision:
    """A place where a fingerprint's object was found; if it was not found, the best candidate.

    Attributes:
        session: Session of the fingerprint.
        fingerprint: Name of the fingerprint.
        kind: OBJECT or BLANK.
        outcome: FOUND; NOT_HERE: it is nowhere in the workspace; or UNDECIDED, for the reason given.
        instance: 1, 2, ... of the places where it was found; 0 if it was not found.
        pose: (3,) x [m], y [m], theta [rad] in the base frame.
        confidence: Share of simulated look-alikes that are less similar, 0 to 1. Of a blank: share of its own views
            that show the table less clearly.
        error_rate: The rate of missed objects and of accepted look-alikes that the limits were set for.
        residual: Share of the object that the views at the pose do not show, 1 minus the similarity; infinite without
            a comparison of at least three views from near the pose.
        views: Number of views from near the pose that were compared. With fewer than three, more distant ones were
            compared too, which are not counted.
        belief_mean: Mean belief at the pose, 0 to 1.
        belief_std: Standard deviation of that belief.
        reason: One sentence for people.
    """

    session: str
    fingerprint: str
    kind: str
    outcome: str
    instance: int
    pose: np.ndarray
    confidence: float
    error_rate: float
    residual: float
    views: int
    belief_mean: float
    belief_std: float
    reason: str

    @property
    def found(self) -> bool:
        """Whether the object was found at the pose."""
        return self.outcome == FOUND

    @property
    def confidence_text(self) -> str:
        """The confidence with two digits; a dash for NOT_HERE, as it rates the candidate and not the absence."""
        return "-" if self.outcome == NOT_HERE else f"{self.confidence:.2f}"


def decisions_about(decisions: Sequence[Decision], session: str, fingerprint: str) -> List[Decision]:
    """Return the decisions about one fingerprint of a session."""
    return [item for item in decisions if (item.session, item.fingerprint) == (session, fingerprint)]
