"""Search for a bare place of the table that a blank fingerprint shows."""

from __future__ import annotations

from typing import NamedTuple, Sequence

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.geometry import table_points
from embodied_active_learning.objects.colours import TableColours, blurred, colour_features, table_features
from embodied_active_learning.objects.fingerprint import Fingerprint
from embodied_active_learning.objects.scene_views import MOSAIC_PIXEL, Mosaic

RADIUS = 0.045
"""Radius of the place that has to be bare [m]."""
_KNOWN = 4.0
"""Largest Mahalanobis distance of a table pixel from the nearest table colour."""
_GAINS = np.arange(-0.7, 0.51, 0.1)
"""Log gains between the learned table and this one, that is, brightness 0.5 to 1.6."""
_KNOWN_TABLE = 0.5
"""Share of table pixels in the scene below which its table is unknown."""
_MIN_BARE = 0.9
"""Smallest share of table pixels of a bare place, even if the fingerprint's own views show less of the table."""
_STRIDE = 4


class BarePlace(NamedTuple):
    """The place of a scene that looks most like the bare table.

    Attributes:
        place: (2,) x [m], y [m].
        share: Share of its pixels that have the table's colours.
        known: Whether the scene's table is the learned one, in any light.
    """

    place: np.ndarray
    share: float
    known: bool


class BareTable:
    """The table around a blank fingerprint."""

    def __init__(self, fingerprint: Fingerprint, fingerprints: Sequence[Fingerprint], camera: CameraConfig) -> None:
        """Fit the table's colours to all fingerprints of the set, and measure their share in the blank's own views."""
        parts = [table_features(item, fingerprints, camera) for item in fingerprints]
        self._colours = TableColours([part for part in parts if len(part)])
        self._own_shares = np.sort([self._share(view, fingerprint, camera) for view in range(len(fingerprint.states))])

    def limit(self, error_rate: float) -> float:
        """Return the smallest share of table pixels of a bare place: the conformal quantile of the own views."""
        rank = int(error_rate * (len(self._own_shares) + 1))
        return max(float(self._own_shares[max(rank - 1, 0)]), _MIN_BARE)

    def confidence(self, share: float) -> float:
        """Return the share of the own views with at most this share of table pixels; conformal, so below 1."""
        return float(np.searchsorted(self._own_shares, share, side="right")) / (len(self._own_shares) + 1)

    def search(self, mosaic: Mosaic) -> BarePlace:
        """Find the most table-like place of a mosaic, under any brightness."""
        radius = round(RADIUS / MOSAIC_PIXEL)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)).astype(np.float32)
        disc /= disc.sum()
        shares: np.ndarray = np.full(mosaic.seen.shape, -1.0, np.float32)
        known = 0.0
        for gain in _GAINS:
            change: np.ndarray = np.array([gain, 0.0, 0.0], np.float32)
            table = ((self._colours.distance(mosaic.features - change) < _KNOWN) & mosaic.seen).astype(np.float32)
            known = max(known, float(table[mosaic.inside].mean()))
            shares = np.maximum(shares, cv2.filter2D(table, -1, disc, borderType=cv2.BORDER_CONSTANT))
        shares[~mosaic.in_workspace] = -1.0
        row, column = np.unravel_index(int(shares.argmax()), shares.shape)
        place = np.array([mosaic.x[column], mosaic.y[row]])
        return BarePlace(place, float(shares[row, column]), known >= _KNOWN_TABLE)

    def _share(self, view: int, fingerprint: Fingerprint, camera: CameraConfig) -> float:
        """Share of table pixels in one of the own views, around the fingerprint's centre."""
        rows, columns = np.mgrid[0 : camera.height : _STRIDE, 0 : camera.width : _STRIDE]
        points = table_points(fingerprint.states[view], rows, columns, camera)
        near = np.hypot(*np.moveaxis(points - fingerprint.centre[:2], -1, 0)) < RADIUS
        features = colour_features(blurred(fingerprint.images[view], camera)[::_STRIDE, ::_STRIDE][near])
        return float((self._colours.distance(features) < _KNOWN).mean()) if near.any() else 0.0
