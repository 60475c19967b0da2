"""Explanations of why the robot cannot be moved, each with a remedy."""

from __future__ import annotations

from typing import Callable, Dict

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.franka.readiness import Readiness
from embodied_active_learning.franka.report import CONTROLLER, Condition

_FIXED = {
    Condition.READY: "",
    Condition.NO_STATE: "no robot state received yet: is franka_control running, and its state controller?",
    Condition.RECOVERING: "the robot is recovering from a reflex",
    Condition.NO_CONTROLLER_MANAGER: "no response from controller_manager: is franka_control running?",
    Condition.NO_SUBSCRIBER: f"{CONTROLLER} does not subscribe to set-points: franka_ros 0.8 or newer is required",
    Condition.STARTING: f"{CONTROLLER} is running, but the robot does not follow it yet",
}


def why_not_ready(readiness: Readiness, config: FrankaConfig) -> str:
    """Return what prevents the robot from being moved and what to do; empty if it is ready."""
    condition = readiness.condition
    return _FIXED[condition] if condition in _FIXED else _DETAILED[condition](readiness, config)


def _why_stale(readiness: Readiness, config: FrankaConfig) -> str:
    report = readiness.report
    if report.age is not None and report.age > config.state_max_age:
        return (
            f"no new robot state for {report.age:.2f} s (franka/state_max_age): check franka_control and the network "
            "cable"
        )
    return (
        f"robot states are {report.delay:.2f} s off this computer's clock on arrival (franka/state_max_age): "
        "synchronise the clocks of both computers, or repair the network"
    )


def _why_reflex(readiness: Readiness, config: FrankaConfig) -> str:
    last = f"; last recovery: {readiness.recovery_error}" if readiness.recovery_error else ""
    count = f"recovery {readiness.consecutive_recoveries + 1} of {config.recoveries}"
    return f"robot reflex ({readiness.report.error_names}): {count} follows automatically{last}"


def _why_other_controller(readiness: Readiness, _config: FrankaConfig) -> str:
    others = readiness.report.other_controllers
    return (
        f"another controller moves the robot: {', '.join(others)}; stop it (rosrun controller_manager "
        f"controller_manager stop {others[0]}), then call {readiness.recovery_service}"
    )


def _why_other_publisher(readiness: Readiness, _config: FrankaConfig) -> str:
    return (
        f"another node publishes set-points to {CONTROLLER}: {', '.join(readiness.report.publishers)}; stop it (the "
        "controller's example launch file starts one)"
    )


def _why_outdated(readiness: Readiness, _config: FrankaConfig) -> str:
    return (
        f"controllers and publishers of set-points are unknown for {readiness.report.control_age:.1f} s: "
        "controller_manager or the ROS master does not respond; check franka_control"
    )


_DETAILED: Dict[Condition, Callable[[Readiness, FrankaConfig], str]] = {
    Condition.STALE: _why_stale,
    Condition.UNUSABLE: lambda readiness, _: f"unusable robot state: {readiness.report.problem}",
    Condition.USER_STOPPED: lambda readiness, _: (
        f"the user stop is pressed: release it, then call {readiness.recovery_service}"
    ),
    Condition.GUIDED: lambda readiness, _: (
        f"the robot is guided by hand: let go of it, then call {readiness.recovery_service}"
    ),
    Condition.RECOVERY_REQUIRED: lambda readiness, _: (
        f"{readiness.held_for}: check the robot, then call {readiness.recovery_service}"
    ),
    Condition.REFLEX: _why_reflex,
    Condition.OTHER_CONTROLLER: _why_other_controller,
    Condition.OTHER_PUBLISHER: _why_other_publisher,
    Condition.OUTDATED_CONTROL: _why_outdated,
    Condition.NO_SET_POINTS: lambda readiness, _: (
        f"no set-point was sent for {readiness.report.tick_age:.1f} s: the computer is overloaded, see /diagnostics"
    ),
    Condition.UNPREPARED: lambda readiness, _: readiness.preparation_error or f"{CONTROLLER} is not started yet",
}
