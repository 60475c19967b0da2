"""A commander's side of the arm: commands that report refusal as an error."""

from __future__ import annotations

from typing import Any, Sequence

import rospy
from std_srvs.srv import Trigger

from embodied_active_learning.errors import CommandError, UnansweredError
from embodied_active_learning.msg import PlanarState
from embodied_active_learning.ros import names
from embodied_active_learning.ros.node import wait_until
from embodied_active_learning.ros.services import TRANSPORT_ERRORS, saying_who_is_awaited
from embodied_active_learning.srv import GoToPose, MoveArm


class ArmClient:
    """Moves the arm through its services. Commands are never sent twice: an unanswered one is an UnansweredError."""

    def __init__(self) -> None:
        self._move = rospy.ServiceProxy(names.ARM_MOVE, MoveArm)
        self._go_to = rospy.ServiceProxy(names.ARM_GO_TO, GoToPose)
        self._stop = rospy.ServiceProxy(names.ARM_STOP, Trigger)

    def wait(self) -> None:
        """Return once the arm offers its services. Raises ShutdownRequestedError."""
        wait_until(lambda: _is_offered(self._move), lambda: f"the arm ({self._move.resolved_name})", period=0.2)

    def move(self, velocity: Sequence[float], duration: float) -> PlanarState:
        """Hold velocity (3,) [m/s, m/s, rad/s] for a duration [s] -> the state reached. Raises CommandError."""
        return self._answer(self._move, *map(float, velocity), duration).state

    def go_to(self, pose: Sequence[float]) -> PlanarState:
        """Go to pose (3,) [m, m, rad] and stop there -> the state reached. Raises CommandError."""
        return self._answer(self._go_to, *map(float, pose)).state

    def stop(self) -> None:
        """Stop now. Raises CommandError when the arm does not confirm."""
        self._answer(self._stop)

    @staticmethod
    def _answer(service: Any, *arguments: float) -> Any:
        try:
            with saying_who_is_awaited(service.resolved_name):
                answer = service(*arguments)
        except TRANSPORT_ERRORS as error:
            raise UnansweredError(f"{service.resolved_name} did not answer: {error}") from error
        if not answer.success:
            raise CommandError(answer.message)
        return answer


def _is_offered(service: Any) -> bool:
    try:
        service.wait_for_service(timeout=0.1)
    except rospy.ROSException:
        return False
    return True
