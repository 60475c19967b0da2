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
from embodied_active_learning.ros.runtime.master import connection_error, wait_for_master
from embodied_active_learning.ros.runtime.running_nodes import own_name, require_unused_names
from embodied_active_learning.ros.runtime.shutdown import (
    TIMEOUT,
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
    reads_arm_config: bool = False,
    shutdown_timeout: float = TIMEOUT,
) -> None:
    """Run body(config) as a ROS node, and exit with an ExitCode. `--help` prints the docstring of the node instead.

    Args:
        name: default name of the node.
        body: returns when the node has finished or rospy is shut down.
        needs_clock: with /use_sim_time, wait for a publisher of /clock first.
        always_required: the launch always ends with this node, so it need not report a failure to a FailureWatch.
        failure_ends_run: whether a FailureWatch ends the run if this node fails.
        reads_arm_config: see read_config.
        shutdown_timeout: wall seconds after a signal until the process is ended; roslaunch waits for 15.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):
        sys.stdout.write(f"{getattr(body, '__globals__', {}).get('__doc__') or name}{_HELP}\n")
        sys.exit(ExitCode.SUCCESS)
    deadline = ShutdownDeadline(name, shutdown_timeout)
    try:
        reports_failure = failure_ends_run and not always_required
        code = _run(name, body, needs_clock, always_required, reports_failure, reads_arm_config)
    finally:
        deadline.start()
    exit_process(code)


def _run(
    name: str,
    body: Callable[[Config], None],
    needs_clock: bool,
    always_required: bool,
    reports_failure: bool,
    reads_arm_config: bool,
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
        config = read_config(reads_arm_config)
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
    wait_until(_has_clock, lambda: f"{_clock_topic()}: /use_sim_time is true, but no node publishes it")


def _has_clock() -> bool:
    if rospy.rostime.is_wallclock() or not rospy.get_rostime().is_zero():
        return True
    return any(name == _clock_topic() for name, _ in rospy.get_published_topics())


def _clock_topic() -> str:
    return rospy.resolve_name("/clock")  # remapped in a namespace


def read_config(of_arm: bool = False) -> Config:
    """Return the configuration from the node's own parameter, or else from that of its namespace.

    Args:
        of_arm: prefer the configuration of a real arm that robot.launch has started, while the arm runs.

    Raises:
        ConfigError: no configuration on the parameter server, or an invalid one.
    """
    name = rospy.resolve_name(names.CONFIG_PARAMETER)
    arm = arm_config_values() if of_arm else None
    values = arm or rospy.get_param(f"~{names.CONFIG_PARAMETER}", None) or rospy.get_param(name, None)
    if values is None:
        raise ConfigError(f"parameter {name} is not set: start the node with a launch file of the package")
    return Config.from_dict(values)


def arm_config_values() -> Any:
    """Return the configuration of a real arm that robot.launch has started, while the arm runs; None otherwise."""
    code, _, uri = rospy.get_master().lookupNode(rospy.resolve_name("franka_arm"))
    is_running = code == 1 and not connection_error(uri)
    return rospy.get_param(rospy.resolve_name(names.ARM_CONFIG_PARAMETER), None) if is_running else None


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
