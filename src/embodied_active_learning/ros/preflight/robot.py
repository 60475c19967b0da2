"""Checks of a Panda under franka_ros, and of the camera's pose."""

from __future__ import annotations

import math
from typing import Dict, List, Mapping, Sequence, Tuple

import numpy as np
import rospy

from embodied_active_learning.config import REAL_ROBOTS, Config
from embodied_active_learning.errors import ArmNotReadyError
from embodied_active_learning.franka.mount import CameraMount, CameraPose
from embodied_active_learning.franka.report import CONTROLLER, Controller, Report, RobotMode
from embodied_active_learning.franka.start_check import distances_outside, require_startable
from embodied_active_learning.ros import names
from embodied_active_learning.ros.camera.v4l2 import set_command
from embodied_active_learning.ros.preflight.check_result import CheckResult, error, ok, warning
from embodied_active_learning.workspace import STATE_NAMES

STATE_CONTROLLER = "franka_state_controller"
MIN_SUCCESS_RATE = 0.95
"""Smallest acceptable control_command_success_rate."""
POSITION_TOLERANCE, ANGLE_TOLERANCE = 0.002, 0.01
"""Largest difference [m], [rad] between tf and arm/state while the arm rests."""
LOAD_TOLERANCE = 0.01
"""Largest difference [kg] between the robot's load and franka/load_mass."""
_READY_MODES = (RobotMode.IDLE, RobotMode.MOVE)
_BORDER_TOLERANCE = 1e-3  # m, rad: an arm that rests at the border counts as inside
_MODE_REMEDIES: Dict[int, str] = {
    RobotMode.USER_STOPPED: "release the user stop, then ",
    RobotMode.REFLEX: "remove what the arm has touched, then ",
    RobotMode.GUIDING: "release the guiding buttons of the hand, then ",
}


def check_robot_state(mode: int, errors: Sequence[str], success_rate: float) -> List[CheckResult]:
    """Check robot_mode, current_errors (names) and control_command_success_rate of franka_states."""
    mode_name = Report(mode=mode).mode_name
    if errors or mode not in _READY_MODES:
        remedy = f"{_MODE_REMEDIES.get(mode, 'see Desk; ')}rosservice call {rospy.resolve_name(names.ARM_RECOVER)}"
        message = f"{mode_name}, errors: {', '.join(errors) or 'none'}"
        results = [error("robot mode", message, "the robot accepts no motion in this state", remedy)]
    else:
        results = [ok("robot mode", f"{mode_name}, no errors")]
    if mode != RobotMode.MOVE:  # without a running controller there are no commands, and the rate is 0
        return results
    message = f"{success_rate:.0%} of the commands arrive in time"
    if success_rate < MIN_SUCCESS_RATE:
        reason = "lost commands end in communication_constraints_violation during a run"
        remedy = "use a realtime kernel, a network card for the robot alone, no power saving, less load"
        return [*results, warning("robot network", message, reason, remedy)]
    return [*results, ok("robot network", message)]


def check_controllers(controllers: Mapping[str, Controller], publishers: Sequence[str]) -> List[CheckResult]:
    """Check that the state controller and ours run, and that nothing else moves the arm.

    Args:
        controllers: loaded controllers of controller_manager by name.
        publishers: nodes that publish set-points to our controller.
    """
    name = "controllers"
    reason = f"franka_arm reads the robot's state from {STATE_CONTROLLER} and moves the arm with {CONTROLLER}"
    results = []
    state = controllers[STATE_CONTROLLER].state if STATE_CONTROLLER in controllers else "not loaded"
    if state != "running":
        remedy = "see the log of franka_control.launch, which starts it"
        results.append(error(name, f"{STATE_CONTROLLER} is {state}", reason, remedy))
    others = Report(controllers=controllers).other_controllers
    if others:
        results.append(
            error(
                name,
                f"{', '.join(others)} controls the arm",
                "two controllers cannot command the same joints, and franka_arm does not stop those of others",
                f"rosrun controller_manager controller_manager stop {' '.join(others)}",
            )
        )
    state = controllers[CONTROLLER].state if CONTROLLER in controllers else "not loaded"
    if state != "running" and not others:
        recover = rospy.resolve_name(names.ARM_RECOVER)
        remedy = f"see the log of franka_arm, which loads and starts it; rosservice call {recover}"
        results.append(error(name, f"{CONTROLLER} is {state}", reason, remedy))
    if len(publishers) > 1:
        results.append(
            error(
                name,
                f"{', '.join(publishers)} publish set-points at the same time",
                "the arm would jump between them",
                "stop all but franka_arm, for example the interactive marker of franka_example_controllers",
            )
        )
    return results or [ok(name, f"{STATE_CONTROLLER} and {CONTROLLER} run; nothing else moves the arm")]


