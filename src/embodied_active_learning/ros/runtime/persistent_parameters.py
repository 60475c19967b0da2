"""What has to outlive a node that is killed and started again: a word with the ROS master, for as long as a launch."""

from __future__ import annotations

from typing import Callable

import rospy

from embodied_active_learning.ros.runtime.timers import WallTimer

PERIOD = 0.1
"""Wall seconds within which a change is kept."""


def recall(name: str) -> str:
    """The text that was kept under the name of a parameter; empty when there is none."""
    return str(rospy.get_param(name, ""))


def keep(name: str, text: Callable[[], str]) -> None:
    """Keep under the name of a parameter what text() answers, whenever that changes, until the node ends.

    A thread of its own does it: a master that hangs must not hold up the one who stops an arm.
    """
    kept = recall(name)

    def update() -> None:
        nonlocal kept
        wanted = text()
        if wanted != kept:
            rospy.set_param(name, wanted)
            kept = wanted

    WallTimer(PERIOD, update)
