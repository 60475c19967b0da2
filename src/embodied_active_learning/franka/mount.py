"""Conversion between end effector poses and camera poses for a camera in a fixed mount."""

from __future__ import annotations

import math
from typing import NamedTuple, Sequence, Tuple

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ObservationError
from embodied_active_learning.geometry import fixed_axes_rotation, optical_rotation

_ROTATION_TOLERANCE = 1e-2
"""Largest deviation from an orthonormal rotation: franka_states is rounded."""


class CameraPose(NamedTuple):
    """A pose of the camera: its planar part, and its deviation in height and tilt.

    The optical frame is exp(tilt) Rz(theta) Rx(pi), with a tilt about the base frame's x and y.
    """

    planar: Tuple[float, ...]  # x [m], y [m], theta [rad]
    height: float  # [m] above the plane of motion
    tilt: Tuple[float, ...]  # [rad] about x and about y

    @property
    def tilt_angle(self) -> float:
        """Angle between the optical axis and straight down, rad."""
        return math.hypot(*self.tilt)


class CameraMount:
    """A camera fixed to the end effector (EE), and the plane over the table in which it moves."""

    def __init__(self, position: Sequence[float], rotation: Sequence[float], height: float) -> None:
        """Position (3,) m of the optical frame in EE; its rotation: roll, pitch, yaw, rad; the plane's height, m."""
        self._position: np.ndarray = np.array(position, dtype=np.float64)
        self._rotation = fixed_axes_rotation(rotation)
        self._height = height

    @classmethod
    def from_config(cls, config: Config) -> CameraMount:
        """Return the mount given by franka/, with the plane camera/distance above the table."""
        franka = config.franka
        return cls(franka.camera_position, franka.camera_rotation, franka.table_height + config.camera.distance)

    @property
    def position(self) -> np.ndarray:
        """(3,) m of the optical frame in EE."""
        return self._position

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) of the optical frame in EE."""
        return self._rotation

    def camera_pose(self, end_effector: Sequence[float]) -> CameraPose:
        """Return the camera's pose, theta in [-pi, pi], for O_T_EE, (16,) column by column, m.

        Raises ObservationError for an invalid pose, and for a camera that looks up.
        """
        transform: np.ndarray = np.asarray(end_effector, dtype=np.float64).reshape(4, 4).T
        rotation = transform[:3, :3]
        if not np.isfinite(transform).all():
            raise ObservationError("invalid robot pose: values are not finite")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROTATION_TOLERANCE):
            raise ObservationError("invalid robot pose: rotation matrix is not orthonormal")
        optical = rotation @ self._rotation
        x, y, z = transform[:3, 3] + rotation @ self._position
        axis = optical[:, 2]
        if axis[2] >= 0.0:
            raise ObservationError(
                "the camera looks up instead of down: check franka/camera_rotation, or guide the hand by hand"
            )
        tilt = _tilt_of(axis)
        upright = _rotation_by(tilt).T @ optical
        theta = math.atan2(upright[1, 0], upright[0, 0])
        return CameraPose((float(x), float(y), theta), float(z) - self._height, tilt)

    def end_effector(self, pose: CameraPose) -> Tuple[np.ndarray, np.ndarray]:
        """Return position (3,) m and rotation (3, 3) of EE in the base frame for a camera pose."""
        x, y, theta = pose.planar
        rotation = _rotation_by(pose.tilt) @ optical_rotation(theta) @ self._rotation.T
        return np.array([x, y, self._height + pose.height]) - rotation @ self._position, rotation


def _tilt_of(axis: np.ndarray) -> Tuple[float, float]:
    """Return the rotation about x and y [rad] from straight down to a unit axis (3,) that points down."""
    sine = math.hypot(axis[0], axis[1])
    factor = math.atan2(sine, -axis[2]) / sine if sine > 0.0 else 1.0
    return factor * float(axis[1]), -factor * float(axis[0])


def _rotation_by(tilt: Sequence[float]) -> np.ndarray:
    """Return the rotation (3, 3) about the vector tilt [rad] in the plane of x and y."""
    angle = math.hypot(*tilt)
    if angle == 0.0:
        return np.eye(3)
    x, y = tilt[0] / angle, tilt[1] / angle
    cross = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
