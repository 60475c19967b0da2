"""Views of one object selected from a session's stored observations: a fingerprint without an arm."""

from __future__ import annotations

from typing import List

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.objects.collection import is_new_view, log_view_density
from embodied_active_learning.rng import Stream, generator


class ObservedViews:
    """Observations drawn around a centre with the density of collection.ViewCollection."""

    def __init__(
        self, config: Config, centre: np.ndarray, seed: int, all_states: np.ndarray, all_images: np.ndarray
    ) -> None:
        """Draw `fingerprint/views` different views, or as many as there are.

        Args:
            config: The session's configuration.
            centre: (3,) x [m], y [m], theta [rad] of the object.
            seed: One seed gives one selection.
            all_states: (N, 3) states [m, m, rad] of the stored observations.
            all_images: (N, H, W, 3) uint8 images of the stored observations.
        """
        settings, workspace = config.fingerprint, config.workspace.box()
        offset = np.abs(all_states[:, :2] - workspace.clip(centre)[:2]).max(axis=1, initial=0.0)
        near = np.flatnonzero(offset <= settings.view_box)
        # Gumbel-max trick: sorting by log density plus Gumbel noise draws without replacement.
        noise = generator(seed, Stream.STORED_VIEWS).gumbel(size=len(near))
        order = np.argsort(-(log_view_density(all_states[near], centre, workspace, settings) + noise), kind="stable")
        chosen: List[int] = []
        for index in near[order]:
            if len(chosen) == settings.views:
                break
            if is_new_view(all_states[index], all_states[chosen], settings):
                chosen.append(int(index))
        self.complete = len(chosen) == settings.views
        self.states: np.ndarray = np.array(all_states[chosen], dtype=np.float64)
        self.images = np.array(all_images[chosen])
