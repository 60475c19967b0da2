"""Decisions as a text table for a terminal."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np

from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import BLANK
from embodied_active_learning.objects.scoring import NO_TRUTH, SAME_PLACE, TrueObject, Truth, nearest
from embodied_active_learning.objects.unknown import UnknownObject

_COLUMNS = ("fingerprint", "kind", "outcome", "x [m]", "y [m]", "yaw [rad]", "confidence", "error [cm]", "reason")


def decision_table(decisions: Sequence[Decision], truth: Truth = NO_TRUTH) -> str:
    """Format decisions as a table with one line each; false claims are marked where the truth is known."""
    rows = [_COLUMNS, *(_row(decision, truth) for decision in decisions)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_COLUMNS))]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths)).rstrip() for row in rows]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def unknown_text(unknown: Sequence[UnknownObject]) -> str:
    """Format unknown objects as one line."""
    places = [f"x {x:.3f}, y {y:.3f} m ({1e4 * area:.0f} cm2)" for (x, y), area, _ in unknown]
    return f"unknown objects: {'; '.join(places) or 'none'}"


def _row(decision: Decision, truth: Truth) -> Tuple[str, ...]:
    """Cells of one decision."""
    x, y, yaw = decision.pose
    yaw_text = "-" if decision.kind == BLANK else f"{yaw:.2f}"
    place = (f"{x:.3f}", f"{y:.3f}", yaw_text) if decision.found else ("-", "-", "-")
    return (
        f"{decision.session}/{decision.fingerprint}",
        truth.kinds.get((decision.session, decision.fingerprint), "") or "?",
        _outcome(decision, truth),
        *place,
        decision.confidence_text,
        _error(decision, truth),
        decision.reason,
    )


def _outcome(decision: Decision, truth: Truth) -> str:
    """Whether the object was found, and what really is at the place of a false claim."""
    if not decision.found:
        return decision.outcome
    if truth.is_false_claim(decision):
        return f"false positive: {_at(decision.pose, truth.objects)}"
    return f"found, place {decision.instance}"


def _at(pose: np.ndarray, objects: Sequence[TrueObject]) -> str:
    """What is at a place of the table."""
    item, distance = nearest(pose, objects)
    if item is None or distance > 2.0 * SAME_PLACE:
        return "bare table"
    return item.name if distance <= SAME_PLACE else f"beside {item.name}"


def _error(decision: Decision, truth: Truth) -> str:
    """Location error [cm] of a claim that is not false."""
    if not decision.found or truth.is_false_claim(decision):
        return "-"
    _, distance = nearest(decision.pose, truth.objects)
    return f"{100.0 * distance:.1f}" if distance <= SAME_PLACE else "-"
