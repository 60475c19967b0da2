"""Whether a Panda reaches every part of the workspace with the camera as it is mounted."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from embodied_active_learning.config import REAL, Config
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.ros.preflight.check_result import CheckResult, fine, missing, warning
from embodied_active_learning.simulation.panda_body import PandaBody
from embodied_active_learning.simulation.servo import HOME, JOINT_LIMITS, joint_velocities

GRID = (5, 5, 3)
"""Poses tried along x, y and theta: close to the base the elbow folds in the middle of an edge first."""
LEAST_MARGIN = 0.05
"""Radians from a joint's limit within which the arm would soon stop by itself."""
_SOLVED = 1e-5  # m, rad
_TRIES = 100
_LARGEST_STEP = 0.5  # rad
_PHYSICS_RATE = 240  # Hz; nothing is simulated here

Pose = Tuple[float, float, float]


class Reach(NamedTuple):
    """Which poses, x m, y m, theta rad, are out of reach; and of the others, where a joint is closest to its limit."""

    beyond: Tuple[Pose, ...] = ()
    margin: float = math.inf  # rad
    joint: int = 0  # 1 to 7
    tightest: Pose = (0.0, 0.0, 0.0)


def find_reach(config: Config, flange_to_end_effector: Optional[np.ndarray] = None) -> Reach:
    """Try a grid over workspace/ at camera/distance, by the kinematics of the simulated Panda.

    flange_to_end_effector (4, 4) is franka_states' F_T_EE; None takes the flange itself. A simulated arm has its camera
    at the flange.
    """
    mount = CameraMount((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), config.camera.distance)
    if config.arm.robot == REAL:
        mount = CameraMount.from_config(config)
    to_flange = np.eye(4) if flange_to_end_effector is None else np.linalg.inv(flange_to_end_effector)
    box = config.workspace.box()
    axes = (np.linspace(low, high, count) for low, high, count in zip(box.lower, box.upper, GRID))
    reach, beyond = Reach(), []
    body = PandaBody(_PHYSICS_RATE)
    try:
        for x, y, theta in itertools.product(*axes):
            pose = (float(x), float(y), float(theta))
            hand = np.eye(4)
            hand[:3, 3], hand[:3, :3] = mount.end_effector(CameraPose(pose, 0.0, (0.0, 0.0)))
            joints = solve(body, hand @ to_flange)
            if joints is None:
                beyond.append(pose)
                continue
            margins = np.minimum(joints - JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1] - joints)
            if margins.min() < reach.margin:
                reach = Reach((), float(margins.min()), int(margins.argmin()) + 1, pose)
    finally:
        body.close()
    return reach._replace(beyond=tuple(beyond))


def check_reach(reach: Reach) -> CheckResult:
    """What a person has to know of it."""
    why = "where the arm cannot go, a run is held up again and again"
    mend = (
        "make workspace/x, workspace/y or workspace/theta smaller there, change camera/distance, or see to "
        "franka/camera_position and franka/camera_rotation"
    )
    if reach.beyond:
        count = f"{len(reach.beyond)} of {math.prod(GRID)} poses"
        return missing("reach", f"the arm cannot hold the camera at {count}: {_shown(reach.beyond[0])}, say", why, mend)
    found = f"joint {reach.joint} comes closest to a limit: {reach.margin:.2f} rad from it, at {_shown(reach.tightest)}"
    if reach.margin < LEAST_MARGIN:
        return warning("reach", found, why, mend)
    return fine("reach", found)


def solve(body: PandaBody, target: np.ndarray) -> Optional[np.ndarray]:
    """Joint positions (7,) that bring the flange to a pose (4, 4), or None when there are none within the limits."""
    joints = HOME.copy()
    for _ in range(_TRIES):
        body.place(joints)
        position, orientation, _ = body.optical_frame()
        twist = np.concatenate([target[:3, 3] - position, _turn(np.array(orientation), target[:3, :3])])
        if np.abs(twist).max() < _SOLVED:
            inside = (JOINT_LIMITS[:, 0] <= joints) & (joints <= JOINT_LIMITS[:, 1])
            return joints if inside.all() else None
        step = joint_velocities(body.jacobian(joints), twist, joints)
        joints += step * min(1.0, _LARGEST_STEP / np.abs(step).max())
    return None


def _turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(3,) a rotation vector, rad for small ones, from one orientation (3, 3) to another."""
    return 0.5 * np.cross(start.T, end.T).sum(axis=0)


def _shown(pose: Pose) -> str:
    return f"x {pose[0]:.3f} m, y {pose[1]:.3f} m, theta {pose[2]:.2f} rad"
