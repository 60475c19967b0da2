"""Workers as processes of this computer, for runs without ROS."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack, contextmanager
from typing import Iterator, List


@contextmanager
def start_workers(count: int, owner: str) -> Iterator[List[subprocess.Popen]]:
    """Start workers for an owner on this computer, and kill them at the end of the block: they have nothing to save.

    Args:
        count: Number of workers.
        owner: "host:port" of the owner.

    Raises:
        OSError: A process could not be started; those before it are killed.
    """
    host = owner.rpartition(":")[0]
    command = [sys.executable, "-m", "embodied_active_learning.distributed.worker", owner, host]
    with ExitStack() as running:
        processes = []
        for _ in range(count):
            processes.append(subprocess.Popen(command))
            running.callback(processes[-1].wait)
            running.callback(processes[-1].kill)
        yield processes
