"""The failure parameter: a node that gives up stores its reason there, and the node that ends the launch reads it."""

from __future__ import annotations

import rospy

from embodied_active_learning.errors import RunFailedError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.master import CALL_ERRORS, master_proxy
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

    def read_reason(self) -> str:
        """Return the failure that was reported, also since the last timer; empty if none was."""
        try:
            code, _, value = master_proxy().getParam(rospy.get_name(), rospy.resolve_name(names.FAILURE_PARAMETER))
        except CALL_ERRORS:
            return self._reason  # the master cannot be reached at the moment
        if code == 1:
            self._reason = str(value)
        return self._reason

    def _check_parameter(self) -> None:
        if self.read_reason():
            rospy.signal_shutdown(self._reason)
