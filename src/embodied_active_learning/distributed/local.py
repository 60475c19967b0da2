"""Workers as processes of this computer, for runs without ROS."""

from __future__ import annotations

import subprocess
import sys
from types import TracebackType
from typing import List, Optional, Type


class LocalWorkers:
    """Starts workers for an owner on this computer; leaving the context ends them."""

    def __init__(self, count: int, owner: str) -> None:
        """Start `count` workers of the owner at "host:port"."""
        host = owner.rpartition(":")[0]
        command = [sys.executable, "-m", "embodied_active_learning.distributed.worker", owner, host]
        self.processes: List[subprocess.Popen] = [subprocess.Popen(command) for _ in range(count)]

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        for process in self.processes:
            process.kill()  # a worker has nothing to save
        for process in self.processes:
            process.wait()
