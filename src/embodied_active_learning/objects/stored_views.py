"""Views of one learned object that were stored while it was learned: a fingerprint without an arm."""

from __future__ import annotations

from typing import List

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.objects.collection import is_new, log_density
from embodied_active_learning.rng import Stream, generator


class StoredViews:
    """Observations around a centre, drawn as an arm would spread new views: see collection.ViewCollection."""

    def __init__(
        self, config: Config, centre: np.ndarray, seed: int, all_states: np.ndarray, all_images: np.ndarray
    ) -> None:
        """centre: (3,) m, m, rad. all_states: (N, 3) and all_images: (N, H, W, 3) uint8 that were stored.

        One seed gives one choice.
        """
        settings, workspace = config.fingerprint, config.workspace.box()
        away = np.abs(all_states[:, :2] - workspace.clip(centre)[:2]).max(axis=1, initial=0.0)
        near = np.flatnonzero(away <= settings.view_box)
        # The largest of logarithms with Gumbel noise, one by one, are a draw by the density without repetition.
        noise = generator(seed, Stream.STORED_VIEWS).gumbel(size=len(near))
        order = np.argsort(-(log_density(all_states[near], centre, workspace, settings) + noise), kind="stable")
        chosen: List[int] = []
        for index in near[order]:
            if len(chosen) == settings.views:
                break
            if is_new(all_states[index], all_states[chosen], settings):
                chosen.append(int(index))
        self.complete = len(chosen) == settings.views
        self.states = np.array(all_states[chosen], dtype=np.float64)
        self.images = np.array(all_images[chosen])
