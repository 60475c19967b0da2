"""Limits of the similarity that a fingerprint sets from its own views.

The similarity is computed for views held out from the comparison and simulated in other places (true), and for
simulated look-alikes (false). The user states one number, `identification/error_rate`:

* miss limit: the quantile of the true similarities at that rate. Split conformal prediction: a new view from the same
  distribution falls below it with at most that probability.
* look-alike limit: the quantile of the false similarities at 1 minus that rate.

An object is found above both limits and not here below the miss limit. In between it is undecided, because a look-alike
would be as similar. Not guaranteed: that real changes of table and light are within the simulated ones, and that
real objects are at least as different as the look-alikes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from embodied_active_learning.config import IdentificationConfig
from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.pose_search import best_pose, climb
from embodied_active_learning.objects.similarity import similarity, stored_views
from embodied_active_learning.objects.simulated_views import LOOK_ALIKES, SimulatedViews, draw_views

_TRUE_VIEWS = 3
"""Views of a simulated place; in a scene there are up to identification/views."""
_SHIFT = (0.004, 0.004, 0.1)
"""Standard deviation of the pose from which the search of a true view starts [m, m, rad]."""
_LOOK_ALIKE_YAWS = 12


@dataclass(frozen=True, eq=False)
class Calibration:
    """Similarities that a fingerprint's object, and look-alikes of it, reach.

    Attributes:
        true: (T,) of the object in simulated places, ascending.
        false: (F,) of look-alikes, ascending.
        error_rate: The accepted rate of errors.
    """

    true: np.ndarray
    false: np.ndarray
    error_rate: float

    @property
    def miss_limit(self) -> float:
        """Similarity below which the object is not here."""
        rank = math.floor(self.error_rate * (len(self.true) + 1))
        return float(self.true[rank - 1]) if rank else -1.0

    @property
    def look_alike_limit(self) -> float:
        """Similarity above which it is no look-alike."""
        rank = math.ceil((1.0 - self.error_rate) * (len(self.false) + 1))
        return float(self.false[rank - 1]) if rank <= len(self.false) else 1.0

    @property
    def found_limit(self) -> float:
        """Similarity from which the object is found."""
        return max(self.miss_limit, self.look_alike_limit)

    def confidence(self, value: float) -> float:
        """Share of the look-alikes that are less similar than a value; conformal, so below 1."""
        return float(np.searchsorted(self.false, value, side="left")) / (len(self.false) + 1)


def calibrate(appearance: Appearance, settings: IdentificationConfig) -> Calibration:
    """Simulate places and look-alikes of a fingerprint's object. The same views give the same limits."""
    random = np.random.default_rng(0)
    true = [_true_similarity(appearance, random) for _ in range(settings.trials)]
    names = [LOOK_ALIKES[index % len(LOOK_ALIKES)] for index in range(settings.trials)]
    false = [_look_alike_similarity(appearance, random, name) for name in names]
    return Calibration(np.sort(true), np.sort(false), settings.error_rate)


def _true_similarity(appearance: Appearance, random: np.random.Generator) -> float:
    """Similarity of held-out views in a simulated place, compared with the other views."""
    chosen = draw_views(appearance, random, _TRUE_VIEWS)
    start = appearance.fingerprint.centre + random.normal(0.0, _SHIFT)
    return _searched(appearance, SimulatedViews(appearance, random), chosen, start[None])


def _look_alike_similarity(appearance: Appearance, random: np.random.Generator, name: str) -> float:
    """Similarity of a look-alike at its best yaw."""
    chosen = draw_views(appearance, random, 1)
    turns = np.arange(_LOOK_ALIKE_YAWS) * (2.0 * np.pi / _LOOK_ALIKE_YAWS)
    starts = appearance.fingerprint.centre + np.stack([0.0 * turns, 0.0 * turns, turns], axis=-1)
    return _searched(appearance, SimulatedViews(appearance, random, name), chosen, starts)


def _searched(appearance: Appearance, views: SimulatedViews, chosen: list, starts: np.ndarray) -> float:
    """Largest similarity near the starts (Y, 3)."""
    pose = best_pose(appearance, views, chosen[:1], starts, stride=8, excluded=chosen)
    pose = climb(appearance, views, chosen[:1], pose, excluded=chosen)
    stored = stored_views(appearance, views, chosen, pose, chosen)
    return float(similarity(appearance, views, chosen, stored, pose[None])[0])
