"""How every node begins and ends, reads its configuration, and waits."""

from __future__ import annotations

import time
from typing import Any, Callable

import rospy

from embodied_active_learning.config import Config
from embodied_active_learning.errors import ConfigError, EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.failure import count_start, report_failure
from embodied_active_learning.ros.runtime.library_log import show_library_log
from embodied_active_learning.ros.runtime.master import MasterWatch, wait_for_master
from embodied_active_learning.ros.runtime.shutdown import Deadline, ExitCode, leave
from embodied_active_learning.ros.runtime.wait_log import awaiting


class ShutdownRequestedError(Exception):
    """The node was asked to end while it was waiting."""


def run_node(
    name: str, body: Callable[[Config], None], needs_clock: bool = False, always_required: bool = False
) -> None:
    """Start the node, hand its configuration to body, and exit with one of ExitCode.

    needs_clock: wait first, where /use_sim_time is set, until somebody publishes /clock. always_required: the launch
    ends with this node in any case; another one that gives up leaves its reason for such a node (see FailureWatch).
    """
    deadline = Deadline(name)
    try:
        code = _run(name, body, needs_clock, always_required)
    finally:
        deadline.start()
    leave(code)


def _run(name: str, body: Callable[[Config], None], needs_clock: bool, always_required: bool) -> ExitCode:
    watch = None
    try:
        master = wait_for_master()
        rospy.init_node(name)
        show_library_log()
        watch = MasterWatch(master)
        count_start()
        if needs_clock:
            wait_for_clock()
        body(read_config())
    except EmbodiedActiveLearningError as error:
        if watch is None or not watch.lost:
            rospy.logfatal("%s", error)
            if not always_required:
                report_failure(str(error))
            rospy.signal_shutdown(str(error))
            return ExitCode.REFUSED
    except ShutdownRequestedError:
        pass
    except rospy.ROSException:
        # Whoever still publishes while a node ends gets one, too.
        if not is_ending():
            raise
    return ExitCode.MASTER_LOST if watch is not None and watch.lost else ExitCode.ENDED


def wait_for_clock() -> None:
    """Where /use_sim_time is set, return once somebody publishes /clock. Raises ShutdownRequestedError."""
    wait_until(_clock_is_there, lambda: "/clock: /use_sim_time is true but nobody publishes it")


def _clock_is_there() -> bool:
    """Whether time passes by a clock that somebody keeps; where it is the computer's own, always."""
    if rospy.rostime.is_wallclock() or not rospy.get_rostime().is_zero():
        return True
    topic = rospy.resolve_name("/clock")
    return any(name == topic for name, _ in rospy.get_published_topics())


def read_config() -> Config:
    """The configuration that the launch file has put on the parameter server: this node's own, or the system's.

    Raises ConfigError.
    """
    name = rospy.resolve_name(names.CONFIG_PARAMETER)
    values = rospy.get_param(f"~{names.CONFIG_PARAMETER}", None) or rospy.get_param(name, None)
    if values is None:
        raise ConfigError(f"parameter {name} is not set: start the node from one of the package's launch files")
    return Config.from_dict(values)


def wait_until(condition: Callable[[], bool], waiting_for: Callable[[], str], period: float = 0.02) -> None:
    """Return as soon as the condition holds; say what is missing after a second, and again every few seconds.

    Waits on wall time, because simulated time stands still while nobody moves the arm. Raises ShutdownRequestedError.
    """
    with awaiting(waiting_for, first_after=1.0):
        while not condition():
            if rospy.is_shutdown():
                raise ShutdownRequestedError
            time.sleep(period)


def pause(seconds: float) -> None:
    """Let wall time pass. Raises ShutdownRequestedError when the node ends meanwhile."""
    ends_at = time.monotonic() + seconds
    wait_until(lambda: time.monotonic() >= ends_at, lambda: f"the next try, every {seconds:g} s")


def publish(publisher: rospy.Publisher, message: Any) -> None:
    """Publish from a callback, which may still be called while the node ends and has closed its topics."""
    try:
        publisher.publish(message)
    except rospy.ROSException:
        if not is_ending():
            raise


def is_ending() -> bool:
    """Whether the node has begun to end: rospy closes its topics before is_shutdown() says so."""
    return rospy.core.is_shutdown_requested()


def try_to_draw(draw: Callable[..., Any], *arguments: Any) -> Any:
    """What a drawing function returns; None, and a warning, when it fails: the results it shows are stored already."""
    try:
        return draw(*arguments)
    except Exception as error:
        rospy.logwarn("the results are stored, but could not be drawn: %r", error)
        return None
