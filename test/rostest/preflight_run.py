"""Runs the preflight script in its own process."""

import os
import subprocess
import sys
from pathlib import Path

TIMEOUT = 60.0
SCRIPT = (sys.executable, str(Path(__file__).resolve().parents[2] / "scripts" / "preflight"))
ROSRUN = ("rosrun", "embodied_active_learning", "preflight")  # takes a second longer
LEVELS = ("OK", "WARNING", "ERROR")


class PreflightRun:
    """Exit status, output, and level of each check by name."""

    def __init__(self, *arguments, command=SCRIPT, **variables):
        command = [*command, *arguments]
        run = subprocess.run(
            command, env={**os.environ, **variables}, check=False, capture_output=True, text=True, timeout=TIMEOUT
        )
        self.status, self.output = run.returncode, run.stdout + run.stderr
        lines = [line for line in run.stdout.splitlines() if line[:8].strip() in LEVELS]
        self.levels = {line[8:32].strip(): line[:8].strip() for line in lines}

    def names(self, level):
        """Return the names of the checks with a level."""
        return {name for name, found in self.levels.items() if found == level}
