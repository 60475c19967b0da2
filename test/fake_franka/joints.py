"""Inverse kinematics: joint positions for the pose of the hand's model."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from embodied_active_learning.simulation import servo
from embodied_active_learning.simulation.panda_body import PandaBody

_PHYSICS_RATE = 240  # unused: the body is placed, never driven


class JointTracker:
    """Follows the flange with the joints of the simulated Panda, with two Newton steps per pose."""

    def __init__(self, flange: np.ndarray) -> None:
        """Solve for a flange pose (4, 4) that points straight down. Raises ValueError out of the arm's reach."""
        self._body = PandaBody(_PHYSICS_RATE)
        planar = np.array([flange[0, 3], flange[1, 3], math.atan2(flange[1, 0], flange[0, 0])])
        joints = servo.solve_joints(self._body, planar, flange[2, 3])
        if joints is None:
            raise ValueError(f"the arm cannot reach its start, x {planar[0]:g} m, y {planar[1]:g} m")
        self._joints = joints

    def follow(self, flange: np.ndarray, velocity: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return joint positions (7,) [rad] and velocities (7,) [rad/s] for a flange pose (4, 4) and twist (6,)."""
        limits = servo.JOINT_LIMITS
        for _ in range(2):
            self._body.place(self._joints)
            position, orientation, _ = self._body.optical_frame()
            turn = Rotation.from_matrix(flange[:3, :3] @ np.array(orientation).T).as_rotvec()
            jacobian = self._body.jacobian(self._joints)
            step = servo.joint_velocities(jacobian, np.concatenate([flange[:3, 3] - position, turn]), self._joints)
            self._joints = np.clip(self._joints + step, limits[:, 0], limits[:, 1])
        # Without the posture term, so that the joints of an arm at rest have zero velocity.
        return self._joints, np.linalg.pinv(jacobian) @ velocity
