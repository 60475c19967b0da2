"""Visible things on the table, found without the model: places that are foreground in most images that show them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Tuple

import numpy as np
from scipy import ndimage

from embodied_active_learning.config import Config
from embodied_active_learning.geometry import table_points
from embodied_active_learning.objects.mean_shift import mean_shift
from embodied_active_learning.objects.relief import TILE, relief_at
from embodied_active_learning.objects.salience import Background
from embodied_active_learning.subsampling import spread_indices

_CELL = 0.01  # m
_MARGIN = 0.08
"""How far the map extends beyond the workspace [m]: half of what the camera sees at its border."""
_STRIDE = 4
"""Stride of the rows and columns of an image that are projected onto the table."""
_IMAGES = 100
"""Number of images, spread over the run, that are projected."""
_FOREGROUND = 0.5
"""Smallest mean salience of a thing. Textures of a table stay below it: they look alike everywhere."""
_MIN_CELLS = 3
_BLUR = 0.7  # cells
_OVERHANG = 0.02
"""Largest distance of a tile's middle from the workspace [m]: few images show what is farther away."""
_WIDTH = 0.045  # m
"""Bandwidth of mean shift, which separates things that touch."""
_SEED_STRIDE = 4
"""Mean shift starts from every fourth cell: from all of them it takes most of the time of a map."""


@dataclass(frozen=True, eq=False)
class ForegroundMap:
    """Which cells of the table differ from its colours, and where something stands on it.

    Attributes:
        lower: (2,) lower corner of the grid [m].
        foreground: (X, Y) cells that differ from the table's colours in most images.
        standing: (X, Y) cells that do not lie in the plane of the table, or of unknown height within the workspace.
    """

    lower: np.ndarray
    foreground: np.ndarray
    standing: np.ndarray

    @cached_property
    def things(self) -> np.ndarray:
        """Centres (K, 2) [m] of the foreground that stands on the table."""
        return self._centres(self.foreground & self.standing)

    @property
    def prints(self) -> np.ndarray:
        """Centres (K, 2) [m] of the foreground that lies in the plane of the table."""
        return self._centres(self.foreground & ~self.standing)

    def stands_at(self, points: np.ndarray) -> np.ndarray:
        """Return at which points (K, 2) [m] something stands; false beyond the map."""
        cells = _cells_of(points, self.lower)
        inside = np.all((cells >= 0) & (cells < self.standing.shape), axis=-1)
        return inside & self.standing[tuple(np.where(inside[:, np.newaxis], cells, 0).T)]

    def _centres(self, mask: np.ndarray) -> np.ndarray:
        regions, count = ndimage.label(mask)
        centres = [np.empty((0, 2))]
        for region in range(1, count + 1):
            cells = np.argwhere(regions == region)
            if len(cells) >= _MIN_CELLS:
                centres.append(mean_shift(cells, _WIDTH / _CELL, seeds=cells[::_SEED_STRIDE]).centres)
        return self.lower + (np.concatenate(centres) + 0.5) * _CELL


def map_foreground(states: np.ndarray, images: np.ndarray, background: Background, config: Config) -> ForegroundMap:
    """Map everything that differs from the table, also at the border of the workspace.

    Unlike the clusters of the conditional entropy, the map depends on images alone: it shows what the model should
    find. With `fingerprint/prints`, what lies in the plane of the table is taken for standing too.

    Args:
        states: (N, 3) x [m], y [m], theta [rad].
        images: (N, H, W, 3) uint8.
        background: Colours of the table.
        config: The run's configuration.
    """
    lower, salience = _mean_salience(states, images, background, config)
    foreground = salience > _FOREGROUND
    if config.fingerprint.prints:
        return ForegroundMap(lower, foreground, np.ones_like(foreground))
    return ForegroundMap(lower, foreground, _standing(lower, foreground, states, images, config))


def _standing(
    lower: np.ndarray, foreground: np.ndarray, states: np.ndarray, images: np.ndarray, config: Config
) -> np.ndarray:
    """Return the cells (X, Y) that are raised above the table, and those of unknown height within the workspace.

    The relief is measured where there is foreground. Cells next to raised ones or enclosed by them count as raised: the
    height of a plain surface cannot be measured, because it looks the same in all images rectified to any height. If
    camera states are wrong by more than a millimetre, prints seem to be raised too, but no object is missed.
    """
    raised, known = np.zeros_like(foreground), np.zeros_like(foreground)
    box = config.workspace.box()
    lower_limit, upper_limit = np.array(box.lower[:2]), np.array(box.upper[:2])
    tiles = np.unique((np.argwhere(foreground) + 0.5) * _CELL // TILE, axis=0)
    places = np.clip(lower + (tiles + 0.5) * TILE, lower_limit - _OVERHANG, upper_limit + _OVERHANG)
    for place in np.unique(places, axis=0):
        relief = relief_at(place, states, images, config.camera)
        if relief is None:
            continue
        cells = _cells_of(relief.points, lower)
        inside = np.all((cells >= 0) & (cells < foreground.shape), axis=-1)
        known[tuple(cells[inside].T)] = True
        raised[tuple(cells[inside & relief.raised].T)] = True
    middles = lower + (np.moveaxis(np.indices(foreground.shape), 0, -1) + 0.5) * _CELL
    within = np.all((middles > lower_limit) & (middles < upper_limit), axis=-1)
    near = ndimage.binary_dilation(raised | (foreground & within & ~known))
    return np.asarray(ndimage.binary_fill_holes(near))


def _cells_of(points: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """Cells (..., 2) that contain points (..., 2) [m]."""
    return np.floor((points - lower) / _CELL).astype(int)


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
        cells = _cells_of(points, lower)
        inside = np.all((cells >= 0) & (cells < shape), axis=-1)
        flat = np.ravel_multi_index(tuple(cells[inside].T), tuple(shape))
        salience = background.salience(images[index][::_STRIDE, ::_STRIDE])[inside]
        total += np.bincount(flat, salience, total.size).reshape(shape)
        seen += np.bincount(flat, minlength=seen.size).reshape(shape)
    smooth_total, smooth_seen = (ndimage.gaussian_filter(part, _BLUR) for part in (total, seen))
    return lower, smooth_total / np.maximum(smooth_seen, 1e-9)
