"""Shutdown of a node within a deadline, and its exit code."""

from __future__ import annotations

import atexit
import enum
import os
import signal
import sys
import threading
import time
from queue import SimpleQueue

import rospy

TIMEOUT = 4.0
"""Wall seconds after a signal until the process is ended. All files are written atomically, so this damages none."""
_KERNEL_DELAY = 0.5
"""Wall seconds after the timeout at which the kernel ends a process whose interpreter is blocked."""
_shutdown_reason: SimpleQueue[str] = SimpleQueue()
_shutdown_thread = threading.Thread(target=lambda: rospy.signal_shutdown(_shutdown_reason.get()), daemon=True)


class ExitCode(enum.IntEnum):
    """Exit codes of the nodes; the kernel adds negative ones for unhandled signals."""

    SUCCESS = 0  # finished, or ended by SIGINT or SIGTERM
    UNEXPECTED_ERROR = 1  # with a traceback in the log
    KNOWN_ERROR = 2  # one of the package's exceptions, whose message is the last line of the log
    SHUTDOWN_TIMEOUT = 3  # did not end in time after a signal


class ShutdownDeadline:
    """Ends this process if it is still running `timeout` seconds after a signal, or after start().

    Create it in the main thread. Its thread is woken by the signal itself, even while the main thread is blocked in a
    computation and cannot run its signal handlers.
    """

    def __init__(self, name: str, timeout: float = TIMEOUT) -> None:
        self._name = name
        self._timeout = timeout
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        rospy.on_shutdown(self.start)
        threading.Thread(target=self._run, daemon=True).start()

    def start(self) -> None:
        """Start the countdown, unless it is running already."""
        os.write(self._writer, b"\0")

    def _run(self) -> None:
        awaited = {0, int(signal.SIGINT), int(signal.SIGTERM)}
        while os.read(self._reader, 1)[0] not in awaited:
            pass
        signal.setitimer(signal.ITIMER_REAL, self._timeout + _KERNEL_DELAY)
        time.sleep(self._timeout)
        # Not logged with rospy: a blocked thread may hold the locks of the log.
        name = rospy.get_name() if rospy.core.is_initialized() else self._name
        os.write(2, f"{name}: shutdown timeout: still running after {self._timeout:g} s; ending the process\n".encode())
        os._exit(ExitCode.SHUTDOWN_TIMEOUT)


def install_signal_handlers() -> None:
    """Shut rospy down in a thread of its own on SIGINT or SIGTERM; to be called in the main thread.

    rospy's handlers call the master in the interrupted main thread, which waits for ever if that thread was calling the
    master itself: all calls share a lock that is not reentrant. So the handler takes no lock: put() is reentrant.
    """
    _shutdown_thread.start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _frame: _shutdown_reason.put(f"signal-{number}"))


def exit_process(code: ExitCode) -> None:
    """Exit after the shutdown and the atexit functions, without finalising the interpreter.

    Finalising takes seconds with large libraries and can crash threads that still run inside one.
    """
    if _shutdown_thread.is_alive():  # else: shut down already, or rospy was not started
        _shutdown_reason.put("finished")
        _shutdown_thread.join()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
