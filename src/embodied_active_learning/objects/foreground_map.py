"""Visible things on the table, found without the model: places that are foreground in most images that show them."""

from __future__ import annotations

from typing import Tuple

import numpy as np
from scipy import ndimage
from sklearn.cluster import MeanShift

from embodied_active_learning.config import Config
from embodied_active_learning.geometry import table_points
from embodied_active_learning.images import spread_indices
from embodied_active_learning.objects.salience import Background

_CELL = 0.01  # m
_MARGIN = 0.08
"""How far the map extends beyond the workspace [m]: half of what the camera sees at its border."""
_STRIDE = 4
"""Every how many rows and columns of an image are projected onto the table."""
_IMAGES = 100
"""Number of images, spread over the run, that are projected."""
_FOREGROUND = 0.5
"""Smallest mean salience of a thing. Textures of a table stay below it: they look alike everywhere."""
_MIN_CELLS = 3
_BLUR = 0.7  # cells
_WIDTH = 0.045  # m
"""Bandwidth of mean shift, which separates things that touch, such as an object on a print."""


def visible_things(states: np.ndarray, images: np.ndarray, background: Background, config: Config) -> np.ndarray:
    """Return the centres (K, 2) [m] of everything that differs from the table, also at the border of the workspace.

    Unlike the clusters of the conditional entropy, they depend on colours alone: they are what the model should find.

    Args:
        states: (N, 3) x [m], y [m], theta [rad].
        images: (N, H, W, 3) uint8.
        background: Colours of the table.
        config: The run's configuration.
    """
    lower, salience = _mean_salience(states, images, background, config)
    regions, count = ndimage.label(salience > _FOREGROUND)
    centres = [np.empty((0, 2))]
    for region in range(1, count + 1):
        cells = np.argwhere(regions == region)
        if len(cells) >= _MIN_CELLS:
            centres.append(MeanShift(bandwidth=_WIDTH / _CELL).fit(cells).cluster_centers_)
    return lower + (np.concatenate(centres) + 0.5) * _CELL


def _mean_salience(
    states: np.ndarray, images: np.ndarray, background: Background, config: Config
) -> Tuple[np.ndarray, np.ndarray]:
    """Return the lower corner (2,) [m] of a grid over the table, and the mean salience (X, Y) of its cells."""
    workspace = config.workspace.box()
    lower = np.array(workspace.lower[:2]) - _MARGIN
    shape = np.ceil((np.array(workspace.upper[:2]) + _MARGIN - lower) / _CELL).astype(int)
    total, seen = np.zeros(shape), np.zeros(shape)
    rows, columns = np.mgrid[0 : config.camera.height : _STRIDE, 0 : config.camera.width : _STRIDE]
    for index in spread_indices(len(images), _IMAGES):
        points = table_points(np.broadcast_to(states[index], (*rows.shape, 3)), rows, columns, config.camera)
        cells = np.floor((points - lower) / _CELL).astype(int)
        inside = np.all((cells >= 0) & (cells < shape), axis=-1)
        flat = np.ravel_multi_index(tuple(cells[inside].T), tuple(shape))
        salience = background.salience(images[index][::_STRIDE, ::_STRIDE])[inside]
        total += np.bincount(flat, salience, total.size).reshape(shape)
        seen += np.bincount(flat, minlength=seen.size).reshape(shape)
    smooth_total, smooth_seen = (ndimage.gaussian_filter(part, _BLUR) for part in (total, seen))
    return lower, smooth_total / np.maximum(smooth_seen, 1e-9)
