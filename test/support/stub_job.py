"""A job of a sweep that only writes its process id; in a module that a worker process can import."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

from embodied_active_learning.pipeline.progress import Progress


@dataclass(frozen=True)
class StubJob:
    """Has the interface of sweep.jobs.Job that the runner uses."""

    path: Path
    run = SimpleNamespace(name="stub")

    @property
    def complete(self) -> bool:
        return self.path.exists()

    def check(self) -> None:
        """Accept everything."""

    def progress(self) -> Progress:
        return Progress(0, 1, 0, 1)

    def __call__(self) -> str:
        self.path.write_text(str(os.getpid()))
        return "completed"