def check_load(load_mass: float, config: Config) -> CheckResult:
    """Check that the robot's load, m_load of franka_states [kg], is the configured one."""
    name, wanted = "load", config.franka.load_mass
    message = f"the robot compensates a load of {load_mass:g} kg"
    if abs(load_mass - wanted) > LOAD_TOLERANCE:
        return error(
            name,
            f"{message}, franka/load_mass is {wanted:g} kg",
            "with a wrong load the arm sags or rises, and collisions are detected too early or too late",
            f"rosservice call {rospy.resolve_name(names.ARM_RECOVER)} sets it when the robot is prepared; or set "
            "franka/load_mass",
        )
    return ok(name, message)


def check_camera_controls(
    device: str, controls: Mapping[str, int], differing: Mapping[str, Tuple[int, int]]
) -> CheckResult:
    """Check that exposure, focus and white balance are fixed.

    Args:
        device: of the camera.
        controls: values of its v4l2 controls by name.
        differing: present and wanted value of the controls that differ.
    """
    name = "camera controls"
    if differing:
        values = ", ".join(f"{control} is {value}, not {wanted}" for control, (value, wanted) in differing.items())
        reason = "the images change with the light, and what was learned no longer fits"
        return error(name, values, reason, set_command(device, differing))
    return ok(name, f"exposure, focus and white balance of {device} are fixed ({len(controls)} controls)")


def camera_pose(transform: np.ndarray, config: Config) -> CameraPose:
    """Return the pose of the camera from that of its optical frame in the base frame, (4, 4) [m].

    Raises ObservationError if it is invalid or the camera looks up.
    """
    table_height = config.franka.table_height if config.arm.robot in REAL_ROBOTS else 0.0
    unmounted = CameraMount((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), config.camera.distance + table_height)
    return unmounted.camera_pose(transform.T.ravel().tolist())


def check_camera_pose(pose: CameraPose, config: Config) -> CheckResult:
    """Check that motion can start at the camera's pose."""
    name, (x, y, theta) = "camera pose", pose.planar
    message = (
        f"x {x:.3f} m, y {y:.3f} m, theta {theta:.2f} rad, height error {pose.height * 1e3:+.0f} mm, "
        f"tilt {math.degrees(pose.tilt_angle):.1f} degrees"
    )
    try:
        require_startable(pose, config)
    except ArmNotReadyError as problem:
        remedy = "guide the arm by hand, or correct the configuration; see the message"
        return error(name, f"{message}: {problem}", "motion does not start there", remedy)
    outside = distances_outside(pose, config)
    axes = ", ".join(f"workspace/{axis}" for axis, far in zip(STATE_NAMES, outside) if far > _BORDER_TOLERANCE)
    if axes:
        return warning(
            name,
            f"{message}: outside {axes}",
            "the arm first moves straight back into the workspace",
            "clear its path, or guide it into the workspace by hand",
        )
    return ok(name, message)


def check_frames(tf_state: Sequence[float], arm_state: Sequence[float]) -> CheckResult:
    """Compare the camera's planar pose (x [m], y [m], theta [rad]) of tf with that of arm/state."""
    difference = np.subtract(tf_state, arm_state)
    distance = math.hypot(difference[0], difference[1])
    angle = abs(math.remainder(difference[2], 2.0 * math.pi))
    message = f"tf and arm/state differ by {distance * 1e3:.1f} mm and {angle:.3f} rad"
    if distance > POSITION_TOLERANCE or angle > ANGLE_TOLERANCE:
        return error(
            "frames",
            message,
            "one of them is wrong, unless the arm is moving",
            "the camera mount in tf must match franka/camera_position and franka/camera_rotation",
        )
    return ok("frames", message)
