"""Whether an arm with velocity service may be moved, and explanations of why not."""

from __future__ import annotations

from embodied_active_learning.config import FrankaConfig
from embodied_active_learning.franka.readiness import Readiness
from embodied_active_learning.franka.report import Condition, Report

STOPPED_ERROR = "the velocity service reports success: false"
"""Error of a robot that does not follow the commanded velocities."""

_FIXED = {
    Condition.READY: "",
    Condition.NO_STATE: "no pose of the robot received yet: is its velocity controller's node running?",
}


class VelocityReadiness(Readiness):
    """Readiness of a robot that reports its pose and the success of commands, but no mode and no errors.

    The interface does not distinguish a reflex from the user stop, so the robot is held after each stop until a person
    releases it.
    """

    def _check_preparation(self, report: Report) -> None:
        """Nothing is known about controllers."""

    def _evaluate_reflex(self) -> Condition:
        self._reflex_hold = f"the robot has stopped ({self._report.error_names})"
        return Condition.RECOVERY_REQUIRED

    def _evaluate_control(self, report: Report, now: float) -> Condition:
        return Condition.READY if self._prepared else Condition.UNPREPARED


def why_not_ready(readiness: Readiness, config: FrankaConfig) -> str:
    """Return what prevents the robot from being moved and what to do; empty if it is ready."""
    condition, report = readiness.condition, readiness.report
    if condition in _FIXED:
        return _FIXED[condition]
    if condition is Condition.STALE:
        return (
            f"poses of the robot are stale: age {report.age or 0.0:.2f} s, delay on arrival {report.delay:.2f} s "
            f"(franka/state_max_age {config.state_max_age:g} s); check its node, the network and the computers' clocks"
        )
    if condition is Condition.UNUSABLE:
        return report.problem
    if condition is Condition.RECOVERY_REQUIRED:
        return (
            f"{readiness.held_for}: remove the cause, clear a reflex (rostopic pub -1 "
            "/franka_control/error_recovery/goal franka_msgs/ErrorRecoveryActionGoal '{}'), then call "
            f"{readiness.recovery_service}"
        )
    if condition is Condition.NO_SET_POINTS:
        return (
            f"no velocity was sent for {report.tick_age:.1f} s: the velocity service does not respond, or the computer "
            "is overloaded; see the log of the robot's node and /diagnostics"
        )
    return readiness.preparation_error or "the velocity controller is not started yet"
