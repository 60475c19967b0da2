"""Check that the camera is close enough to its plane and workspace before a motion starts."""

from __future__ import annotations

import numpy as np

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmNotReadyError
from embodied_active_learning.franka.mount import CameraPose
from embodied_active_learning.workspace import STATE_NAMES

_UNITS = ("m", "m", "rad")


def require_startable(pose: CameraPose, config: Config) -> None:
    """Raise ArmNotReadyError if the camera is too far from its height, from straight down or from the workspace."""
    franka = config.franka
    if abs(pose.height) > franka.max_height_error:
        side = "above" if pose.height > 0.0 else "below"
        raise ArmNotReadyError(
            f"the camera is {abs(pose.height):.3f} m {side} its height over the table (franka/max_height_error): "
            "guide it there by hand, or check franka/table_height, camera/distance and the camera's mount"
        )
    if pose.tilt_angle > franka.max_tilt:
        raise ArmNotReadyError(
            f"the camera is tilted {pose.tilt_angle:.2f} rad from straight down (franka/max_tilt): guide it there by "
            "hand, or check franka/camera_rotation"
        )
    limits = (franka.max_outside, franka.max_outside, franka.max_turn_outside)
    for name, unit, outside, limit in zip(STATE_NAMES, _UNITS, distances_outside(pose, config), limits):
        if outside > limit:
            raise ArmNotReadyError(
                f"the camera is {outside:.3f} {unit} outside workspace/{name} (franka/max_outside, "
                "franka/max_turn_outside): guide it there by hand, or check the camera's mount"
            )


def distances_outside(pose: CameraPose, config: Config) -> np.ndarray:
    """Return how far the camera is outside the workspace along each axis, (3,) [m, m, rad]; negative inside."""
    workspace = config.workspace.box()
    return np.maximum(np.subtract(workspace.lower, pose.planar), np.subtract(pose.planar, workspace.upper))
