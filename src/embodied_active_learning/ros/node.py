"""How every node begins and ends, reads its configuration, and says what it is waiting for."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any, Callable

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, EmbodiedActiveLearningError
from embodied_active_learning.ros import names

REPEAT_AFTER = 5.0
"""Wall seconds after which a node says again what it is waiting for."""


class ShutdownRequestedError(Exception):
    """The node was asked to end while it was waiting."""


def run_node(name: str, body: Callable[[Config], None]) -> None:
    """Start the node, hand its configuration to body, and exit 0, or 2 with the named error as the last line."""
    rospy.init_node(name)
    try:
        body(read_config())
    except EmbodiedActiveLearningError as error:
        rospy.logfatal("%s", error)
        rospy.signal_shutdown(str(error))
        sys.exit(2)
    except (ShutdownRequestedError, rospy.ROSInterruptException):
        pass


def read_config() -> Config:
    """The configuration that the launch file has put on the parameter server. Raises ConfigError."""
    name = rospy.resolve_name(names.CONFIG_PARAMETER)
    values = rospy.get_param(name, None)
    if values is None:
        raise ConfigError(f"parameter {name} is not set: start the node from one of the package's launch files")
    return Config.from_dict(values)


def wait_until(condition: Callable[[], bool], waiting_for: Callable[[], str], period: float = 0.02) -> None:
    """Return as soon as the condition holds; say what is missing after a second, and again every few seconds.

    Waits on wall time, because simulated time stands still while nobody moves the arm. Raises ShutdownRequestedError.
    """
    say_at = time.monotonic() + 1.0
    while not condition():
        if rospy.is_shutdown():
            raise ShutdownRequestedError
        if time.monotonic() >= say_at:
            rospy.loginfo("waiting for %s", waiting_for())
            say_at = time.monotonic() + REPEAT_AFTER
        time.sleep(period)


def pause(seconds: float) -> None:
    """Let wall time pass. Raises ShutdownRequestedError when the node ends meanwhile."""
    ends_at = time.monotonic() + seconds
    wait_until(lambda: time.monotonic() >= ends_at, lambda: f"the next try, every {seconds:g} s")


def try_to_draw(draw: Callable[..., Any], *arguments: Any) -> Any:
    """What a drawing function returns; None, and a warning, when it fails: the results it shows are stored already."""
    try:
        return draw(*arguments)
    except Exception as error:
        rospy.logwarn("the results are stored, but could not be drawn: %r", error)
        return None


class Ticker:
    """Calls a function every period of wall time in a thread of its own, until the node ends."""

    def __init__(self, period: float, function: Callable[[], None]) -> None:
        self._period = period
        self._function = function
        self._ended = threading.Event()
        rospy.on_shutdown(self._ended.set)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while not self._ended.wait(self._period):
            self._function()
