"""Servo control: planar velocities of the camera to joint velocities, with height and tilt held.

This runs in every physics step. Short vectors are plain floats, because the overhead of numpy exceeds such arithmetic.
"""

from __future__ import annotations

from typing import Optional, Sequence, Tuple

import numpy as np

from embodied_active_learning.simulation.panda import joint_limits, physics_urdf
from embodied_active_learning.simulation.panda_body import PandaBody, Rotation

HOME = np.array([0.0, -0.3, 0.0, -2.4, 0.0, 2.1, 0.0])
JOINT_LIMITS = np.array(joint_limits(physics_urdf()))  # (7, 3): lower, upper rad, speed rad/s

_LIMITS = JOINT_LIMITS.tolist()
_HOLD_GAIN = 20.0  # 1/s, on height and tilt
_POSTURE_GAIN = 1.0  # 1/s, towards home in the null space
_SOLVED = 1e-6  # m, rad; PyBullet keeps link frames in single precision
_DAMPING = 1e-3  # singular values below this lose speed, so that joint velocities stay bounded


def planar_pose(position: Sequence[float], orientation: Rotation) -> np.ndarray:
    """Return (x, y, theta) [m, m, rad] of a position (3,) [m] and orientation (3, 3) of the optical frame."""
    # Not math.atan2, whose last digit differs: results for one seed must not change.
    return np.array([position[0], position[1], np.arctan2(orientation[1][0], orientation[0][0])])


def tilt(orientation: Rotation) -> Tuple[float, float]:
    """Return the small rotation about x and y [rad] that turns the optical axis of (3, 3) straight down."""
    return -orientation[1][2], orientation[0][2]


def held_twist(
    velocity: Sequence[float], position: Sequence[float], orientation: Rotation, height: float
) -> np.ndarray:
    """Return the twist (6,) of the optical frame for a planar velocity (3,), correcting height [m] and tilt."""
    about_x, about_y = tilt(orientation)
    climb = _HOLD_GAIN * (height - position[2])
    return np.array([velocity[0], velocity[1], climb, _HOLD_GAIN * about_x, _HOLD_GAIN * about_y, velocity[2]])


def joint_velocities(jacobian: np.ndarray, twist: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return joint velocities (7,) for a twist (6,); the redundant degree of freedom moves the joints (7,) home.

    By singular value decomposition instead of normal equations: OpenBLAS solves even six equations in several threads,
    which on a busy machine makes a move up to four times slower.
    """
    left, singular, right = np.linalg.svd(jacobian)
    inverse = singular / (singular**2 + _DAMPING**2)
    null = right[-1]
    return right[:-1].T @ (inverse * (left.T @ twist)) + null * (null @ (_POSTURE_GAIN * (HOME - joints)))


def scale_within_limits(velocities: np.ndarray, joints: np.ndarray, period: float) -> float:
    """Return the largest factor, 0 to 1, for joint velocities (7,) that keeps speeds and next positions legal."""
    scale = 1.0
    for velocity, joint, (lower, upper, speed) in zip(velocities.tolist(), joints.tolist(), _LIMITS):
        room = (upper - joint if velocity > 0.0 else joint - lower) / period
        allowed = min(speed, max(room, 0.0))
        if abs(velocity) > allowed:
            scale = min(scale, allowed / abs(velocity))
    return scale


def solve_joints(body: PandaBody, pose: np.ndarray, height: float) -> Optional[np.ndarray]:
    """Return joint positions (7,) for a pose (x, y, theta) at a height [m], or None if the arm cannot reach it.

    Moves the body there and leaves it there.
    """
    joints = HOME.copy()
    for _ in range(200):
        body.place(joints)
        position, orientation, _ = body.optical_frame()
        error = pose - planar_pose(position, orientation)
        twist = held_twist(_HOLD_GAIN * error, position, orientation, height) / _HOLD_GAIN
        if np.abs(twist).max() < _SOLVED:
            inside = (JOINT_LIMITS[:, 0] <= joints) & (joints <= JOINT_LIMITS[:, 1])
            return joints if inside.all() else None
        step = joint_velocities(body.jacobian(joints), twist, joints)
        joints += step * min(1.0, 0.5 / np.abs(step).max())
    return None
