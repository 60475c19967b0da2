"""Checks of a Panda under franka_ros, and of where an arm is."""

from __future__ import annotations

import math
from typing import List, Mapping, Sequence

import numpy as np

from embodied_active_learning.config import REAL, Config
from embodied_active_learning.franka.readiness import CONTROLLER, Controller, RobotMode
from embodied_active_learning.ros.preflight.check_result import CheckResult, fine, missing, warning
from embodied_active_learning.workspace import STATE_NAMES

STATE_CONTROLLER = "franka_state_controller"
_READY = ("idle", "move")
LEAST_SUCCESS = 0.95
"""Part of the control commands that should reach the robot in time."""
FRAME_TOLERANCE, TURN_TOLERANCE = 0.002, 0.01
"""Metres and rad by which tf and the arm's state may differ while the arm stands still."""
_OUTSIDE = 1e-3  # m, rad: an arm at rest at a border is not outside
_MODE_MENDS = {
    "user stopped": "release the user stop, then rosservice call /arm/recover",
    "reflex": "see what the arm has touched, then rosservice call /arm/recover",
    "guiding": "let go of the hand's buttons",
}


def check_robot_state(mode: int, errors: Sequence[str], success_rate: float) -> List[CheckResult]:
    """Mode, names of current errors and control_command_success_rate of franka_states."""
    known = {item.value: item.name.lower().replace("_", " ") for item in RobotMode}
    name = known.get(mode, f"unknown ({mode})")
    if errors or name not in _READY:
        mend = _MODE_MENDS.get(name, "rosservice call /arm/recover; look at Desk")
        found = f"{name}, errors: {', '.join(errors) or 'none'}"
        findings = [missing("robot mode", found, "the robot takes no motion in this mode", mend)]
    else:
        findings = [fine("robot mode", f"{name}, no errors")]
    # While no controller moves the arm there are no commands, and the rate is 0.
    found = f"{success_rate:.0%} of the commands arrive in time"
    if name == "move" and success_rate < LEAST_SUCCESS:
        findings.append(
            warning(
                "robot network",
                found,
                "lost commands end in communication_constraints_violation, in the middle of a run",
                "a realtime kernel, a network card for the robot alone, no power saving, less load on this computer",
            )
        )
    elif name == "move":
        findings.append(fine("robot network", found))
    return findings


def check_controllers(controllers: Mapping[str, Controller], set_points_from: Sequence[str]) -> List[CheckResult]:
    """What controller_manager has, by name, and the nodes that publish set-points to our controller.

    The state controller and ours have to run, and nobody else may move the arm.
    """
    about, why = "controllers", "franka_arm reads the robot's state by the one, and moves the arm by the other"
    findings = []
    state = controllers[STATE_CONTROLLER].state if STATE_CONTROLLER in controllers else "not loaded"
    if state != "running":
        mend = "franka_control.launch starts it; look at its log"
        findings.append(missing(about, f"{STATE_CONTROLLER} is {state}", why, mend))
    others = [
        name for name, item in controllers.items() if item.moves and item.state == "running" and name != CONTROLLER
    ]
    if others:
        findings.append(
            missing(
                about,
                f"{', '.join(others)} drives the arm",
                "two controllers cannot move the same joints, and franka_arm stops nobody else's",
                f"rosrun controller_manager controller_manager stop {' '.join(others)}",
            )
        )
    state = controllers[CONTROLLER].state if CONTROLLER in controllers else "not loaded"
    if state != "running" and not others:
        mend = "look at franka_arm's log, which loads and starts it; rosservice call /arm/recover"
        findings.append(missing(about, f"{CONTROLLER} is {state}", why, mend))
    if len(set_points_from) > 1:
        findings.append(
            missing(
                about,
                f"{', '.join(set_points_from)} all publish set-points",
                "the arm is drawn to and fro between them",
                "end all but franka_arm; the interactive marker of franka_example_controllers is one of them",
            )
        )
    return findings or [fine(about, f"{STATE_CONTROLLER} and {CONTROLLER} run, and nobody else moves the arm")]


def check_place(position: Sequence[float], optical_axis: Sequence[float], theta: float, config: Config) -> CheckResult:
    """The camera's position (3,) m, optical axis (3,) and yaw, rad, in the base frame: can motion begin there."""
    real = config.franka
    height = config.camera.distance + (real.table_height if config.arm.robot == REAL else 0.0)
    rise, tilt = position[2] - height, math.acos(max(-1.0, min(1.0, -optical_axis[2])))
    state = (position[0], position[1], theta)
    found = (
        f"x {state[0]:.3f} m, y {state[1]:.3f} m, theta {state[2]:.2f} rad, {rise * 1e3:+.0f} mm from its height, "
        f"tilted by {math.degrees(tilt):.1f} degrees"
    )
    if abs(rise) > real.max_height_error or tilt > real.max_tilt:
        return missing(
            "camera's place",
            found,
            f"motion begins only within {real.max_height_error * 1e3:.0f} mm and {math.degrees(real.max_tilt):.1f} "
            "degrees (franka/max_height_error, franka/max_tilt)",
            "guide the arm by hand to where the camera looks straight down from camera/distance above the table; see "
            "whether franka/table_height, franka/camera_position and franka/camera_rotation are right",
        )
    box = config.workspace.box()
    beyond = np.maximum(np.subtract(box.lower, state), np.subtract(state, box.upper))
    outside = [f"workspace/{name}" for name, far in zip(STATE_NAMES, beyond) if far > _OUTSIDE]
    if np.any(beyond > (real.max_outside, real.max_outside, real.max_turn_outside)):
        return missing(
            "camera's place",
            f"{found}: far outside of {', '.join(outside)}",
            "motion does not begin there (franka/max_outside, franka/max_turn_outside)",
            "guide the arm by hand into the workspace; or see to the camera's mount",
        )
    if outside:
        return warning(
            "camera's place",
            f"{found}: outside of {', '.join(outside)}",
            "the arm first goes back inside, straight",
            "see that nothing is in its way; or guide it into the workspace by hand",
        )
    return fine("camera's place", found)


def check_frames(tf_state: Sequence[float], arm_state: Sequence[float]) -> CheckResult:
    """Planar pose (3,) m, m, rad of the camera by tf, against the arm's own."""
    change = np.subtract(tf_state, arm_state)
    distance, turn = math.hypot(change[0], change[1]), abs(math.remainder(change[2], 2.0 * math.pi))
    found = f"tf and arm/state differ by {distance * 1e3:.1f} mm and {turn:.3f} rad"
    if distance > FRAME_TOLERANCE or turn > TURN_TOLERANCE:
        return missing(
            "frames",
            found,
            "one of them has the camera where it is not, unless the arm is moving",
            "the camera mount in tf has to be that of franka/camera_position and franka/camera_rotation",
        )
    return fine("frames", found)
