"""Decisions compared with the true objects, where they are known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.objects.decision import Decision, decisions_about
from embodied_active_learning.objects.fingerprint import BLANK, FingerprintSet


class TrueObject(NamedTuple):
    """An object of the true scene: its name in the world file, its kind, and its place x, y [m]."""

    name: str
    kind: str
    x: float
    y: float


SAME_PLACE = 0.03
"""Distance [m] within which a decision, or a fingerprint's centre, belongs to an object."""


@dataclass(frozen=True)
class Truth:
    """The true scene, for comparison only; empty where it is not known, as on hardware.

    Attributes:
        objects: The true objects.
        kinds: True kind of each known fingerprint by (session, name): kind of object, BLANK, or "" for no object.
    """

    objects: Sequence[TrueObject] = ()
    kinds: Dict[Tuple[str, str], str] = field(default_factory=dict)

    def is_false_claim(self, decision: Decision) -> bool:
        """Return whether a decision claims an object where none of its kind stands, or a blank where an object stands.

        Claims of a fingerprint whose kind is not known are not judged; those of a fingerprint of no object are false.
        """
        kind = self.kinds.get((decision.session, decision.fingerprint))
        if not decision.found or kind is None:
            return False
        if kind == BLANK:
            return nearest(decision.pose, self.objects)[1] <= SAME_PLACE
        return nearest(decision.pose, [item for item in self.objects if item.kind == kind])[1] > SAME_PLACE


NO_TRUTH = Truth()


class Score(NamedTuple):
    """Comparison of decisions with the true objects.

    An instance is one object of the kind of a fingerprint. It is a hit if a decision of that fingerprint lies within
    SAME_PLACE. A claim is false if it does not lie on an object of its kind; a blank's, if it lies on any object.
    """

    hits: int
    instances: int
    errors: List[float]  # m, location error of each hit
    false_claims: int


def nearest(pose: np.ndarray, objects: Sequence[TrueObject]) -> Tuple[Optional[TrueObject], float]:
    """Return the object nearest to a pose (3,) and its distance [m]; None and infinity without objects."""

    def distance(item: TrueObject) -> float:
        return math.hypot(pose[0] - item.x, pose[1] - item.y)

    found = min(objects, key=distance, default=None)
    return found, math.inf if found is None else distance(found)


def true_kinds(found: FingerprintSet, objects: Sequence[TrueObject]) -> Dict[str, str]:
    """Return the true kind of each fingerprint by name: that of the object at its centre, BLANK, or ""."""
    kinds = {}
    for item in found.fingerprints:
        standing, distance = nearest(item.centre, objects)
        if item.kind == BLANK:
            kinds[item.name] = BLANK if distance > SAME_PLACE else ""
        else:
            kinds[item.name] = standing.kind if standing and distance <= SAME_PLACE else ""
    return kinds


def score(decisions: Sequence[Decision], truth: Truth) -> Score:
    """Compare decisions with the true objects."""
    hits, instances, errors, false_claims = 0, 0, [], 0
    for (session, fingerprint), kind in truth.kinds.items():
        claims = [item for item in decisions_about(decisions, session, fingerprint) if item.found]
        false_claims += sum(map(truth.is_false_claim, claims))
        for instance in [item for item in truth.objects if item.kind == kind]:
            distance = min((nearest(claim.pose, [instance])[1] for claim in claims), default=math.inf)
            instances += 1
            if distance <= SAME_PLACE:
                hits += 1
                errors.append(distance)
    return Score(hits, instances, errors, false_claims)
