"""Calibration of a fingerprint: the similarity is computed where the truth is known.

Views held out from the comparison are simulated in other places (true), and look-alikes of the object (false); see
limits for what follows from them.
"""

from __future__ import annotations

import numpy as np

from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.limits import Calibration
from embodied_active_learning.objects.pose_search import best_pose, climb
from embodied_active_learning.objects.similarity import similarity, stored_views
from embodied_active_learning.objects.simulated_views import LOOK_ALIKES, SimulatedViews, draw_views

_TRUE_VIEWS = 3
"""Views of a simulated place; in a scene there are up to identification/views."""
_SHIFT = (0.004, 0.004, 0.1)
"""Standard deviation of the pose from which the search of a true view starts [m, m, rad]."""
_LOOK_ALIKE_YAWS = 12


def calibrate(appearance: Appearance, trials: int) -> Calibration:
    """Simulate a number of places and of look-alikes of a fingerprint's object. The same views give the same result."""
    random = np.random.default_rng(0)
    true = [_true_similarity(appearance, random) for _ in range(trials)]
    names = [LOOK_ALIKES[index % len(LOOK_ALIKES)] for index in range(trials)]
    false = [_look_alike_similarity(appearance, random, name) for name in names]
    return Calibration(np.sort(np.float64(true)), np.sort(np.float64(false)))


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
