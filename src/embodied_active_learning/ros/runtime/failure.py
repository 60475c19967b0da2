"""Why a run cannot go on, told by the node that has given up to the one that ends the launch."""

from __future__ import annotations

from typing import Any, Callable, Dict, Optional

import rospy

from embodied_active_learning.errors import RunFailedError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.timers import WallTimer

PERIOD = 1.0
"""Wall seconds between two looks; shorter than the launch files' respawn_delay."""
STARTS_IN_VAIN = 10
"""Starts of one node without any progress of the run after which it is given up."""


def report_failure(reason: str) -> None:
    """Leave the reason where the node that ends the launch sees it; the first one counts."""
    name = rospy.resolve_name(names.FAILURE_PARAMETER)
    try:
        if not rospy.get_param(name, ""):
            rospy.set_param(name, f"{rospy.get_name()}: {reason}")
    except OSError as error:
        rospy.logdebug("the ROS master did not take the reason: %s", error)


def count_start() -> None:
    """Count that this node was started."""
    name = f"{rospy.resolve_name(names.STARTS_PARAMETER)}/{rospy.get_name().rsplit('/', 1)[1]}"
    rospy.set_param(name, rospy.get_param(name, 0) + 1)


class FailureWatch:
    """Ends this node, which the launch requires, when the run cannot go on.

    That is so when a node has left its reason, or was started again and again while `progress` answered the same.
    """

    def __init__(self, progress: Callable[[], Any]) -> None:
        self._progress = progress
        self._last: Any = None
        self._starts_then: Optional[Dict[str, int]] = None
        self._reason = ""
        WallTimer(PERIOD, self._look)

    def check(self) -> None:
        """Raise RunFailedError when the run cannot go on."""
        if self._reason:
            raise RunFailedError(self._reason)

    def _look(self) -> None:
        try:
            reason = rospy.get_param(rospy.resolve_name(names.FAILURE_PARAMETER), "")
            starts = rospy.get_param(rospy.resolve_name(names.STARTS_PARAMETER), {})
        except OSError:
            return  # the master cannot be reached, which is said elsewhere
        self._reason = str(reason) or self._in_vain(starts)
        if self._reason:
            rospy.signal_shutdown(self._reason)

    def _in_vain(self, starts: Dict[str, int]) -> str:
        progress = self._progress()
        if self._starts_then is None or progress != self._last:
            self._last, self._starts_then = progress, dict(starts)
        for node, count in starts.items():
            more = count - self._starts_then.setdefault(node, count)
            if more >= STARTS_IN_VAIN:
                return f"{node} was started again {more} times without any progress: its log tells why it ended"
        return ""
