"""Decisions as a table for a person, beside the truth where it is known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Dict, List, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.geometry import Location
from embodied_active_learning.objects.fingerprint import BLANK, FingerprintSet

if TYPE_CHECKING:
    from embodied_active_learning.objects.identification import Decision

SAME_PLACE = 0.03
"""Distance [m] within which a decision or a fingerprint's centre is on an object."""


def nearest(pose: np.ndarray, objects: Sequence[Location]) -> Tuple[str, float]:
    """The kind of the object next to a pose (3,), and how far it is [m]; ("", infinity) where there is none."""
    distances = [(math.hypot(pose[0] - x, pose[1] - y), kind) for kind, x, y in objects]
    distance, kind = min(distances, default=(math.inf, ""))
    return kind, distance


def true_kinds(found: FingerprintSet, objects: Sequence[Location]) -> Dict[str, str]:
    """What each fingerprint of a session is really of: the kind of the object at its centre, "blank", or ""."""
    kinds = {}
    for item in found.fingerprints:
        kind, distance = nearest(item.centre, objects)
        if item.kind == BLANK:
            kinds[item.name] = BLANK if distance > SAME_PLACE else ""
        else:
            kinds[item.name] = kind if distance <= SAME_PLACE else ""
    return kinds


def decision_table(
    decisions: Sequence[Decision],
    kinds: Optional[Dict[Tuple[str, str], str]] = None,
    objects: Sequence[Location] = (),
) -> str:
    """One line for each decision.

    kinds: what each (session, fingerprint) is really of; objects: what is really there. Both only for the reader, and
    left out where they are not known.
    """
    rows = [("fingerprint", "of", "found", "x [m]", "y [m]", "confidence", "really there", "error [cm]", "why")]
    for decision in decisions:
        of = (kinds or {}).get((decision.session, decision.fingerprint), "") or "?"
        there, error = _truth(decision, objects)
        place = [f"{value:.3f}" for value in decision.pose[:2]] if decision.found else ["-", "-"]
        rows.append(
            (
                f"{decision.session}/{decision.fingerprint}",
                of,
                f"yes, no. {decision.instance}" if decision.found else "no",
                *place,
                f"{decision.confidence:.2f}",
                there,
                error,
                decision.reason,
            )
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths)).rstrip() for row in rows]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def _truth(decision: Decision, objects: Sequence[Location]) -> Tuple[str, str]:
    if not objects or not decision.found:
        return "-", "-"
    kind, distance = nearest(decision.pose, objects)
    if distance > SAME_PLACE:
        return "bare table" if distance > 2.0 * SAME_PLACE else f"beside {kind}", "-"
    return kind, f"{100.0 * distance:.1f}"


def score(
    decisions: Sequence[Decision], kinds: Dict[Tuple[str, str], str], objects: Sequence[Location]
) -> Tuple[int, int, List[float], int]:
    """How well the decisions fit the truth -> instances found, instances there, their errors [m], false claims.

    An instance is one object of a fingerprint's kind; it is found when a decision of that fingerprint lies within
    SAME_PLACE. A claim is false when it does not lie on an object of the kind; a blank's when it lies on any.
    """
    hits, there, errors, false = 0, 0, [], 0
    for key, of in kinds.items():
        claims = [item for item in decisions if (item.session, item.fingerprint) == key and item.found]
        if of == BLANK:
            false += sum(nearest(claim.pose, objects)[1] <= SAME_PLACE for claim in claims)
            continue
        instances = [item for item in objects if item[0] == of]
        for _, x, y in instances:
            distance = min((math.hypot(c.pose[0] - x, c.pose[1] - y) for c in claims), default=math.inf)
            there += 1
            if distance <= SAME_PLACE:
                hits += 1
                errors.append(distance)
        false += sum(nearest(claim.pose, instances)[1] > SAME_PLACE for claim in claims)
    return hits, there, errors, false
