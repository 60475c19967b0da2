"""Life cycle of a node: start, configuration, waiting, shutdown."""

from __future__ import annotations

import logging
import sys
import time
from typing import Any, Callable

import rospy

from embodied_active_learning.config import SIMULATED, Config
from embodied_active_learning.errors import BusyError, ConfigError, EmbodiedActiveLearningError
from embodied_active_learning.ros import names
from embodied_active_learning.ros.runtime.failure import report_failure
from embodied_active_learning.ros.runtime.handshake import install_handshake_timeout
from embodied_active_learning.ros.runtime.master import wait_for_master
from embodied_active_learning.ros.runtime.running_nodes import own_name, require_unused_names
from embodied_active_learning.ros.runtime.shutdown import (
    ExitCode,
    ShutdownDeadline,
    exit_process,
    install_signal_handlers,
)
from embodied_active_learning.ros.runtime.wait_log import log_wait

_HELP = "\n\nStart this node with a launch file of the package: it reads its settings from the parameter server."


class ShutdownRequestedError(Exception):
    """The node was shut down while it was waiting."""


def run_node(
    name: str,
    body: Callable[[Config], None],
    needs_clock: bool = False,
    always_required: bool = False,
    failure_ends_run: bool = True,
) -> None:
    """Run body(config) as a ROS node, and exit with an ExitCode. `--help` prints the docstring of the node instead.

    Args:
        name: default name of the node.
        body: returns when the node has finished or rospy is shut down.
        needs_clock: with /use_sim_time, wait for a publisher of /clock first.
        always_required: the launch always ends with this node, so it need not report a failure to a FailureWatch.
        failure_ends_run: whether a FailureWatch ends the run if this node fails.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):
        sys.stdout.write(f"{getattr(body, '__globals__', {}).get('__doc__') or name}{_HELP}\n")
        sys.exit(ExitCode.SUCCESS)
    deadline = ShutdownDeadline(name)
    try:
        code = _run(name, body, needs_clock, always_required, failure_ends_run and not always_required)
    finally:
        deadline.start()
    exit_process(code)


def _run(
    name: str, body: Callable[[Config], None], needs_clock: bool, always_required: bool, reports_failure: bool
) -> ExitCode:
    wait_for_master()
    try:
        require_unused_names([own_name(name)])
    except BusyError as error:  # not reported as a failure, which would end the other node's run
        sys.stderr.write(f"{name} not started: {error}\n")
        return ExitCode.KNOWN_ERROR
    try:
        install_handshake_timeout()
        install_signal_handlers()
        rospy.init_node(name, disable_signals=True)
        show_library_log()
        if needs_clock:
            wait_for_clock()
        config = read_config()
        if config.arm.robot != SIMULATED:
            names.FRAMES.use_robot(config.franka.arm_id, config.franka.table_height)
        body(config)
        if always_required and not is_shutting_down():
            rospy.loginfo("finished; roslaunch now reports this node in red as a required process that has died")
    except EmbodiedActiveLearningError as error:
        rospy.logfatal("%s", error)
        if reports_failure:
            report_failure(str(error))
        rospy.signal_shutdown(str(error))
        return ExitCode.KNOWN_ERROR
    except ShutdownRequestedError:
        pass
    except rospy.ROSException:
        if not is_shutting_down():  # else: published to a topic that the shutdown has closed
            raise
    return ExitCode.SUCCESS


def show_library_log() -> None:
    """Pass log records of the library, from INFO on, to the handlers of rospy: terminal, log file and /rosout."""
    logger = logging.getLogger("embodied_active_learning")
    logger.handlers = logging.getLogger("rosout").handlers
    logger.propagate = False
    logger.setLevel(logging.INFO)


def wait_for_clock() -> None:
    """With /use_sim_time, return once /clock has a publisher. Raises ShutdownRequestedError."""
    wait_until(_has_clock, lambda: "/clock: /use_sim_time is true, but no node publishes it")


def _has_clock() -> bool:
    if rospy.rostime.is_wallclock() or not rospy.get_rostime().is_zero():
        return True
    topic = rospy.resolve_name("/clock")
    return any(name == topic for name, _ in rospy.get_published_topics())


def read_config() -> Config:
    """Return the configuration from the node's own parameter, or else from that of its namespace.

    Raises:
        ConfigError: no configuration on the parameter server, or an invalid one.
    """
    name = rospy.resolve_name(names.CONFIG_PARAMETER)
    values = rospy.get_param(f"~{names.CONFIG_PARAMETER}", None) or rospy.get_param(name, None)
    if values is None:
        raise ConfigError(f"parameter {name} is not set: start the node with a launch file of the package")
    return Config.from_dict(values)


def wait_until(
    condition: Callable[[], bool],
    waiting_for: Callable[[], str],
    period: float = 0.02,
    check: Callable[[], None] = lambda: None,
) -> None:
    """Return once the condition holds; log what it waits for.

    Polls on wall time, because simulated time stands still between commands. Raises ShutdownRequestedError.

    Args:
        condition: What is waited for.
        waiting_for: Returns its description.
        period: Wall seconds between two checks.
        check: Called while waiting; gives up by raising an error.
    """
    with log_wait(waiting_for, delay=1.0):
        while not condition():
            if rospy.is_shutdown():
                raise ShutdownRequestedError
            check()
            time.sleep(period)


def wall_sleep(seconds: float) -> None:
    """Sleep for a duration of wall time. Raises ShutdownRequestedError."""
    ends_at = time.monotonic() + seconds
    wait_until(lambda: time.monotonic() >= ends_at, lambda: f"the next attempt ({seconds:g} s after the last)")


def publish(publisher: rospy.Publisher, message: Any) -> None:
    """Publish from a callback, which may run while the shutdown has closed the topic already."""
    try:
        publisher.publish(message)
    except rospy.ROSException:
        if not is_shutting_down():
            raise


def is_shutting_down() -> bool:
    """Return whether the shutdown has begun: rospy closes topics before is_shutdown() becomes true."""
    return rospy.core.is_shutdown_requested()


def try_to_draw(draw: Callable[..., Any], *arguments: Any) -> Any:
    """Return draw(*arguments); on any exception log a warning and return None, because results are stored already."""
    try:
        return draw(*arguments)
    except Exception as error:
        rospy.logwarn("figure not drawn: %r; the results are stored nevertheless", error)
        return None
