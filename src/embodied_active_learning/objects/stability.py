"""The stopping criterion: a run may end once its learned objects are stable and complete, and the model is useful."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Deque, Dict, Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from embodied_active_learning.errors import CorruptFileError
from embodied_active_learning.model.verdict import NOTHING_TO_LEARN, OBJECTS_STABLE, USEFUL

STABLE_CHECKS = 3
"""Successive checks that must find the same objects."""
EMPTY_CHECKS = 6
"""Successive checks that must find no object before there is nothing to learn: objects appear late on some tables."""
MAX_DRIFT = 0.01  # m
"""Distance by which the centre of a stable object may differ between these checks."""
MIN_COVERAGE = 0.6
"""Smallest workspace coverage k; the ergodic explorer reaches it after about 200 steps, a random walk after 900."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a check of the stopping criterion is based on.

    Attributes:
        update: Number of model updates.
        observations: Number of observations that the model has learned from.
        centres: (K, 2) clusters of the conditional entropy [m], without the blank region.
        undiscovered: Number of visible things that no cluster explains.
        contrast: Largest over smallest predicted standard deviation.
        latent_contribution: Share of the reconstruction error that the latent removes.
        coverage: Workspace coverage k.
    """

    update: int
    observations: int
    centres: np.ndarray
    undiscovered: int
    contrast: float
    latent_contribution: float
    coverage: float


@dataclass(frozen=True, eq=False)
class StopCheck(Measurement):
    """Result of a check: a measurement, and how far each part of the criterion is.

    Attributes:
        drifts: (K,) distance of each centre from that of the previous check [m]; NaN if their number has changed.
        drift: The largest of them, 0 without objects; NaN at the first check or if their number has changed.
        stable_checks: Number of successive checks, including this one, that found the same objects.
        stopped: Whether the run may end.
    """

    drifts: np.ndarray
    drift: float
    stable_checks: int
    stopped: bool

    @property
    def objects(self) -> int:
        """Number of clusters."""
        return len(self.centres)

    @property
    def row(self) -> Dict[str, Any]:
        """The numbers of the check, as a row of the table `stopping`."""
        numbers = {name: value for name, value in vars(self).items() if name not in ("centres", "drifts")}
        return {**numbers, "objects": self.objects}

    @property
    def reason(self) -> str:
        """Why the run ends: OBJECTS_STABLE or NOTHING_TO_LEARN; empty if it does not."""
        return reason_to_end(self.objects) if self.stopped else ""

    def describe(self) -> str:
        """Return each part with what it needs, for a progress line."""
        needed = STABLE_CHECKS if self.objects else EMPTY_CHECKS
        drift = "" if np.isnan(self.drift) or not self.objects else f", drift {100.0 * self.drift:.1f} cm"
        latent = f"  latent {100.0 * self.latent_contribution:.0f}/{100.0 * USEFUL:.0f} %" if self.objects else ""
        return (
            f"objects {self.objects} for {self.stable_checks}/{needed} checks{drift}  undiscovered {self.undiscovered}"
            f"{latent}  coverage {self.coverage:.2f}/{MIN_COVERAGE:g}"
        )


class StoppingCriterion:
    """Decides from regular measurements whether the objects are learned.

    A run may end if successive checks agree on number and centres of the objects, every visible thing is one of them,
    the latent removes at least half of the reconstruction error, and the workspace is covered. Stable clusters alone
    are not enough: they can be those of the first objects found. Without objects and visible things there is nothing
    to learn, and the latent need not contribute.
    """

    def __init__(self) -> None:
        self._centres: Deque[np.ndarray] = deque(maxlen=max(STABLE_CHECKS, EMPTY_CHECKS))
        self._undiscovered: Deque[int] = deque(maxlen=EMPTY_CHECKS)

    def add(self, measured: Measurement) -> StopCheck:
        """Take in a measurement and return the check."""
        centres, objects = _points(measured.centres), len(measured.centres)
        drifts = matched_distances(centres, self._centres[-1]) if self._centres else np.full(objects, np.nan)
        drift = largest_distance(centres, self._centres[-1]) if self._centres else np.nan
        self._centres.append(centres)
        self._undiscovered.append(measured.undiscovered)
        agreeing = self._agreeing()
        if objects:
            useful = measured.latent_contribution >= USEFUL
            stable = agreeing >= STABLE_CHECKS and useful and not measured.undiscovered
        else:
            stable = agreeing >= EMPTY_CHECKS and not any(self._undiscovered)
        return StopCheck(
            **{**vars(measured), "centres": centres},
            drifts=drifts,
            drift=drift,
            stable_checks=agreeing,
            stopped=bool(stable and measured.coverage >= MIN_COVERAGE),
        )

    def state_dict(self) -> Dict[str, Any]:
        """Return what is known from the last checks as plain data."""
        return {
            "centres": [centres.tolist() for centres in self._centres],
            "undiscovered": list(self._undiscovered),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore state_dict(). Raises CorruptFileError."""
        try:
            restored = [_points(centres) for centres in state["centres"]]
            undiscovered = [int(number) for number in state["undiscovered"]]
        except (KeyError, TypeError, ValueError) as error:
            raise CorruptFileError(f"invalid state of the stopping criterion: {error!r}") from error
        self._centres.clear()
        self._centres.extend(restored)
        self._undiscovered.clear()
        self._undiscovered.extend(undiscovered)

    def _agreeing(self) -> int:
        """Number of last checks, one after the other, whose objects are those of the newest."""
        newest, count = self._centres[-1], 0
        for centres in reversed(self._centres):
            if not largest_distance(centres, newest) <= MAX_DRIFT:
                break
            count += 1
        return count


def _points(values: Any) -> np.ndarray:
    return np.array(values, dtype=np.float64).reshape(-1, 2)


def largest_distance(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest distance between matched points (K, 2), 0 without points; NaN if their numbers differ."""
    return float(matched_distances(one, other).max(initial=0.0)) if len(one) == len(other) else float("nan")


def matched_distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the distance (K,) of each point (K, 2) from the other one (K, 2) matched to it; NaN if numbers differ."""
    if len(points) != len(others):
        return np.full(len(points), np.nan)
    distances = np.linalg.norm(points[:, np.newaxis] - others[np.newaxis], axis=-1)
    return np.asarray(distances[linear_sum_assignment(distances)])


def unexplained(things: np.ndarray, centres: np.ndarray, distance: float) -> np.ndarray:
    """Return the things (N, 2) that lie farther than a distance from all centres (K, 2); all in metres."""
    distances = np.linalg.norm(things[:, np.newaxis] - centres[np.newaxis], axis=-1)
    return things[distances.min(axis=1, initial=np.inf) > distance]


def reason_to_end(objects: int) -> str:
    """Return why a run ends at a check with this number of objects."""
    return OBJECTS_STABLE if objects else NOTHING_TO_LEARN
