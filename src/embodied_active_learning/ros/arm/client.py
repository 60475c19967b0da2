"""A commander's side of the arm: commands that report as an error what was not done."""

from __future__ import annotations

from typing import Any, NamedTuple, Sequence

import numpy as np
import rospy
from std_srvs.srv import Trigger

from embodied_active_learning.errors import ArmFailedError, NoResponseError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.arm.error_codes import error_of
from embodied_active_learning.ros.runtime.node import wait_until
from embodied_active_learning.ros.runtime.services import HANDLER_FAILED, TRANSPORT_ERRORS, log_service_wait
from embodied_active_learning.srv import GoToPose, MoveArm, RestoreArm


class Reached(NamedTuple):
    """Where a command ended, and what puts a simulated arm back there: (M,), empty for a real one."""

    state: PlanarState
    memory: np.ndarray


class ArmClient:
    """Moves the arm through its services. Commands are never sent twice: an unanswered one is an NoResponseError."""

    def __init__(self) -> None:
        self._move = rospy.ServiceProxy(names.ARM_MOVE, MoveArm)
        self._go_to = rospy.ServiceProxy(names.ARM_GO_TO, GoToPose)
        self._stop = rospy.ServiceProxy(names.ARM_STOP, Trigger)
        self._keep = rospy.ServiceProxy(names.ARM_HEARTBEAT, Trigger)
        self._restore = rospy.ServiceProxy(names.ARM_RESTORE, RestoreArm)

    def wait(self) -> None:
        """Return once the arm offers its services. Raises ShutdownRequestedError."""
        wait_until(lambda: _is_offered(self._move), lambda: f"the arm ({self._move.resolved_name})", period=0.2)

    def move(self, velocity: Sequence[float], duration: float) -> Reached:
        """Hold velocity (3,) [m/s, m/s, rad/s] for a duration [s]. Raises CommandError."""
        answer = _command(self._move, *map(float, velocity), duration)
        return Reached(answer.state, np.array(answer.memory))

    def go_to(self, pose: Sequence[float]) -> Reached:
        """Go to pose (3,) [m, m, rad] and stop there. Raises CommandError."""
        answer = _command(self._go_to, *map(float, pose))
        return Reached(answer.state, np.array(answer.memory))

    def restore(self, memory: np.ndarray) -> Reached:
        """Put a simulated arm back to where it was when it answered with a memory (M,). Raises CommandError."""
        return Reached(_command(self._restore, memory.tolist()).state, memory)

    def stop(self) -> None:
        """Stop now. Raises CommandError when the arm does not confirm."""
        with log_service_wait(self._stop.resolved_name):
            answer = _ask(self._stop)
        if not answer.success:
            raise ArmFailedError(answer.message)

    def keep(self) -> bool:
        """Tell the arm that this node goes on driving it -> whether it still does. Raises CommandError."""
        return _ask(self._keep).success


def _command(service: Any, *arguments: Any) -> Any:
    with log_service_wait(service.resolved_name):
        answer = _ask(service, *arguments)
    if not answer.success:
        raise error_of(answer.cause, answer.message)
    return answer


def _ask(service: Any, *arguments: Any) -> Any:
    try:
        return service(*arguments)
    except TRANSPORT_ERRORS as error:
        if HANDLER_FAILED in str(error):
            raise ArmFailedError(f"{service.resolved_name} failed, the log of its node tells why: {error}") from error
        raise NoResponseError(f"{service.resolved_name} did not answer: {error}") from error


def _is_offered(service: Any) -> bool:
    try:
        service.wait_for_service(timeout=0.1)
    except rospy.ROSException:
        return False
    return True
