"""What the object of a fingerprint looks like, apart from the table that it stands on.

Each view is rectified into the object's coordinates on the table (x and y from the fingerprint's centre, turned with
it). Pixels that differ from the table's colours are the object's; around them lies a ring that shows the table. Both
are stored as sample points with features of the object: points of the ring have those of the nearest point of the
object, which a larger object of the same colours would show. Views differ by parallax only, so a new view is compared
with the stored view from the nearest position relative to the object.

Assumptions beyond the paper: a camera that looks straight down from a known height, and an object whose visible part
fits into a square of 12 cm and differs in colour from the table that it was learned on.
"""

from __future__ import annotations

from typing import Sequence, Tuple, Union

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import pixels_of, to_base_frame, to_object_frame, wrap
from embodied_active_learning.objects.colours import (
    OBJECT_REACH,
    TableColours,
    blurred,
    colour_features,
    table_features,
)
from embodied_active_learning.objects.fingerprint import OBJECT, Fingerprint

SIDE = 80
"""Pixels along a side of a rectified view."""
PIXEL = 0.0015
"""Size of one of them [m]."""
INSIDE_POINTS, RING_POINTS = 256, 192
_FOREGROUND = 4.0
"""Smallest Mahalanobis distance of an object's pixel from the nearest table colour."""
_MIN_PIXELS = 60
"""Smallest object in a view: 1.35 cm2."""
_SIMILAR_AREA = 0.25
"""Smallest area of the object in a usable view, relative to the median: smaller ones are cut by the border."""
_MIN_VIEWS = 8
"""Smallest number of usable views: the calibration holds out five, which are compared with the others."""
_CLUTTER = 0.1
"""Largest area of foreground beside the object, relative to the object's area."""
_OFF_CENTRE = SIDE / 6
"""Standard deviation [px] of the Gaussian that weights a region by its distance from the centre: 2 cm, more than the
error of a centre."""
_MIDDLE = slice(SIDE // 2 - 5, SIDE // 2 + 5)
"""Rows and columns of the rectified pixels in the middle, which show the object: 1.5 cm."""
_CROSS: np.ndarray = np.ones((3, 3), np.uint8)
_CLOSING = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
# The ring lies 3 to 10.5 mm outside the object: beyond the blur of its border, but on the table next to it.
_RING_INNER, _RING_OUTER = (cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)) for size in (5, 15))


