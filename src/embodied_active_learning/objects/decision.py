"""The decision whether, and where, the object of a fingerprint was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Sequence

import numpy as np


@dataclass(frozen=True)
class Decision:
    """A place where a fingerprint's object was found; if it was not found, the best candidate.

    Attributes:
        session: Session of the fingerprint.
        fingerprint: Name of the fingerprint.
        kind: OBJECT or BLANK.
        found: Whether the object was found at the pose.
        instance: 1, 2, ... of the places where it was found; 0 if it was not found.
        pose: (3,) x [m], y [m], theta [rad] in the base frame.
        confidence: Share of the compared views that agree, 0 to 1; 0 if there are too few.
        residual: Median over the compared views, in grey levels of [0, 1]; infinite without a comparison.
        views: Number of views of the candidate that can be compared.
        belief_mean: Mean belief at the pose, 0 to 1.
        belief_std: Standard deviation of that belief.
        reason: One sentence for people.
    """

    session: str
    fingerprint: str
    kind: str
    found: bool
    instance: int
    pose: np.ndarray
    confidence: float
    residual: float
    views: int
    belief_mean: float
    belief_std: float
    reason: str


def decisions_about(decisions: Sequence[Decision], session: str, fingerprint: str) -> List[Decision]:
    """Return the decisions about one fingerprint of a session."""
    return [item for item in decisions if (item.session, item.fingerprint) == (session, fingerprint)]
