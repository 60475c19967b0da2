"""Check that the arm reaches all of the workspace with the camera as it is mounted."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from embodied_active_learning.config import REAL_ROBOTS, Config
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok, warning
from embodied_active_learning.simulation.panda_body import PandaBody
from embodied_active_learning.simulation.servo import HOME, JOINT_LIMITS, joint_velocities

GRID = (5, 5, 3)
"""Number of poses tried along x, y and theta. Close to the base, limits are reached in the middle of an edge first."""
MIN_MARGIN = 0.05
"""Distance of a joint from its limit [rad] below which the arm may stop during a run."""
_FR3_LIMITS = np.array(
    [
        (-2.7437, 2.7437),
        (-1.7837, 1.7837),
        (-2.9007, 2.9007),
        (-3.0421, -0.1518),
        (-2.8065, 2.8065),
        (0.5445, 4.5169),
        (-3.0159, 3.0159),
    ]
)
"""(7, 2): lower and upper limit of each joint [rad], from the manufacturer; the kinematics are the Panda's."""
_TOLERANCE = 1e-5  # m, rad
_MAX_ITERATIONS = 100
_MAX_JOINT_STEP = 0.5  # rad
_PHYSICS_RATE = 240  # Hz; required by PandaBody, no physics is simulated

Pose = Tuple[float, float, float]
"""x [m], y [m], theta [rad]."""


class Reach(NamedTuple):
    """Unreachable poses, and the smallest distance of a joint from its limit at the others."""

    unreachable: Tuple[Pose, ...] = ()
    margin: float = math.inf  # rad
    joint: int = 0  # 1 to 7
    pose: Pose = (0.0, 0.0, 0.0)  # where that joint is closest to its limit


def find_reach(config: Config, flange_to_end_effector: Optional[np.ndarray] = None) -> Reach:
    """Solve the inverse kinematics of the arm on a grid over the workspace at camera/distance.

    Args:
        config: a simulated arm has its camera at the flange, a real one as mounted.
        flange_to_end_effector: (4, 4), F_T_EE of franka_states; None for the identity.
    """
    mount = CameraMount((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), config.camera.distance)
    limits = JOINT_LIMITS[:, :2]
    if config.arm.robot in REAL_ROBOTS:
        mount = CameraMount.from_config(config)
        limits = _FR3_LIMITS if config.franka.arm_id == "fr3" else limits
    to_flange = np.eye(4) if flange_to_end_effector is None else np.linalg.inv(flange_to_end_effector)
    box = config.workspace.box()
    axes = (np.linspace(low, high, count) for low, high, count in zip(box.lower, box.upper, GRID))
    reach, unreachable = Reach(), []
    body = PandaBody(_PHYSICS_RATE)
    try:
        for x, y, theta in itertools.product(*axes):
            pose = (float(x), float(y), float(theta))
            end_effector = np.eye(4)
            end_effector[:3, 3], end_effector[:3, :3] = mount.end_effector(CameraPose(pose, 0.0, (0.0, 0.0)))
            joints = solve(body, end_effector @ to_flange, limits)
            if joints is None:
                unreachable.append(pose)
                continue
            margins = np.minimum(joints - limits[:, 0], limits[:, 1] - joints)
            if margins.min() < reach.margin:
                reach = Reach((), float(margins.min()), int(margins.argmin()) + 1, pose)
    finally:
        body.close()
    return reach._replace(unreachable=tuple(unreachable))


def check_reach(reach: Reach) -> CheckResult:
    """Check that all poses are reachable with a margin to the joint limits."""
    reason = "the arm stops at a joint limit again and again during a run"
    remedy = (
        "reduce workspace/x, workspace/y or workspace/theta, change camera/distance, or correct franka/camera_position "
        "and franka/camera_rotation"
    )
    if reach.unreachable:
        count = f"{len(reach.unreachable)} of {math.prod(GRID)}"
        message = f"{count} poses of the camera cannot be reached, for example {_format(reach.unreachable[0])}"
        return error("reach", message, reason, remedy)
    message = f"joint {reach.joint} is closest to a limit: {reach.margin:.2f} rad at {_format(reach.pose)}"
    if reach.margin < MIN_MARGIN:
        return warning("reach", message, reason, remedy)
    return ok("reach", message)


def solve(body: PandaBody, target: np.ndarray, limits: np.ndarray) -> Optional[np.ndarray]:
    """Return joint positions (7,) that bring the flange to a pose (4, 4); None without a solution within limits (7, 2).

    All in m, rad.
    """
    joints = HOME.copy()
    for _ in range(_MAX_ITERATIONS):
        body.place(joints)
        position, orientation, _ = body.optical_frame()
        twist = np.concatenate([target[:3, 3] - position, _rotation_error(np.array(orientation), target[:3, :3])])
        if np.abs(twist).max() < _TOLERANCE:
            inside = (limits[:, 0] <= joints) & (joints <= limits[:, 1])
            return joints if inside.all() else None
        step = joint_velocities(body.jacobian(joints), twist, joints)
        joints += step * min(1.0, _MAX_JOINT_STEP / np.abs(step).max())
    return None


def _rotation_error(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) from one orientation (3, 3) to another; in rad for small angles."""
    return 0.5 * np.cross(start.T, end.T).sum(axis=0)


def _format(pose: Pose) -> str:
    return f"x {pose[0]:.3f} m, y {pose[1]:.3f} m, theta {pose[2]:.2f} rad"
