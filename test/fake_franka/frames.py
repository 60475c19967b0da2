"""Poses at the end of the arm as (4, 4) matrices, and the load. Flange and end effector are the same frame."""

from __future__ import annotations

from typing import Any, List, Sequence, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from scipy.spatial.transform import Rotation

from embodied_active_learning.config import Config
from embodied_active_learning.geometry import optical_rotation

ARM = "panda"


class Frames:
    """The camera, fixed to the end effector, and the load."""

    def __init__(self, config: Config) -> None:
        """config: of the camera mount and the table."""
        self.load: Tuple[float, List[float], List[float]] = (0.0, [0.0] * 3, [0.0] * 9)  # kg, m, kg m^2
        self._config = config
        self._mount = np.eye(4)
        self._mount[:3, :3] = Rotation.from_euler("xyz", config.franka.camera_rotation).as_matrix()
        self._mount[:3, 3] = config.franka.camera_position

    def camera(self, position: Sequence[float], orientation: Sequence[float]) -> np.ndarray:
        """Return the camera for an end effector at a position (3,) with a quaternion (4,)."""
        return matrix_of(position, orientation) @ self._mount

    def ee_with_camera_at(self, x: float, y: float, theta: float) -> np.ndarray:
        """Return the end effector for a camera at a planar pose [m, m, rad] and its height, looking straight down."""
        camera = np.eye(4)
        camera[:3, :3] = optical_rotation(theta)
        camera[:3, 3] = x, y, self._camera_height
        return camera @ np.linalg.inv(self._mount)

    def outside(self, position: Sequence[float], orientation: Sequence[float]) -> Tuple[float, float]:
        """Return how far the camera is outside the workspace in x or y, and off its height, m."""
        x, y, z = self.camera(position, orientation)[:3, 3].tolist()
        (x0, x1), (y0, y1) = self._config.workspace.x, self._config.workspace.y
        return max(x0 - x, x - x1, y0 - y, y - y1, 0.0), abs(z - self._camera_height)

    @property
    def _camera_height(self) -> float:
        return self._config.franka.table_height + self._config.camera.distance


def matrix_of(position: Sequence[float], orientation: Sequence[float]) -> np.ndarray:
    """Return the (4, 4) matrix of a position (3,) and a quaternion (4,)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(orientation).as_matrix()
    matrix[:3, 3] = position
    return matrix


def pose_of(matrix: np.ndarray) -> Tuple[Any, Any]:
    """Return position (3,) and quaternion (4,) of a (4, 4) matrix."""
    return tuple(matrix[:3, 3].tolist()), tuple(Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist())


def transform_message(stamp: rospy.Time, parent: str, child: str, matrix: np.ndarray) -> TransformStamped:
    """Return the transform message of a frame of the arm in another, from a (4, 4) matrix."""
    position, orientation = pose_of(matrix)
    message = TransformStamped(child_frame_id=f"{ARM}_{child}")
    message.header.stamp, message.header.frame_id = stamp, f"{ARM}_{parent}"
    message.transform.translation, message.transform.rotation = Vector3(*position), Quaternion(*orientation)
    return message
