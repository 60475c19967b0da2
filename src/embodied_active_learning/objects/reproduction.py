"""How well a model reproduces a visible thing: what its latent adds to the colour of the table."""

from __future__ import annotations

import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import table_points
from embodied_active_learning.model.trained_model import TrainedModel
from embodied_active_learning.objects.salience import Background

_VIEWS = 4
"""Observations, those from nearest above the thing, that are reproduced."""
_RADIUS = 0.04  # m
_STRIDE = 4
"""Every how many rows and columns are compared."""
_FOREGROUND = 0.5


def reproduced_share(
    model: TrainedModel,
    states: np.ndarray,
    images: np.ndarray,
    thing: np.ndarray,
    background: Background,
    camera: CameraConfig,
) -> float:
    """Return the share of a thing's squared difference from the table's colour that the model reproduces, at most 1.

    Each view is decoded from its own latent. A model that paints the table alone has about 0, and one that
    cannot be compared, because no view shows the thing, has 0.

    Args:
        model: The model.
        states: (N, 3) x [m], y [m], theta [rad] of the observations.
        images: (N, H, W, 3) uint8 of the observations.
        thing: (2,) x [m], y [m] of its centre.
        background: Colours of the table.
        camera: The camera of the images.
    """
    nearest = np.argsort(np.hypot(*(states[:, :2] - thing).T), kind="stable")[:_VIEWS]
    latents, _ = model.encode(states[nearest], images[nearest])
    reproduced, _ = model.decode(latents, states[nearest])
    rows, columns = np.mgrid[0 : camera.height : _STRIDE, 0 : camera.width : _STRIDE]
    missing = total = 0.0
    for index, image in zip(nearest, 255.0 * reproduced[:, ::_STRIDE, ::_STRIDE]):
        seen = images[index][::_STRIDE, ::_STRIDE]
        points = table_points(np.broadcast_to(states[index], (*rows.shape, 3)), rows, columns, camera)
        shown = np.hypot(*np.moveaxis(points - thing, -1, 0)) < _RADIUS
        shown &= background.salience(seen) > _FOREGROUND
        missing += np.square(seen[shown] - image[shown]).sum()
        total += np.square(seen[shown] - background.colour).sum()
    return 1.0 - float(missing / total) if total else 0.0
