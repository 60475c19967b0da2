"""Calibration of a fingerprint: similarities in simulated places, where the truth is known.

Held-out views are compared with the other views after a change of table and light: with the object itself (true) and
with look-alikes of it (false). limits.py derives the limits from both.

In a run a place is evaluated several times while views are added, and each evaluation may decide. A simulated place is
therefore evaluated several times too, with MIN_VIEWS views of which one is replaced each time, and the worst result
counts: the smallest similarity of a true place, the largest of a look-alike. The limits then hold whichever evaluation
decides.
"""

from __future__ import annotations

import zlib
from typing import List

import numpy as np

from embodied_active_learning.objects.appearance import Appearance
from embodied_active_learning.objects.limits import Calibration
from embodied_active_learning.objects.pose_search import MIN_VIEWS, best_pose
from embodied_active_learning.objects.similarity import nearest_stored_views, similarity
from embodied_active_learning.objects.simulated_views import LOOK_ALIKES, SimulatedViews, draw_views

_EVALUATIONS = 3
"""Evaluations of a simulated place."""
_VIEWS = MIN_VIEWS + _EVALUATIONS - 1
"""Views of a simulated place."""
_SHIFT = (0.004, 0.004, 0.1)
"""Standard deviation of the pose from which the search of a true view starts [m, m, rad]."""
_LOOK_ALIKE_YAWS = 12


def calibrate(appearance: Appearance, trials: int) -> Calibration:
    """Simulate a number of places and of look-alikes of a fingerprint's object.

    The same views give the same result. Fingerprints have different draws, so that their errors are independent.
    """
    random = np.random.default_rng(zlib.crc32(appearance.fingerprint.states.tobytes()))
    true = [_true_similarity(appearance, random) for _ in range(trials)]
    names = [LOOK_ALIKES[index % len(LOOK_ALIKES)] for index in range(trials)]
    false = [_look_alike_similarity(appearance, random, name) for name in names]
    return Calibration(np.sort(true), np.sort(false))


def _true_similarity(appearance: Appearance, random: np.random.Generator) -> float:
    """Smallest similarity of held-out views, with another table and light, to the other views."""
    chosen = draw_views(appearance, random, _VIEWS)
    start = appearance.fingerprint.centre + random.normal(0.0, _SHIFT)
    return min(_evaluated(appearance, SimulatedViews(appearance, random), chosen, start[None]))


def _look_alike_similarity(appearance: Appearance, random: np.random.Generator, name: str) -> float:
    """Largest similarity of a look-alike at its best yaw."""
    chosen = draw_views(appearance, random, _VIEWS)
    turns = np.arange(_LOOK_ALIKE_YAWS) * (2.0 * np.pi / _LOOK_ALIKE_YAWS)
    starts = appearance.fingerprint.centre + np.stack([0.0 * turns, 0.0 * turns, turns], axis=-1)
    return max(_evaluated(appearance, SimulatedViews(appearance, random, name), chosen, starts))


def _evaluated(appearance: Appearance, views: SimulatedViews, chosen: List[int], starts: np.ndarray) -> List[float]:
    """Similarity in each evaluation, at the best pose near the starts (Y, 3)."""
    pose = best_pose(appearance, views, chosen[:1], starts, excluded=chosen, stride=8)
    stored = nearest_stored_views(appearance, views, chosen, pose, chosen)
    parts = [slice(begin, begin + MIN_VIEWS) for begin in range(max(len(chosen) - MIN_VIEWS + 1, 1))]
    return [float(similarity(appearance, views, chosen[part], stored[part], pose[None])[0]) for part in parts]
