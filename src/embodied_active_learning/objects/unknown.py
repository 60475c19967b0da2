"""Unknown objects: what stands on the table although no fingerprint was found there.

The table's colours are those that appear in many parts of the scene, so no model of the table is needed. A region is
reported if its colours differ from them, it is as large as an object, and it does not lie in the plane of the table.
Nothing is reported if too much of the scene differs, as on a table with a large pattern.
"""

from __future__ import annotations

from typing import List, NamedTuple, Sequence

import cv2
import numpy as np

from embodied_active_learning.objects.colours import TableColours
from embodied_active_learning.objects.decision import Decision
from embodied_active_learning.objects.fingerprint import OBJECT
from embodied_active_learning.objects.scene_views import MOSAIC_PIXEL, Mosaic, SceneViews

_PART = 20
"""Side of a part of the scene, in pixels of the mosaic: 6 cm."""
_COMMON = 1.0 / 3.0
"""Smallest share of the parts that show a colour of the table; an object reaches into few of them."""
_FOREGROUND = 5.0
"""Smallest Mahalanobis distance of a foreground pixel from the nearest table colour."""
_MAX_FOREGROUND = 0.3
"""Largest share of foreground in a scene: above it, the table itself differs from the common colours."""
_MIN_AREA, _MAX_AREA = 4e-4, 1.2e-2
"""Visible area of an object [m^2]."""
_CROSS: np.ndarray = np.ones((3, 3), np.uint8)
_PICTURE = 20
"""Half a side of a picture, in pixels of the mosaic: 12 cm in all."""


class UnknownObject(NamedTuple):
    """Something that stands at a place where no fingerprint was found.

    Attributes:
        place: (2,) its middle, x [m], y [m] in the base frame.
        area: Its visible area [m^2].
        picture: (H, W, 3) uint8, the place from above; rows along y.
    """

    place: np.ndarray
    area: float
    picture: np.ndarray


def find_unknown(
    views: SceneViews, mosaic: Mosaic, decisions: Sequence[Decision], separation: float
) -> List[UnknownObject]:
    """Return the unknown objects of a scene, the largest one first.

    Args:
        views: The images of the scene.
        mosaic: The same images as one.
        decisions: Nothing within a distance of an object that was found is unknown.
        separation: That distance [m].
    """
    shown = mosaic.inside & mosaic.seen
    if not shown.any():
        return []
    foreground = (_table_colours(mosaic, shown).distance(mosaic.features) > _FOREGROUND) & shown
    if foreground.sum() > _MAX_FOREGROUND * shown.sum():
        return []
    x, y = np.meshgrid(mosaic.x, mosaic.y)
    for decision in decisions:
        if decision.found and decision.kind == OBJECT:
            foreground &= np.hypot(x - decision.pose[0], y - decision.pose[1]) > separation
    cleaned = cv2.morphologyEx(foreground.astype(np.uint8), cv2.MORPH_CLOSE, _CROSS)
    cleaned = cv2.morphologyEx(cleaned, cv2.MORPH_OPEN, _CROSS)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(cleaned)
    areas = np.asarray(statistics)[:, cv2.CC_STAT_AREA] * MOSAIC_PIXEL**2
    found = []
    for label in 1 + np.argsort(-areas[1:], kind="stable"):
        if _MIN_AREA <= areas[label] <= _MAX_AREA:
            rows, columns = (int(values.mean()) for values in np.nonzero(np.asarray(labels) == label))
            picture = mosaic.colours[
                max(rows - _PICTURE, 0) : rows + _PICTURE, max(columns - _PICTURE, 0) : columns + _PICTURE
            ]
            place = np.array([mosaic.x[columns], mosaic.y[rows]])
            relief = views.relief_at(place)
            if relief is None or not relief.in_table_plane:
                found.append(UnknownObject(place, float(areas[label]), picture))
    return found


def _table_colours(mosaic: Mosaic, shown: np.ndarray) -> TableColours:
    """The colours that many parts of the scene share."""
    size = len(mosaic.x)
    parts = [
        mosaic.features[rows, columns][shown[rows, columns]]
        for rows in (slice(begin, begin + _PART) for begin in range(0, size, _PART))
        for columns in (slice(begin, begin + _PART) for begin in range(0, size, _PART))
    ]
    return TableColours([part for part in parts if len(part)], _COMMON)
