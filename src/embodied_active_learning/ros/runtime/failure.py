"""The failure parameter: a node that gives up stores its reason there, and the node that ends the launch reads it."""

from __future__ import annotations

import rospy

from embodied_active_learning.errors import RunFailedError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.master import CALL_ERRORS
from embodied_active_learning.ros.runtime.timers import WallTimer

_PERIOD = 1.0
"""Wall seconds between two reads; shorter than respawn_delay in the launch files."""


def report_failure(reason: str) -> None:
    """Store the reason unless another node has stored one before."""
    name = rospy.resolve_name(names.FAILURE_PARAMETER)
    try:
        if not rospy.get_param(name, ""):
            rospy.set_param(name, f"{rospy.get_name()}: {reason}")
    except CALL_ERRORS as error:
        rospy.logdebug("failure not reported to the ROS master: %s", error)


class FailureWatch:
    """Shuts down this node, and with it the launch that requires it, when another node has reported a failure."""

    def __init__(self) -> None:
        self._reason = ""
        WallTimer(_PERIOD, self._check_parameter)

    def check(self) -> None:
        """Raise RunFailedError if a failure was reported."""
        if self._reason:
            raise RunFailedError(self._reason)

    def _check_parameter(self) -> None:
        try:
            self._reason = str(rospy.get_param(rospy.resolve_name(names.FAILURE_PARAMETER), ""))
        except CALL_ERRORS:
            return  # the master cannot be reached at the moment
        if self._reason:
            rospy.signal_shutdown(self._reason)
