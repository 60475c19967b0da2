"""Interface to an arm with velocity service: velocities, poses and the switch to its velocity controller."""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from typing import Callable, Iterator

import rospy
from geometry_msgs.msg import PoseStamped, Twist, Vector3

from embodied_active_learning.errors import RobotError, ServiceError
from embodied_active_learning.franka.velocity_tracking import REST
from embodied_active_learning.franka.velocity_tracking import Twist as EndEffectorTwist
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.master import CALL_ERRORS, master_proxy
from embodied_active_learning.ros.runtime.timed_service import TimedService, call_within
from embodied_active_learning.srv import (
    StartVelocityControl,
    StartVelocityControlRequest,
    UpdateVelocity,
    UpdateVelocityRequest,
)

_START_TIMEOUT, _START_PERIOD = 3.0, 0.5  # s of wall time: the success rate covers the last cycles, also those at rest
_MIN_SEND_TIMEOUT, _SEND_STEPS = 0.3, 2.0  # s of wall time, and steps of the controller
_UNCHANGED = -1.0  # brightness
GRACE = 1.0
"""s after a start of the controller in which the success rate still covers the time before it."""
MIN_REQUESTS = 3.0
"""Requests per step of the controller (/dt): it lets the velocity decay after two steps without a request."""


class VelocityInterface:
    """Services and topics of the arm."""

    def __init__(self, on_pose: Callable[[PoseStamped], None]) -> None:
        """on_pose is called with each pose of the end effector as it arrives, in a thread of rospy."""
        self._started_at = -math.inf  # monotonic time of the last start of the controller
        self._command = TimedService(names.VELOCITY_COMMAND, UpdateVelocity, _MIN_SEND_TIMEOUT)
        self._subscriber = rospy.Subscriber(
            names.END_EFFECTOR_POSE, PoseStamped, on_pose, queue_size=1, tcp_nodelay=True
        )

    def start(self, rate: float) -> None:
        """Switch to the velocity controller, at rest, for requests at a rate [Hz]. The arm must not move.

        Raises:
            RobotError: The robot does not follow, or the rate is too low.
            ServiceError: The robot's node does not respond.
        """
        step = _controller_step()
        if rate * step < MIN_REQUESTS:
            raise RobotError(
                f"franka/rate {rate:g} Hz gives fewer than {MIN_REQUESTS:g} requests per step of the controller "
                f"({rospy.resolve_name(names.VELOCITY_STEP)} {step:g} s): raise franka/rate, then call "
                f"{rospy.resolve_name(names.ARM_RECOVER)}"
            )
        if math.isfinite(step):
            self._command.timeout = max(_MIN_SEND_TIMEOUT, _SEND_STEPS * step)
        deadline = time.monotonic() + _START_TIMEOUT
        while not self._call_start():
            if time.monotonic() >= deadline:
                raise RobotError(
                    f"{rospy.resolve_name(names.VELOCITY_START)} reports that the robot does not follow: release the "
                    f"user stop or clear its reflex, then call {rospy.resolve_name(names.ARM_RECOVER)}"
                )
            time.sleep(_START_PERIOD)
        with _remedy():  # it may hang although the start was accepted
            call_within(self._command.timeout, names.VELOCITY_COMMAND, UpdateVelocity, _request(REST))
        self._started_at = time.monotonic()

    def send(self, twist: EndEffectorTwist) -> bool:
        """Set the velocity of the end effector; return whether the robot follows, assumed for GRACE after a start.

        Raises ServiceError.
        """
        with _remedy():
            follows = bool(self._command.call(_request(twist)).success)
        return follows or time.monotonic() <= self._started_at + GRACE

    @staticmethod
    def _call_start() -> bool:
        request = StartVelocityControlRequest()
        with _remedy():
            return bool(call_within(_START_TIMEOUT, names.VELOCITY_START, StartVelocityControl, request).success)


def _request(twist: EndEffectorTwist) -> UpdateVelocityRequest:
    linear, angular = twist
    return UpdateVelocityRequest(Twist(Vector3(*linear), Vector3(*angular)), _UNCHANGED)


@contextmanager
def _remedy() -> Iterator[None]:
    """Append what to do to a ServiceError."""
    try:
        yield
    except ServiceError as error:
        raise ServiceError(f"{error}; is the robot's node running?") from error


def _controller_step() -> float:
    """Return the period [s] of the robot's velocity controller; infinite if it is unknown."""
    name = rospy.resolve_name(names.VELOCITY_STEP)
    try:
        code, _, value = master_proxy().getParam(rospy.get_name(), name)
    except CALL_ERRORS as error:
        raise ServiceError(f"no response from the ROS master: {error}") from error
    if code != 1:  # not set
        return math.inf
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise RobotError(
            f"parameter {name} is {value!r}, not seconds: correct it, then call {rospy.resolve_name(names.ARM_RECOVER)}"
        ) from error
