"""Decisions as a text table, compared with the true objects where they are known."""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.geometry import Location
from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.fingerprint import BLANK, FingerprintSet

SAME_PLACE = 0.03
"""Distance [m] within which a decision, or a fingerprint's centre, belongs to an object."""
NOT_AN_OBJECT = "bare table"

Kinds = Dict[Tuple[str, str], str]
"""True kind of each fingerprint: (session, name) -> kind of object, BLANK, or "" if unknown."""

_COLUMNS = ("fingerprint", "kind", "found", "x [m]", "y [m]", "confidence", "truth", "error [cm]", "reason")


class Score(NamedTuple):
    """Comparison of decisions with the true objects.

    An instance is one object of the kind of a fingerprint. It is a hit if a decision of that fingerprint lies within
    SAME_PLACE. A claim is false if it does not lie on an object of its kind; a blank's, if it lies on any object.
    """

    hits: int
    instances: int
    errors: List[float]  # m, location error of each hit
    false_claims: int


def nearest(pose: np.ndarray, objects: Sequence[Location]) -> Tuple[str, float]:
    """Return the kind of the object nearest to a pose (3,) and its distance [m]; "" and infinity without objects."""
    distances = [(math.hypot(pose[0] - x, pose[1] - y), kind) for kind, x, y in objects]
    distance, kind = min(distances, default=(math.inf, ""))
    return kind, distance


def true_kinds(found: FingerprintSet, objects: Sequence[Location]) -> Dict[str, str]:
    """Return the true kind of each fingerprint by name: that of the object at its centre, BLANK, or ""."""
    kinds = {}
    for item in found.fingerprints:
        kind, distance = nearest(item.centre, objects)
        if item.kind == BLANK:
            kinds[item.name] = BLANK if distance > SAME_PLACE else ""
        else:
            kinds[item.name] = kind if distance <= SAME_PLACE else ""
    return kinds


def is_false_claim(decision: Decision, kinds: Kinds, objects: Sequence[Location]) -> bool:
    """Return whether a decision claims an object where none of its kind stands, or a blank where an object stands.

    Decisions about fingerprints that are not in `kinds` are not judged. A fingerprint of no object (kind "") can only
    make false claims.
    """
    kind = kinds.get((decision.session, decision.fingerprint))
    if not decision.found or kind is None:
        return False
    if kind == BLANK:
        return nearest(decision.pose, objects)[1] <= SAME_PLACE
    return nearest(decision.pose, [item for item in objects if item[0] == kind])[1] > SAME_PLACE


def score(decisions: Sequence[Decision], kinds: Kinds, objects: Sequence[Location]) -> Score:
    """Compare decisions with the true objects."""
    hits, instances, errors, false_claims = 0, 0, [], 0
    for (session, fingerprint), kind in kinds.items():
        claims = [item for item in decisions_about(decisions, session, fingerprint) if item.found]
        false_claims += sum(is_false_claim(claim, kinds, objects) for claim in claims)
        for _, x, y in [item for item in objects if item[0] == kind]:
            distance = min((math.hypot(c.pose[0] - x, c.pose[1] - y) for c in claims), default=math.inf)
            instances += 1
            if distance <= SAME_PLACE:
                hits += 1
                errors.append(distance)
    return Score(hits, instances, errors, false_claims)


def decision_table(
    decisions: Sequence[Decision], kinds: Optional[Kinds] = None, objects: Sequence[Location] = ()
) -> str:
    """Format decisions as a table with one line each.

    Args:
        decisions: What to show.
        kinds: True kinds of the fingerprints, where they are known.
        objects: The true objects, where they are known.
    """
    rows = [_COLUMNS, *(_row(decision, kinds or {}, objects) for decision in decisions)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_COLUMNS))]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths)).rstrip() for row in rows]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def _row(decision: Decision, kinds: Kinds, objects: Sequence[Location]) -> Tuple[str, ...]:
    """Cells of one decision."""
    kind = kinds.get((decision.session, decision.fingerprint), "")
    truth, error = _truth(decision, objects)
    place = [f"{value:.3f}" for value in decision.pose[:2]] if decision.found else ["-", "-"]
    return (
        f"{decision.session}/{decision.fingerprint}",
        kind or "?",
        f"yes, no. {decision.instance}" if decision.found else "no",
        *place,
        f"{decision.confidence:.2f}",
        truth,
        error,
        decision.reason,
    )


def _truth(decision: Decision, objects: Sequence[Location]) -> Tuple[str, str]:
    """What is at a claimed place, and the location error [cm]."""
    if not objects or not decision.found:
        return "-", "-"
    kind, distance = nearest(decision.pose, objects)
    if distance > SAME_PLACE:
        return NOT_AN_OBJECT if distance > 2.0 * SAME_PLACE else f"beside {kind}", "-"
    return kind, f"{100.0 * distance:.1f}"
