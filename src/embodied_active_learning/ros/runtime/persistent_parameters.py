"""Parameters that keep a node's state on the parameter server across restarts of the node."""

from __future__ import annotations

from typing import Callable

import rospy

from embodied_active_learning.ros.runtime.timers import WallTimer

_PERIOD = 0.1
"""Wall seconds within which a change is stored."""


def load(name: str) -> str:
    """Return the stored text; empty if the parameter is not set."""
    return str(rospy.get_param(name, ""))


def store(name: str, text: Callable[[], str]) -> None:
    """Store text() whenever it changes, until the node shuts down.

    A separate thread writes it, so that a master that does not respond never delays a stop of the arm.
    """
    stored = load(name)

    def update() -> None:
        nonlocal stored
        current = text()
        if current != stored:
            rospy.set_param(name, current)
            stored = current

    WallTimer(_PERIOD, update)
