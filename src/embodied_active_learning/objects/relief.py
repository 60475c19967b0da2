"""Relief: whether something stands on the table, or lies in its plane like a print, from the parallax between images.

Plane sweep: the surroundings of a place are rectified to planes at several heights above the table. What is at a height
looks the same in all images rectified to that height, and moves between those rectified to another one. This needs no
colours of the table and works in any light, but assumes what rectification assumes: a camera that looks straight down
from a known height, and camera states that fit the images.
"""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import pixels_of
from embodied_active_learning.objects.colours import blurred
from embodied_active_learning.objects.medians import masked_median
from embodied_active_learning.subsampling import spread_indices

_HEIGHTS = (0.0, 0.004, 0.008, 0.012, 0.016, 0.021, 0.028, 0.036, 0.046, 0.06)
"""Heights of the planes [m]."""
_MAX_HEIGHT = 0.6
"""Highest plane, relative to the height of the camera: above it, neighbouring images hardly show the same points."""
_MIN_HEIGHT = 0.006
"""Height from which a part of the surroundings is raised [m]: below, pixels hardly move between images."""
TILE = 0.054
"""Side of the surroundings that are measured [m]."""
_RADIUS, _PIXEL = 0.5 * TILE, 0.003
"""Radius of the surroundings, and pixels of their rectified images [m]. Beyond, a neighbour may stand."""
_IMAGES, _MIN_IMAGES = 24, 8
"""Largest and smallest number of compared images."""
_MIN_SPREAD = 0.015
"""Standard deviation of the camera's positions [m] below which things with a height may look flat."""
_REACH = 0.055
"""Largest distance, in x and in y, between a place and the camera of an image that shows its surroundings [m]."""
_MIN_SEEN = 5
"""Images that must show a pixel."""
_SMOOTHING = 3
"""Side of the window, in pixels, over which differences are averaged."""
_MAX_DIFFERENCE = 60.0
"""Limit of the difference of a pixel, summed over the channels [grey levels]: highlights have little weight."""
_RATIO, _NOISE = 1.5, 2.0
"""A part is raised if its differences in the table's plane exceed those at its height by this ratio, plus noise."""
_MIN_AREA = 1e-4
"""Raised area of something that stands on the table [m^2]."""
_MIN_RAISED, _MIN_SHOWN = 0.1, 0.5
"""Smallest share of raised points of an object (32 objects had 0.3 to 1), and of points that the map must show."""
_EXPLAINED = 0.1
"""Largest difference in the table's plane, relative to the contrast, of something that lies in that plane."""
_AXIS = np.arange(-_RADIUS, _RADIUS + 0.5 * _PIXEL, _PIXEL)
_DISC = np.hypot(_AXIS, _AXIS[:, np.newaxis]) < _RADIUS


class Relief(NamedTuple):
    """The surroundings of a place, as a map of S x S pixels; rows along y.

    Attributes:
        place: (2,) x [m], y [m] of its middle.
        raised: (S, S) which pixels are raised above the table.
        difference: (S, S) mean absolute difference between the images, rectified to the table's plane, and their
            median, relative to the contrast of the median.
    """

    place: np.ndarray
    raised: np.ndarray
    difference: np.ndarray

    @property
    def area(self) -> float:
        """Area within a radius of 2.7 cm that is raised above the table [m^2]."""
        return float(self.raised[_DISC].sum()) * _PIXEL**2

    @property
    def in_table_plane(self) -> bool:
        """Whether the surroundings lie in the plane of the table; false too if the images do not match well enough."""
        return self.area < _MIN_AREA and bool(self.difference[_DISC].mean() < _EXPLAINED)

    @property
    def points(self) -> np.ndarray:
        """Places (S, S, 2) [m] of the pixels."""
        return _points_around(self.place)

    def is_in_table_plane(self, points: np.ndarray) -> bool:
        """Return whether points (K, 2) [m] lie in the plane of the table, as far as the map shows them."""
        columns, rows = np.rint((points - self.place + _RADIUS) / _PIXEL).astype(int).T
        shown = (np.minimum(rows, columns) >= 0) & (np.maximum(rows, columns) < len(self.raised))
        if shown.mean() < _MIN_SHOWN:
            return False
        cells = rows[shown], columns[shown]
        return bool(self.raised[cells].mean() < _MIN_RAISED and self.difference[cells].mean() < _EXPLAINED)


def relief_at(place: np.ndarray, states: np.ndarray, images: np.ndarray, camera: CameraConfig) -> Optional[Relief]:
    """Measure the relief of the surroundings of a place; None where too few images from different places show them.

    Args:
        place: (2,) x [m], y [m] in the base frame.
        states: (N, 3) x [m], y [m], theta [rad] of the images.
        images: (N, H, W, 3) uint8.
        camera: The camera of the images.
    """
    near = np.flatnonzero(np.abs(states[:, :2] - place).max(axis=1) < _REACH)
    chosen = near[spread_indices(len(near), _IMAGES)]
    if len(chosen) < _MIN_IMAGES or np.hypot(*states[chosen, :2].std(axis=0)) < _MIN_SPREAD:
        return None
    points = _points_around(place)
    smooth: List[np.ndarray] = [blurred(images[index], camera).astype(np.float32) for index in chosen]
    planes = [height for height in _HEIGHTS if height < _MAX_HEIGHT * camera.distance]
    differences = np.empty((len(planes), len(_AXIS), len(_AXIS)))
    contrast = 0.0
    for index, height in enumerate(planes):
        rectified = _rectified(smooth, states[chosen], points, height, camera)
        seen = np.isfinite(rectified[..., 0])
        unseen = seen.sum(axis=0) < _MIN_SEEN
        rectified[:, unseen] = 0.0
        median = masked_median(rectified, np.isfinite(rectified), 0, np.nan)
        change = np.minimum(np.abs(rectified - median).sum(axis=-1), _MAX_DIFFERENCE)
        change = np.where(seen, change, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        change[unseen] = _MAX_DIFFERENCE if height else 0.0  # what is not seen at a height is not raised to it
        differences[index] = cv2.blur(change, (_SMOOTHING, _SMOOTHING))
        if index == 0:
            contrast = float(np.abs(median - np.median(median, axis=(0, 1))).sum(axis=-1).mean())
    heights = np.array(planes)[differences.argmin(axis=0)]
    clear = differences[0] + _NOISE > _RATIO * (differences.min(axis=0) + _NOISE)
    return Relief(place, clear & (heights > _MIN_HEIGHT), differences[0] / max(contrast, 1.0))


def _points_around(place: np.ndarray) -> np.ndarray:
    return place + np.stack(np.meshgrid(_AXIS, _AXIS), axis=-1)


def _rectified(
    images: Sequence[np.ndarray], states: np.ndarray, points: np.ndarray, height: float, camera: CameraConfig
) -> np.ndarray:
    """Colours (N, S, S, 3) of points (S, S, 2) at a height in images from states (N, 3), float32; NaN out of view."""
    over = states[:, np.newaxis, np.newaxis]
    on_table = over[..., :2] + (points - over[..., :2]) * (camera.distance / (camera.distance - height))
    rows, columns = pixels_of(over, on_table, camera)
    outside = (np.nan, np.nan, np.nan, 0.0)
    return np.stack(
        [
            cv2.remap(image, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
            for image, across, down in zip(images, columns.astype(np.float32), rows.astype(np.float32))
        ]
    )
