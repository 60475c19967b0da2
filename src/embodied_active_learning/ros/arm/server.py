"""Base class of the arm nodes: services, arbitration, heartbeat, diagnostics, and a brake for a silent commander."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, Sequence

import rospy
from std_srvs.srv import Trigger, TriggerResponse

from embodied_active_learning.arm_requests import StopSignal
from embodied_active_learning.config import Config
from embodied_active_learning.errors import ArmFailedError
from embodied_active_learning.msg import ArmCause, PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.arbiter import ArmArbiter
from embodied_active_learning.ros.arm.causes import cause_fields
from embodied_active_learning.ros.runtime import persistent_parameters
from embodied_active_learning.ros.runtime.diagnostics import Health, report_health
from embodied_active_learning.ros.runtime.services import advertise_service
from embodied_active_learning.ros.runtime.timers import WallTimer
from embodied_active_learning.srv import GoToPose, GoToPoseResponse, MoveArm, MoveArmResponse

WATCHDOG_PERIOD = 0.1
"""Wall seconds between two checks that the commander is alive."""
LIMITED = "the velocity was reduced to respect the arm's limits"


class MoveOutcome(NamedTuple):
    """State at the end of a velocity command, and whether a limit changed the velocity."""

    state: PlanarState
    limited: bool


class ArmServer(ABC):
    """Offers an arm's services to one commander at a time. Subclasses make the arm move."""

    def __init__(self, config: Config) -> None:
        self.arbiter = ArmArbiter(config.arm.commander_timeout, stopped_by=persistent_parameters.load(names.STOPPED_BY))
        self._store_stop = persistent_parameters.store(names.STOPPED_BY, lambda: self.arbiter.stopped_by)
        self._limited = 0

    def advertise_services(self) -> None:
        """Offer the services once the arm is set up, and start watchdog and diagnostics."""
        advertise_service(names.ARM_MOVE, MoveArm, self.handle_move, cause_fields)
        advertise_service(names.ARM_GO_TO, GoToPose, self.handle_go_to, cause_fields)
        advertise_service(names.ARM_HEARTBEAT, Trigger, self.handle_heartbeat)
        advertise_service(names.ARM_STOP, Trigger, self.handle_stop)
        advertise_service(names.ARM_RECOVER, Trigger, self.handle_recover)
        WallTimer(WATCHDOG_PERIOD, self.brake_if_commander_silent)
        report_health("arm", self.health)

    @abstractmethod
    def move(self, velocity: Sequence[float], duration: float, stop: StopSignal) -> MoveOutcome:
        """Hold velocity (3,) [m/s, m/s, rad/s] for a duration [s] within the limits. Raises CommandError."""

    @abstractmethod
    def go_to(self, pose: Sequence[float], stop: StopSignal) -> PlanarState:
        """Move to pose (3,) [m, m, rad] and stop there; return the state reached. Raises CommandError."""

    @abstractmethod
    def stop(self) -> None:
        """Bring the arm to rest. Raises ArmFailedError if it does not come to rest."""

    @abstractmethod
    def arm_health(self) -> Health:
        """Return the diagnostic status of the arm itself."""

    def recover(self) -> None:  # noqa: B027 - nothing to do for an arm that has no errors
        """Make the arm ready to move at a person's request. Raises EmbodiedActiveLearningError."""

    def handle_move(self, request: Any) -> MoveArmResponse:
        """Service /arm/move."""
        with self.arbiter.command(request) as stop:
            state, limited = self.move((request.vx, request.vy, request.omega), request.duration, stop)
            self._limited += limited
            return MoveArmResponse(True, LIMITED if limited else "", ArmCause.NONE, state, limited)

    def handle_go_to(self, request: Any) -> GoToPoseResponse:
        """Service /arm/go_to."""
        with self.arbiter.command(request) as stop:
            state = self.go_to((request.x, request.y, request.theta), stop)
            return GoToPoseResponse(True, "", ArmCause.NONE, state)

    def handle_heartbeat(self, request: Any) -> TriggerResponse:
        """Service /arm/heartbeat."""
        self.arbiter.heartbeat(request)
        return TriggerResponse(True, "")

    def handle_stop(self, request: Any) -> TriggerResponse:
        """Service /arm/stop: the command in progress ends at once."""
        with self.arbiter.stop(request) as needs_recovery:
            self.stop()
        self._store_stop()
        remedy = f"; commands are rejected until {rospy.resolve_name(names.ARM_RECOVER)} is called"
        return TriggerResponse(True, f"arm stopped{remedy if needs_recovery else ''}")

    def handle_recover(self, _request: Any) -> TriggerResponse:
        """Service /arm/recover: a person confirms that the arm may move again. A stop ends once the arm is ready."""
        with self.arbiter.recovery():
            self.recover()
        return TriggerResponse(True, "the arm accepts commands")

    def brake_if_commander_silent(self) -> None:
        """Stop and free the arm once its commander has sent no heartbeat for arm/commander_timeout."""
        with self.arbiter.hold_for_silent_commander() as commander:
            if not commander:
                return
            rospy.logwarn("no heartbeat from %s: the arm is stopped and free for other nodes", commander)
            try:
                self.stop()
            except ArmFailedError as error:
                rospy.logerr("%s", error)

    def health(self) -> Health:
        """Return the diagnostic status."""
        status = self.arbiter.health(self.arm_health())
        status.values["velocities limited"] = self._limited
        return status
