"""Interface to an arm with velocity service: velocities, poses and the switch to its velocity controller."""

from __future__ import annotations

import time
from typing import Any, Callable, Optional

import rospy
from geometry_msgs.msg import PoseStamped, Twist, Vector3

from embodied_active_learning.errors import RobotError
from embodied_active_learning.franka.velocity_tracking import Twist as EndEffectorTwist
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.services import TRANSPORT_ERRORS
from embodied_active_learning.srv import StartVelocityControl, UpdateVelocity, UpdateVelocityRequest

_SERVICE_TIMEOUT = 1.0  # s of wall time
_START_TIMEOUT, _START_PERIOD = 3.0, 0.5  # s of wall time: the success rate covers the last cycles, also those at rest
_UNCHANGED = -1.0  # brightness
MIN_REQUESTS = 3.0
"""Requests per step of the controller (/dt): it lets the velocity decay after two steps without a request."""


class VelocityInterface:
    """Services and topics of the arm. Calls raise RobotError."""

    def __init__(self, on_pose: Callable[[PoseStamped], None]) -> None:
        """on_pose is called with each pose of the end effector as it arrives, in a thread of rospy."""
        self._proxy: Any = None
        self._subscriber = rospy.Subscriber(
            names.END_EFFECTOR_POSE, PoseStamped, on_pose, queue_size=1, tcp_nodelay=True
        )

    @property
    def is_available(self) -> bool:
        """Whether the arm's services are advertised."""
        try:
            rospy.wait_for_service(names.VELOCITY_START, timeout=_SERVICE_TIMEOUT)
        except rospy.ROSException:
            return False
        return True

    def start(self, rate: float) -> None:
        """Switch to the velocity controller, at rest, for requests at a rate [Hz]. The arm must not move."""
        step: Optional[float] = rospy.get_param(names.VELOCITY_STEP, None)
        if step is not None and rate * float(step) < MIN_REQUESTS:
            raise RobotError(
                f"franka/rate {rate:g} Hz gives fewer than {MIN_REQUESTS:g} requests per step of the controller "
                f"({rospy.resolve_name(names.VELOCITY_STEP)} {step:g} s): raise franka/rate, then call /arm/recover"
            )
        name = rospy.resolve_name(names.VELOCITY_START)
        deadline = time.monotonic() + _START_TIMEOUT
        try:
            while not rospy.ServiceProxy(name, StartVelocityControl)().success:
                if time.monotonic() >= deadline:
                    raise RobotError(
                        f"{name} reports that the robot does not follow: release the user stop or clear its reflex, "
                        "then call /arm/recover"
                    )
                time.sleep(_START_PERIOD)
        except TRANSPORT_ERRORS as error:
            raise RobotError(f"no response from {name}: {error}; is the robot's node running?") from error

    def send(self, twist: EndEffectorTwist) -> bool:
        """Set the velocity of the end effector; return whether the robot follows."""
        linear, angular = twist
        request = UpdateVelocityRequest(Twist(Vector3(*linear), Vector3(*angular)), _UNCHANGED)
        try:
            if self._proxy is None:
                self._proxy = rospy.ServiceProxy(names.VELOCITY_COMMAND, UpdateVelocity, persistent=True)
            return bool(self._proxy(request).success)
        except TRANSPORT_ERRORS as error:
            if self._proxy is not None:
                self._proxy.close()
            self._proxy = None
            raise RobotError(
                f"no response from {rospy.resolve_name(names.VELOCITY_COMMAND)}: {error}; is the robot's node running?"
            ) from error
