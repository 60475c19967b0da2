"""Planar geometry of camera and table: pixels, points on the table, and relative poses."""

from __future__ import annotations

import math
from typing import Sequence, Tuple

import numpy as np

from embodied_active_learning.config import CameraConfig


def rotation_matrix(x: float, y: float, z: float, w: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a unit quaternion."""
    vector, cross = np.array([x, y, z]), np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - vector @ vector) * np.eye(3) + 2.0 * np.outer(vector, vector) + 2.0 * w * cross


def fixed_axes_rotation(rpy: Sequence[float]) -> np.ndarray:
    """Return Rz(yaw) Ry(pitch) Rx(roll), (3, 3), of roll, pitch, yaw [rad] about the fixed axes."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def optical_rotation(theta: float) -> np.ndarray:
    """Return the orientation of the optical frame in the base frame, pointing down: Rz(theta) Rx(pi), (3, 3)."""
    cosine, sine = math.cos(theta), math.sin(theta)
    return np.array([[cosine, sine, 0.0], [sine, -cosine, 0.0], [0.0, 0.0, -1.0]])


def wrap(angles: np.ndarray) -> np.ndarray:
    """Wrap angles to [-pi, pi) [rad]."""
    wrapped = (np.asarray(angles) + math.pi) % (2.0 * math.pi) - math.pi
    return np.where(wrapped < math.pi, wrapped, -math.pi)  # the remainder of a tiny negative number rounds to 2 pi


def intrinsics(width: int, height: int, field_of_view: float) -> np.ndarray:
    """Return a camera matrix K (3, 3) of square pixels and central principal point. field_of_view: vertical, deg."""
    focal = height / (2.0 * math.tan(math.radians(field_of_view) / 2.0))
    return np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])


def field_of_view(matrix: np.ndarray, height: int) -> float:
    """Return the vertical field of view [deg] of a camera matrix K (3, 3). height: of the image [px]."""
    return math.degrees(2.0 * math.atan(height / (2.0 * matrix[1, 1])))


def metres_per_pixel(camera: CameraConfig) -> float:
    """Return the size of a pixel on the table [m]."""
    return 2.0 * camera.distance * math.tan(math.radians(camera.field_of_view) / 2.0) / camera.height


def table_points(states: np.ndarray, rows: np.ndarray, columns: np.ndarray, camera: CameraConfig) -> np.ndarray:
    """Return the points on the table that pixels show.

    The optical frame is Rz(theta) Rx(pi): image right is x turned by theta, image down is -y turned by theta.

    Args:
        states: (..., 3) camera states [m, m, rad].
        rows: (...) rows of the pixels.
        columns: (...) columns of the pixels.
        camera: The camera.

    Returns:
        (..., 2) [m].
    """
    pixel = metres_per_pixel(camera)
    right = pixel * (np.asarray(columns) - (camera.width - 1) / 2.0)
    down = pixel * (np.asarray(rows) - (camera.height - 1) / 2.0)
    cosine, sine = np.cos(states[..., 2]), np.sin(states[..., 2])
    x = states[..., 0] + cosine * right + sine * down
    y = states[..., 1] + sine * right - cosine * down
    return np.stack((x, y), axis=-1)


def pixels_of(states: np.ndarray, point: np.ndarray, camera: CameraConfig) -> Tuple[np.ndarray, np.ndarray]:
    """Return row and column (...) of a point on the table: the inverse of table_points.

    They may be fractional, and outside the image.

    Args:
        states: (..., 3) camera states [m, m, rad].
        point: (2,) or (..., 2) [m].
        camera: The camera.
    """
    dx, dy = np.asarray(point)[..., 0] - states[..., 0], np.asarray(point)[..., 1] - states[..., 1]
    cosine, sine = np.cos(states[..., 2]), np.sin(states[..., 2])
    pixel = metres_per_pixel(camera)
    right, down = cosine * dx + sine * dy, sine * dx - cosine * dy
    return down / pixel + (camera.height - 1) / 2.0, right / pixel + (camera.width - 1) / 2.0


def transform_poses(poses: np.ndarray, origin: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Apply the planar motion that moves one pose to another.

    With the camera state of a stored view as origin and that of a new view as goal, it moves the object of the stored
    view to the pose from which it looks the same in the new view.

    Args:
        poses: (..., 3) poses to move [m, m, rad].
        origin: (..., 3) pose before the motion.
        goal: (..., 3) pose after the motion.

    Returns:
        (..., 3) moved poses.
    """
    turn = goal[..., 2] - origin[..., 2]
    cosine, sine = np.cos(turn), np.sin(turn)
    dx, dy = poses[..., 0] - origin[..., 0], poses[..., 1] - origin[..., 1]
    x = goal[..., 0] + cosine * dx - sine * dy
    y = goal[..., 1] + sine * dx + cosine * dy
    return np.stack((x, y, wrap(poses[..., 2] + turn)), axis=-1)


def pose_distance(one: np.ndarray, other: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return distance [m] and smallest turn [rad] between poses (..., 3)."""
    change = np.asarray(one) - other
    return np.hypot(change[..., 0], change[..., 1]), np.abs(wrap(change[..., 2]))


def quaternion(rotation: np.ndarray) -> Tuple[float, float, float, float]:
    """Return the unit quaternion x, y, z, w of a rotation (3, 3)."""
    # Start with the largest of the four to avoid division by a small number.
    trace = rotation.trace()
    squares = np.array([*(2.0 * rotation.diagonal() - trace), trace])
    largest = int(squares.argmax())
    differences = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    if largest == 3:
        values = np.array([*differences, 1.0 + trace])
    else:
        values = np.array([*(rotation[largest] + rotation[:, largest]), differences[largest]])
        values[largest] = 1.0 + squares[largest]
    x, y, z, w = (values / np.linalg.norm(values)).tolist()
    return x, y, z, w


def to_object_frame(states: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return positions (N, 2) [m] of states (N, 3) or points (N, 2) in the coordinates of an object at a pose (3,)."""
    dx, dy = (states[:, :2] - pose[:2]).T
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    return np.stack([cosine * dx + sine * dy, cosine * dy - sine * dx], axis=-1)


def to_base_frame(points: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return points (K, 2) [m] of an object in the base frame, (P, K, 2) float32, for each of its poses (P, 3)."""
    cosine, sine = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x, y = points.T
    return np.stack([poses[:, :1] + cosine * x - sine * y, poses[:, 1:2] + sine * x + cosine * y], -1).astype(
        np.float32
    )
