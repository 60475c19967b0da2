"""Planar geometry of camera and table: pixels to points, and poses seen from another pose."""

from __future__ import annotations

import math
from typing import Sequence, Tuple

import numpy as np

from embodied_active_learning.config import CameraConfig

Location = Tuple[str, float, float]
"""Name or kind of an object, x [m], y [m]: where it really stands."""
FIELD_TOLERANCE = 0.03
"""Part by which a camera's calibrated field of view may differ from camera/field_of_view before that is told."""


def rotation_matrix(x: float, y: float, z: float, w: float) -> np.ndarray:
    """(3, 3) of a unit quaternion."""
    vector, cross = np.array([x, y, z]), np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - vector @ vector) * np.eye(3) + 2.0 * np.outer(vector, vector) + 2.0 * w * cross


def fixed_axes_rotation(rpy: Sequence[float]) -> np.ndarray:
    """Roll, pitch, yaw (rad) about the fixed axes -> (3, 3) matrix Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def optical_rotation(theta: float) -> np.ndarray:
    """(3, 3) orientation of the optical frame in the base frame, tool pointing down: Rz(theta) Rx(pi)."""
    cosine, sine = math.cos(theta), math.sin(theta)
    return np.array([[cosine, sine, 0.0], [sine, -cosine, 0.0], [0.0, 0.0, -1.0]])


def wrap(angles: np.ndarray) -> np.ndarray:
    """Angles in [-pi, pi), rad."""
    wrapped = (np.asarray(angles) + math.pi) % (2.0 * math.pi) - math.pi
    return np.where(wrapped < math.pi, wrapped, -math.pi)  # the remainder of a tiny negative number is the whole circle


def intrinsics(width: int, height: int, field_of_view: float) -> np.ndarray:
    """(3, 3) K of a camera with square pixels whose principal point is the middle of the image; degrees, vertical."""
    focal = height / (2.0 * math.tan(math.radians(field_of_view) / 2.0))
    return np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])


def field_of_view(matrix: np.ndarray, height: int) -> float:
    """Vertical field of view [deg] of a camera with K (3, 3) whose images are so many pixels high."""
    return math.degrees(2.0 * math.atan(height / (2.0 * matrix[1, 1])))


def metres_per_pixel(camera: CameraConfig) -> float:
    """Size of an image pixel on the table."""
    return 2.0 * camera.distance * math.tan(math.radians(camera.field_of_view) / 2.0) / camera.height


def table_points(states: np.ndarray, rows: np.ndarray, columns: np.ndarray, camera: CameraConfig) -> np.ndarray:
    """Points of the table (..., 2) [m] that pixels at (row, column) show from camera states (..., 3) [m, m, rad].

    The optical frame is Rz(theta) Rx(pi): image right is x turned by theta, image down is -y turned by theta.
    """
    pixel = metres_per_pixel(camera)
    right = pixel * (np.asarray(columns) - (camera.width - 1) / 2.0)
    down = pixel * (np.asarray(rows) - (camera.height - 1) / 2.0)
    cosine, sine = np.cos(states[..., 2]), np.sin(states[..., 2])
    x = states[..., 0] + cosine * right + sine * down
    y = states[..., 1] + sine * right - cosine * down
    return np.stack((x, y), axis=-1)


def pixels_of(states: np.ndarray, point: np.ndarray, camera: CameraConfig) -> Tuple[np.ndarray, np.ndarray]:
    """Row and column (...) at which camera states (..., 3) show a point of the table, (2,) or (..., 2) [m].

    Fractions of a pixel count, and so do pixels outside of the image: the inverse of table_points.
    """
    dx, dy = np.asarray(point)[..., 0] - states[..., 0], np.asarray(point)[..., 1] - states[..., 1]
    cosine, sine = np.cos(states[..., 2]), np.sin(states[..., 2])
    pixel = metres_per_pixel(camera)
    right, down = cosine * dx + sine * dy, sine * dx - cosine * dy
    return down / pixel + (camera.height - 1) / 2.0, right / pixel + (camera.width - 1) / 2.0


def move(poses: np.ndarray, origin: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Poses (..., 3) as they are after the planar motion that takes pose origin to pose goal, (..., 3) each.

    With a stored view's state as origin and a new view's state as goal it takes the object of the stored view to where
    it must be if it looks the same from the new one.
    """
    turn = goal[..., 2] - origin[..., 2]
    cosine, sine = np.cos(turn), np.sin(turn)
    dx, dy = poses[..., 0] - origin[..., 0], poses[..., 1] - origin[..., 1]
    x = goal[..., 0] + cosine * dx - sine * dy
    y = goal[..., 1] + sine * dx + cosine * dy
    return np.stack((x, y, wrap(poses[..., 2] + turn)), axis=-1)


def pose_distance(one: np.ndarray, other: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Distance [m] and turn [rad], the short way, between poses (..., 3)."""
    change = np.asarray(one) - other
    return np.hypot(change[..., 0], change[..., 1]), np.abs(wrap(change[..., 2]))
