"""Active identification: ergodic control of a target that is high where decisions are still open.

The paper names exploration that is guided by the identification as future work; the target is ours.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from embodied_active_learning.config import Config
from embodied_active_learning.exploration.commands import VelocityCommand
from embodied_active_learning.exploration.controller import ErgodicController
from embodied_active_learning.exploration.ergodic_objective import normalise
from embodied_active_learning.exploration.samples import WorkspaceSamples
from embodied_active_learning.geometry import metres_per_pixel

_CELL = 0.01
"""Size of a cell of the table [m]."""


class ActiveExplorer(ErgodicController):
    """Looks at the part of the table that no image shows yet, and at places that need more views.

    The target at a camera state grows with the unseen area that its view would show, and with the number of open places
    near it; without either it is uniform. A view is approximated by the largest disc in an image.
    """

    def __init__(self, config: Config, seed: int) -> None:
        """Start like the ergodic controller, with nothing seen and no open place."""
        super().__init__(config, seed)
        camera, margin = config.camera, config.identification.margin
        self._workspace = config.workspace.box()
        self._radius = 0.5 * metres_per_pixel(camera) * min(camera.width, camera.height)
        self._view_distance = config.identification.view_distance
        lower, upper = np.subtract(self._workspace.lower[:2], margin), np.add(self._workspace.upper[:2], margin)
        axes = [np.linspace(low, high, 1 + math.ceil((high - low) / _CELL)) for low, high in zip(lower, upper)]
        self._cells = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        self._places: np.ndarray = np.empty((0, 2))

    def set_open_places(self, places: np.ndarray) -> None:
        """See Explorer. A place outside the workspace is viewed from the nearest state inside."""
        self._places = np.clip(np.reshape(places, (-1, 2)), self._workspace.lower[:2], self._workspace.upper[:2])

    def next_command(self, target: np.ndarray, samples: WorkspaceSamples) -> VelocityCommand:
        """See Explorer; the target of the model is not used."""
        return super().next_command(self.target(samples), samples)

    def target(self, samples: WorkspaceSamples) -> np.ndarray:
        """Return the target distribution (S,) over the workspace samples."""
        states, visited = (self._workspace.denormalise(part)[:, :2] for part in (samples.states, samples.visited))
        unseen = self._cells
        if len(visited):
            unseen = unseen[cKDTree(visited).query(unseen, distance_upper_bound=self._radius)[0] > self._radius]
        return normalise(
            _share_within(states, unseen, self._radius) + _share_within(states, self._places, self._view_distance)
        )


def _share_within(states: np.ndarray, points: np.ndarray, distance: float) -> np.ndarray:
    """Number of points (P, 2) within a distance of each state (S, 2), divided by the sum; zeros without points."""
    if not len(points):
        return np.zeros(len(states))
    counts = cKDTree(points).query_ball_point(states, distance, return_length=True).astype(np.float64)
    return counts / max(counts.sum(), 1.0)
