"""Parameters that keep a node's state on the parameter server across restarts of the node."""

from __future__ import annotations

import threading
from typing import Callable

import rospy

from embodied_active_learning.ros.runtime.timers import WallTimer

_PERIOD = 0.1
"""Wall seconds within which a change is stored."""
_TIMEOUT = 0.3
"""Wall seconds that a stop or the shutdown of a node waits for the master."""


def load(name: str) -> str:
    """Return the stored text; empty if the parameter is not set."""
    return str(rospy.get_param(name, ""))


def store(name: str, text: Callable[[], str]) -> Callable[[], None]:
    """Store text() whenever it changes, and a last time after the node's shutdown hooks, in which its arm may brake.

    Separate threads write it, so that a master that does not respond never delays a stop of the arm for long.

    Returns:
        A function that stores text() at once; it returns when this is done, at the latest after _TIMEOUT.
    """
    stored = load(name)
    lock = threading.Lock()

    def update() -> None:
        nonlocal stored
        with lock:
            current = text()
            if current != stored:
                rospy.set_param(name, current)
                stored = current

    def try_update() -> None:
        try:
            update()
        except Exception as error:
            rospy.logwarn("parameter %s not stored: %r", name, error)

    def update_now() -> None:
        thread = threading.Thread(target=try_update, daemon=True)
        thread.start()
        thread.join(_TIMEOUT)

    WallTimer(_PERIOD, update)
    rospy.core.add_preshutdown_hook(lambda _reason: update_now())
    return update_now
