"""Check size, visibility and position of the objects of a world."""

from __future__ import annotations

import itertools
import logging
import math
from typing import Sequence

import cv2
import numpy as np

from embodied_active_learning.config import CameraConfig
from embodied_active_learning.errors import WorldError
from embodied_active_learning.geometry import metres_per_pixel
from embodied_active_learning.simulation.placed_objects import PlacedObject, Table
from embodied_active_learning.workspace import Workspace

CLEARANCE = 0.05
"""Required distance (m) between the top of an object and the camera."""
_SMALLEST, _LARGEST = 0.005, 0.5  # m, of an object's largest side
_MIN_VISIBLE_AREA = 1e-6  # m^2
_MIN_DISTANCE = 0.01  # m, between two centres
_MAX_OVERLAP = 0.5  # of the smaller footprint

_log = logging.getLogger(__name__)


def check_objects(objects: Sequence[PlacedObject], table: Table) -> None:
    """Check size, visibility and place of all objects. Raises WorldError with the remedy; logs a slight overlap."""
    for item in objects:
        _check_size(item)
        if item.scale**2 * item.model.visible_area < _MIN_VISIBLE_AREA:
            raise WorldError(
                f"objects/{item.name} cannot be seen from above: no face of {item.model.mesh} points up; flip its "
                "faces (normals), or rotate the model in its URDF"
            )
        if not table.contains(item.corners()):
            raise WorldError(
                f"objects/{item.name} at {list(item.position)} does not stand on the table, which is "
                f"{list(table.size)} m around {list(table.centre)}: move it, or enlarge table/size"
            )
    for first, second in itertools.combinations(objects, 2):
        _check_overlap(first, second)


def check_heights(objects: Sequence[PlacedObject], camera: CameraConfig) -> None:
    """Check that all objects stay below the camera. Raises WorldError."""
    for item in objects:
        top = item.height + item.extent[2]
        if top > camera.distance - CLEARANCE:
            raise WorldError(
                f"objects/{item.name} reaches {100 * top:.1f} cm above the table, the camera is at "
                f"{100 * camera.distance:.1f} cm (camera/distance): keep {100 * CLEARANCE:.0f} cm below it, by height, "
                "scale or size"
            )


def warn_of_unseen(objects: Sequence[PlacedObject], workspace: Workspace, camera: CameraConfig) -> None:
    """Log objects that are out of the camera's view from everywhere in the workspace."""
    half_view = np.array([camera.width, camera.height]) * metres_per_pixel(camera) / 2.0
    reach = float(np.hypot(*half_view))  # the camera may have any yaw
    lower, upper = np.array(workspace.lower[:2]) - reach, np.array(workspace.upper[:2]) + reach
    for item in objects:
        corners = item.corners()
        if np.any(corners.max(axis=0) < lower) or np.any(corners.min(axis=0) > upper):
            _log.warning(
                "objects/%s at %s is never in the camera's view: move it into the workspace (x %s m, y %s m), or "
                "enlarge the workspace",
                item.name,
                list(item.position),
                [workspace.lower[0], workspace.upper[0]],
                [workspace.lower[1], workspace.upper[1]],
            )


def _check_size(item: PlacedObject) -> None:
    largest = float(item.extent.max())
    if _SMALLEST <= largest <= _LARGEST:
        return
    measures = " x ".join(f"{side:.3g}" for side in item.extent)
    hint = "in millimetres" if largest > _LARGEST else "in another unit"
    raise WorldError(
        f"objects/{item.name} measures {measures} m: is its model {hint}? Set size: 0.08 (m, largest side), or scale"
    )


def _check_overlap(first: PlacedObject, second: PlacedObject) -> None:
    """Compare the boxes around two objects."""
    apart = first.height >= second.height + second.extent[2] or second.height >= first.height + first.extent[2]
    if apart:
        return
    distance = math.dist(first.position, second.position)
    shared = _shared_area(first.corners(), second.corners())
    smaller = min(float(np.prod(item.extent[:2])) for item in (first, second))
    message = (
        f"objects/{first.name} and objects/{second.name} overlap, their centres are {1000 * distance:.0f} mm apart"
    )
    if distance < _MIN_DISTANCE or shared > _MAX_OVERLAP * smaller:
        raise WorldError(f"{message}: move one of them, or remove it")
    if shared > 0.0:
        _log.warning("%s: move them apart unless that is intended", message)


def _shared_area(first: np.ndarray, second: np.ndarray) -> float:
    """Area (m^2) shared by two convex quadrilaterals (4, 2)."""
    scale = 1000.0  # in single precision, millimetres are more accurate than metres
    area, _ = cv2.intersectConvexConvex((scale * first).astype(np.float32), (scale * second).astype(np.float32))
    return float(area) / scale**2
