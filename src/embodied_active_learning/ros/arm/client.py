"""Client of the arm's services: a command that the arm did not carry out raises an error."""

from __future__ import annotations

import threading
from typing import Any, Callable, Sequence

import rospy
from std_srvs.srv import Trigger

from embodied_active_learning.errors import ArmFailedError, CommandError, NoResponseError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.causes import error_of
from embodied_active_learning.ros.runtime.node import wait_until
from embodied_active_learning.ros.runtime.services import (
    HANDLER_FAILED,
    TRANSPORT_ERRORS,
    is_advertised,
    log_service_wait,
)
from embodied_active_learning.srv import GoToPose, MoveArm, RestoreArm


class ArmClient:
    """Calls the arm's services. A command is never sent twice: without a response it raises NoResponseError."""

    def __init__(self) -> None:
        self._move = rospy.ServiceProxy(names.ARM_MOVE, MoveArm)
        self._go_to = rospy.ServiceProxy(names.ARM_GO_TO, GoToPose)
        self._stop = rospy.ServiceProxy(names.ARM_STOP, Trigger)
        self._heartbeat = rospy.ServiceProxy(names.ARM_HEARTBEAT, Trigger)
        self._restore = rospy.ServiceProxy(names.ARM_RESTORE, RestoreArm)
        self._can_restore = False
        self._stop_lock = threading.Lock()

    @property
    def can_restore(self) -> bool:
        """Whether the arm is simulated and can return to earlier states; known once `wait` has returned."""
        return self._can_restore

    def wait(self, check: Callable[[], None] = lambda: None) -> None:
        """Wait until the arm offers its services; check() gives up by raising. Raises ShutdownRequestedError."""
        arm = f"the arm ({self._move.resolved_name})"
        wait_until(lambda: _is_available(self._move), lambda: arm, period=0.2, check=check)
        self._can_restore = is_advertised(names.ARM_RESTORE)

    def move(self, velocity: Sequence[float], duration: float) -> PlanarState:
        """Hold velocity (3,) [m/s, m/s, rad/s] for a duration [s]; return the state reached. Raises CommandError."""
        return _command(self._move, *map(float, velocity), duration)

    def go_to(self, pose: Sequence[float]) -> PlanarState:
        """Move to pose (3,) [m, m, rad] and stop there; return the state reached. Raises CommandError."""
        return _command(self._go_to, *map(float, pose))

    def restore(self, stamp: rospy.Time) -> PlanarState:
        """Return the simulated arm to its state at a stamp; return that state. Raises CommandError."""
        return _command(self._restore, stamp)

    def stop(self) -> None:
        """Stop the arm now. Raises CommandError if the arm does not confirm."""
        with log_service_wait(self._stop.resolved_name):
            response = _call(self._stop)
        if not response.success:
            raise ArmFailedError(response.message)

    def heartbeat(self) -> bool:
        """Extend this node's control of the arm; return whether the arm granted it. Raises CommandError."""
        return _call(self._heartbeat).success

    def stop_if_commander(self, without_response: bool = False) -> None:
        """Stop the arm now if this node commands it. Raises CommandError if the arm does not confirm.

        A stop by any other node would be an emergency stop, and an arm that has restarted has no commander.

        Args:
            without_response: Also send the stop if the heartbeat gets no response, as while this node shuts down.
        """
        with self._stop_lock:  # of two stops at once, the second would come from a node without control
            try:
                is_commander = self.heartbeat()
            except CommandError:
                if not without_response:
                    raise
                is_commander = True
            if is_commander:
                self.stop()


def _command(service: Any, *arguments: Any) -> PlanarState:
    """Call a motion service and return the state reached; raise the error named by the response's cause."""
    with log_service_wait(service.resolved_name):
        response = _call(service, *arguments)
    if not response.success:
        raise error_of(response.cause, response.message)
    return response.state


def _call(service: Any, *arguments: Any) -> Any:
    try:
        return service(*arguments)
    except TRANSPORT_ERRORS as error:
        if HANDLER_FAILED in str(error):
            raise ArmFailedError(f"{service.resolved_name} failed: {error}; see the log of its node") from error
        raise NoResponseError(f"no response from {service.resolved_name}: {error}") from error


def _is_available(service: Any) -> bool:
    try:
        service.wait_for_service(timeout=0.1)
    except rospy.ROSException:
        return False
    return True
