"""The images of a scene, sampled at points of the table to compare candidates with them."""

from __future__ import annotations

from functools import cached_property
from typing import Dict, Optional, Tuple

import numpy as np
from scipy.spatial import cKDTree

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.objects.appearance import sample_image
from embodied_active_learning.objects.colours import blurred, colour_features, dark_factor, luminance_of
from embodied_active_learning.objects.relief import Relief, relief_at
from embodied_active_learning.workspace import Workspace

MOSAIC_PIXEL = 0.003
"""Size of a pixel of the mosaic [m]."""
_BORDER = 0.0575
"""Extent of the mosaic beyond its inside [m]: an object with its centre there, and the table around it."""


class SceneViews:
    """Images (N, H, W, 3) uint8 of one scene from states (N, 3) [m, m, rad]."""

    def __init__(self, states: np.ndarray, images: np.ndarray, camera: CameraConfig) -> None:
        """Keep the images; they are blurred when they are first used."""
        self.states: np.ndarray = np.asarray(states, dtype=np.float64).reshape(-1, 3)
        self._images = images
        self._camera = camera
        self._blurred: Dict[int, np.ndarray] = {}
        self._tree = cKDTree(self.states[:, :2]) if len(self.states) else None

    def nearest(self, place: np.ndarray, count: int, distance: float) -> np.ndarray:
        """Return the images (V,) from the positions nearest to a place (2,) [m]: at most count, within a distance."""
        if self._tree is None:
            return np.empty(0, np.int64)
        _, found = self._tree.query(place, k=min(count, len(self.states)), distance_upper_bound=distance)
        found = np.atleast_1d(found)
        return found[found < len(self.states)]

    def relief_at(self, place: np.ndarray) -> Optional[Relief]:
        """Return the relief of the surroundings of a place (2,) [m]; None where too few images show them."""
        return relief_at(place, self.states, self._images, self._camera)

    def features(self, view: int, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Features (..., 3) of an image at points (..., 2) of the table, and which of them are in view."""
        colours, valid = self.colours(view, points)
        return colour_features(colours), valid

    def colours(self, view: int, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Colours (..., 3) uint8 of an image at points (..., 2) of the table, and which of them are in view."""
        if view not in self._blurred:
            self._blurred[view] = blurred(self._images[view], self._camera)
        return sample_image(self._blurred[view], self.states[view], points, self._camera)


class Mosaic:
    """The table from above: each pixel from the image that was taken from nearest above it, so parallax is small.

    Attributes:
        x, y: (S,) coordinates of the pixels' columns and rows [m].
        colours: (S, S, 3) uint8; row index along y.
        features: (S, S, 3).
        darkness: (S, S) dark_factor of the pixels.
        seen: (S, S) whether the pixel was in view.
        inside: (S, S) whether it lies in the workspace or its margin, where an object may have its centre.
        in_workspace: (S, S) whether it lies in the workspace, where the camera can look straight down at it.
    """

    def __init__(self, views: SceneViews, workspace: Workspace, margin: float) -> None:
        """Sample the images over a workspace. margin: part around it that also counts as inside [m]."""
        lower, upper = (np.asarray(limit[:2]) for limit in (workspace.lower, workspace.upper))
        size = int(np.ceil((float(np.max(upper - lower)) + 2.0 * (margin + _BORDER)) / MOSAIC_PIXEL))
        steps = (np.arange(size) + 0.5 - size / 2) * MOSAIC_PIXEL
        self.x, self.y = (middle + steps for middle in (lower + upper) / 2.0)
        points = np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)
        colours: np.ndarray = np.zeros((len(points), 3), np.uint8)
        seen: np.ndarray = np.zeros(len(points), dtype=bool)
        if len(views.states):
            _, source = cKDTree(views.states[:, :2]).query(points)
            order = np.argsort(source, kind="stable")
            ends = np.searchsorted(source[order], np.arange(len(views.states) + 1))
            for view in np.unique(source):
                pixels = order[ends[view] : ends[view + 1]]
                colours[pixels], seen[pixels] = views.colours(int(view), points[pixels])
        self._lower, self._upper = lower, upper
        self.colours, self.seen = colours.reshape(size, size, 3), seen.reshape(size, size)
        self.features = colour_features(self.colours)
        self.darkness = dark_factor(luminance_of(self.features))
        self.inside, self.in_workspace = (
            ((points >= lower - border) & (points <= upper + border)).all(axis=1).reshape(size, size)
            for border in (margin, 0.0)
        )

    def above(self, place: np.ndarray) -> np.ndarray:
        """Return the camera position (2,) of the workspace that is nearest to a place (2,) [m]."""
        return np.clip(place, self._lower, self._upper)

    @property
    def coverage(self) -> float:
        """Share of the inside that was seen."""
        return float(self.seen[self.inside].mean())


class ObservedScene:
    """The images of a scene as views and, composed when it is first used, as a mosaic."""

    def __init__(
        self, states: np.ndarray, images: np.ndarray, camera: CameraConfig, workspace: Workspace, margin: float
    ) -> None:
        """Keep images (N, H, W, 3) uint8 from states (N, 3) [m, m, rad]. margin: see Mosaic."""
        self.views = SceneViews(states, images, camera)
        self._workspace, self._margin = workspace, margin

    @cached_property
    def mosaic(self) -> Mosaic:
        """The images as one."""
        return Mosaic(self.views, self._workspace, self._margin)
