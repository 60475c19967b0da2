"""How a node ends: in time, whatever it is doing, and with an exit code that tells why."""

from __future__ import annotations

import atexit
import enum
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import List

import rospy

GRACE = 4.0
"""Wall seconds that a node has to end by itself. Every file is written atomically, so that nothing breaks after it."""
_HARDER_AFTER = 0.5  # s after which the kernel ends a process whose interpreter cannot


class ExitCode(enum.IntEnum):
    """Why a node has ended. A signal that cannot be handled gives minus its number, as everywhere."""

    ENDED = 0  # it has finished, or was asked to end
    UNFORESEEN = 1  # Python's own, for an error without a name; the traceback is on the log
    REFUSED = 2  # an error with a name, the last line on the log: the same would happen again
    MASTER_LOST = 3  # the ROS master was restarted and knows this node no longer
    OVERDUE = 4  # it was asked to end, did not within GRACE, and was ended


class Deadline:
    """Ends this process when it has not ended by itself within GRACE after a signal, or after start was called.

    To be made in the main thread, before anything can hang. A thread learns of SIGINT and SIGTERM as they arrive, also
    while the main thread is deep in a computation and its own handlers have to wait.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        rospy.on_shutdown(self.start)
        threading.Thread(target=self._watch, daemon=True).start()

    def start(self) -> None:
        """Let the time begin; it begins only once."""
        os.write(self._writer, b"\0")

    def _watch(self) -> None:
        awaited = {0, int(signal.SIGINT), int(signal.SIGTERM)}
        while os.read(self._reader, 1)[0] not in awaited:
            pass
        signal.setitimer(signal.ITIMER_REAL, GRACE + _HARDER_AFTER)
        time.sleep(GRACE)
        # Not through the log, whose locks the busy threads may hold.
        name = rospy.get_name() if rospy.core.is_initialized() else self._name
        os.write(2, f"{name} did not end by itself within {GRACE:g} s and is ended now\n".encode())
        for child in children(os.getpid()):
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        os._exit(ExitCode.OVERDUE)


def leave(code: ExitCode) -> None:
    """Exit with everything that was asked for at exit done, but without taking the interpreter apart.

    Threads that still answer a service may be inside a library that would not bear it, and with a few large libraries
    it takes seconds on a busy machine.
    """
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def children(process: int) -> List[int]:
    """The processes that a process, or any thread of it, has started and that still run."""
    found: List[int] = []
    for path in Path(f"/proc/{process}/task").glob("*/children"):
        with suppress(FileNotFoundError, ProcessLookupError):  # of a thread that has ended meanwhile
            found += map(int, path.read_text().split())
    return found