class Appearance:
    """The object's sample points in every view of a fingerprint.

    Attributes:
        offsets: (V, 2) camera positions relative to the object [m], in the object's coordinates.
        usable: (V,) whether the view shows the object well enough to be compared with.
        inside_points: (V, I, 2) points of the object [m]. Its features there are inside_features (V, I, 3).
        ring_points: (V, R, 2) points of the table around it. The object's nearest features are ring_features (V, R, 3).
        colours: (V, SIDE, SIDE, 3) uint8, the rectified views; rows along the object's y, columns along its x.
        in_view: (V, SIDE, SIDE) which of their pixels the image shows.
        masks: (V, SIDE, SIDE) which of them are the object's.
        area: Median visible area of the object [m^2].
        contrast: Standard deviation of the object's log luminance, and of its colour; NaN without usable views.
        middle: (2,) mean position of its pixels [m]; NaN without usable views.
        problem: Why the object cannot be recognised, and the remedy; empty if it can.
    """

    def __init__(self, fingerprint: Fingerprint, fingerprints: Sequence[Fingerprint], camera: CameraConfig) -> None:
        """Learn the appearance from the views of a fingerprint; the others of its set show more of the table."""
        self.fingerprint = fingerprint
        self.camera = camera
        self.offsets = to_object_frame(fingerprint.states, fingerprint.centre)
        self.colours, self.in_view = self._rectified()
        features = [colour_features(colours) for colours in self.colours]
        self.masks, clutter = self._segment(features, fingerprints)
        sizes = self.masks.sum(axis=(1, 2))
        self.usable = (sizes >= _MIN_PIXELS) & (sizes > _SIMILAR_AREA * np.median(sizes))
        self.area = float(np.median(sizes)) * PIXEL**2
        self._sample(features)
        self.contrast, self.middle = (np.nan, np.nan), np.full(2, np.nan)
        if self.usable.any():
            std = self.inside_features[self.usable].std(axis=1)
            self.contrast = float(np.median(std[:, 0])), float(np.median(np.hypot(std[:, 1], std[:, 2])))
            self.middle = self.inside_points[self.usable].mean(axis=(0, 1))
        self.problem = self._problem(clutter)

    def nearest_views(self, offsets: np.ndarray, excluded: Union[Sequence[int], np.ndarray] = ()) -> np.ndarray:
        """Return the usable view (N,) nearest to each relative camera position (N, 2) [m], except excluded ones."""
        distance = np.square(self.offsets - offsets[:, None]).sum(axis=2)
        distance[:, ~self.usable] = np.inf
        distance[:, list(excluded)] = np.inf
        return distance.argmin(axis=1)

    def middle_at(self, pose: np.ndarray) -> np.ndarray:
        """Return the pose (3,) of the object's visible middle if its fingerprint's centre is at a pose (3,)."""
        return np.array([*to_base_frame(self.middle[None], pose[None])[0, 0], wrap(pose[2])])

    def centre_at(self, middle: np.ndarray) -> np.ndarray:
        """Return the pose (3,) of the fingerprint's centre if the object's visible middle is at a pose (3,)."""
        turn = np.array([[0.0, 0.0, middle[2]]])
        return np.array([*(middle[:2] - to_base_frame(self.middle[None], turn)[0, 0]), middle[2]])

    @property
    def central_view(self) -> int:
        """Index of the usable view whose camera was nearest to the object's centre."""
        return int(self.nearest_views(np.zeros((1, 2)))[0])

    def _rectified(self) -> Tuple[np.ndarray, np.ndarray]:
        """Colours (V, SIDE, SIDE, 3) uint8 of the views in the object's coordinates, and whether each is in view."""
        points = to_base_frame(_GRID, self.fingerprint.centre[None])[0]
        views = [
            sample_image(blurred(image, self.camera), state, points, self.camera)
            for image, state in zip(self.fingerprint.images, self.fingerprint.states)
        ]
        colours, valid = (np.array(part) for part in zip(*views))
        return colours.reshape(-1, SIDE, SIDE, 3), valid.reshape(-1, SIDE, SIDE)

    def _segment(
        self, features: Sequence[np.ndarray], fingerprints: Sequence[Fingerprint]
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Separate object and table in all views.

        Args:
            features: (SIDE, SIDE, 3) of each view.
            fingerprints: All fingerprints of the set.

        Returns:
            Masks (V, SIDE, SIDE) of the object, and the number (V,) of foreground pixels beside it.
        """
        middle = colour_features(self.colours[:, _MIDDLE, _MIDDLE][self.in_view[:, _MIDDLE, _MIDDLE]])
        table = _table(self.fingerprint, fingerprints, middle, self.camera)
        near = _away_from_others(self.fingerprint, fingerprints)
        masks: np.ndarray = np.zeros(self.in_view.shape, dtype=bool)
        clutter = np.zeros(len(masks))
        for view, in_view in enumerate(self.in_view):
            foreground = (table.distance(features[view]) > _FOREGROUND) & in_view
            masks[view] = _object_mask(foreground)
            clutter[view] = (foreground & near & ~cv2.dilate(masks[view].astype(np.uint8), _CLOSING)).sum()
        return masks, clutter

    def _sample(self, features: Sequence[np.ndarray]) -> None:
        """Draw the sample points of each view with enough of the object. features: (SIDE, SIDE, 3) of each view."""
        views, random = len(self.masks), np.random.default_rng(0)
        self.inside_points: np.ndarray = np.zeros((views, INSIDE_POINTS, 2), np.float32)
        self.inside_features: np.ndarray = np.zeros((views, INSIDE_POINTS, 3), np.float32)
        self.ring_points: np.ndarray = np.zeros((views, RING_POINTS, 2), np.float32)
        self.ring_features: np.ndarray = np.zeros((views, RING_POINTS, 3), np.float32)
        for view in np.flatnonzero(self.masks.sum(axis=(1, 2)) >= _MIN_PIXELS):
            mask = self.masks[view].astype(np.uint8)
            inside = cv2.erode(mask, _CROSS)
            inside = inside if inside.sum() >= _MIN_PIXELS / 2 else mask
            ring = (cv2.dilate(mask, _RING_OUTER) > 0) & (cv2.dilate(mask, _RING_INNER) == 0)
            extended = _extended(features[view], np.greater(inside, 0)).reshape(-1, 3)
            for shown, count, points, values in (
                (inside > 0, INSIDE_POINTS, self.inside_points, self.inside_features),
                (ring, RING_POINTS, self.ring_points, self.ring_features),
            ):
                pixels = np.flatnonzero(shown)
                if len(pixels):
                    chosen = random.choice(pixels, count, replace=len(pixels) < count)
                    points[view], values[view] = _GRID[chosen], extended[chosen]

    def _problem(self, clutter: np.ndarray) -> str:
        """Return why the object cannot be recognised, or an empty text. clutter: (V,) pixels, see _segment."""
        if self.usable.sum() < len(self.usable) / 2:
            return (
                "no object distinct from the table in its views: train longer, or learn it on a table of another colour"
            )
        if self.usable.sum() < _MIN_VIEWS:
            return (
                f"only {self.usable.sum()} views show all of it: raise fingerprint/views, then fingerprint the session "
                "again"
            )
        sizes = self.masks.sum(axis=(1, 2))
        if float(np.median(clutter[self.usable] / sizes[self.usable])) > _CLUTTER:
            return (
                "the table around it has colours that the other views do not show, so that object and table cannot be "
                "told apart: learn it on a plainer table"
            )
        return ""


def sample_image(
    image: np.ndarray, state: np.ndarray, points: np.ndarray, camera: CameraConfig
) -> Tuple[np.ndarray, np.ndarray]:
    """Colours (..., 3) uint8 of an image from a state (3,) at points (..., 2) of the table, and which are in view."""
    rows, columns = pixels_of(state.astype(np.float32), points, camera)
    rows, columns = (np.floor(axis + 0.5).astype(np.int32) for axis in (rows, columns))
    valid = (rows >= 0) & (columns >= 0) & (rows < camera.height) & (columns < camera.width)
    return image.reshape(-1, 3)[np.where(valid, rows * camera.width + columns, 0)], valid


def grid_cells(points: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return row and column of the rectified pixel at points (..., 2) [m], clipped, and whether they were inside."""
    cells = np.floor(points / PIXEL + SIDE / 2).astype(np.int32)
    inside = ((cells >= 0) & (cells < SIDE)).all(axis=-1)
    cells = np.clip(cells, 0, SIDE - 1)
    return cells[..., 1], cells[..., 0], inside


def pixel_positions() -> np.ndarray:
    """(SIDE, SIDE, 2) centres of the rectified pixels in the object's coordinates [m]."""
    axis = (np.arange(SIDE) + 0.5 - SIDE / 2) * PIXEL
    return np.stack(np.meshgrid(axis, axis), axis=-1).astype(np.float32)


_GRID = pixel_positions().reshape(-1, 2)


def _table(
    fingerprint: Fingerprint, fingerprints: Sequence[Fingerprint], middle: np.ndarray, camera: CameraConfig
) -> TableColours:
    """The table's colours: around this fingerprint, and around the others of its set.

    Colours around this fingerprint are left out if the middle of its views, with features (N, 3), has them but no other
    fingerprint's surroundings do: they belong to an object that reaches beyond OBJECT_REACH.
    """
    own = table_features(fingerprint, fingerprints, camera)
    others = [table_features(item, fingerprints, camera) for item in fingerprints if item is not fingerprint]
    others = [part for part in others if len(part)]
    if others and len(own):
        elsewhere = TableColours(others)
        middle = middle[elsewhere.distance(middle) > _FOREGROUND]
        if len(middle):
            own = own[(TableColours([middle]).distance(own) > _FOREGROUND) | (elsewhere.distance(own) <= _FOREGROUND)]
    return TableColours([part for part in (own, *others) if len(part)] or [np.zeros((1, 3), np.float32)])


def _away_from_others(fingerprint: Fingerprint, fingerprints: Sequence[Fingerprint]) -> np.ndarray:
    """Which rectified pixels (SIDE, SIDE) are not near the centre of another object of the set."""
    points = to_base_frame(_GRID, fingerprint.centre[None])[0]
    away: np.ndarray = np.ones(len(points), dtype=bool)
    for other in fingerprints:
        if other.kind == OBJECT and other is not fingerprint:
            away &= np.hypot(*(points - other.centre[:2]).T) > OBJECT_REACH
    return away.reshape(SIDE, SIDE)


def _object_mask(foreground: np.ndarray) -> np.ndarray:
    """Mask (SIDE, SIDE) of the largest foreground region, weighted by distance from the centre; gaps closed."""
    cleaned = cv2.morphologyEx(foreground.astype(np.uint8), cv2.MORPH_OPEN, _CROSS)
    cleaned = cv2.morphologyEx(cleaned, cv2.MORPH_CLOSE, _CLOSING)
    count, labels, statistics, centres = cv2.connectedComponentsWithStats(cleaned)
    if count == 1:
        return np.zeros_like(foreground)
    distance = np.square(np.asarray(centres)[1:] - SIDE / 2).sum(axis=1)
    sizes = np.asarray(statistics)[1:, cv2.CC_STAT_AREA] * np.exp(-0.5 * distance / _OFF_CENTRE**2)
    return np.equal(labels, 1 + int(sizes.argmax()))


def _extended(features: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Extend features (SIDE, SIDE, 3): each pixel outside gets those of the nearest pixel inside."""
    outside: np.ndarray = (~inside).astype(np.uint8)
    _, found = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    labels = np.asarray(found)
    source: np.ndarray = np.zeros(labels.max() + 1, np.int64)
    pixels = np.flatnonzero(inside)
    source[labels.ravel()[pixels]] = pixels
    return features.reshape(-1, 3)[source[labels]]
