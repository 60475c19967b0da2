"""The pre-flight check as a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

TIMEOUT = 60.0
DIRECTLY = (sys.executable, str(Path(__file__).resolve().parents[2] / "scripts" / "preflight"))
AS_A_USER = ("rosrun", "embodied_active_learning", "preflight")  # which takes a second more
LEVELS = ("OK", "WARNING", "MISSING")


class PreflightRun:
    """Its exit status, its findings' levels by what they are about, and all that it said."""

    def __init__(self, *arguments, command=DIRECTLY, **variables):
        command = [*command, *arguments]
        run = subprocess.run(
            command, env={**os.environ, **variables}, check=False, capture_output=True, text=True, timeout=TIMEOUT
        )
        self.status, self.output = run.returncode, run.stdout + run.stderr
        lines = [line for line in run.stdout.splitlines() if line[:8].strip() in LEVELS]
        self.findings = {line[8:32].strip(): line[:8].strip() for line in lines}

    def about(self, level):
        """What the findings of a level are about."""
        return {name for name, found in self.findings.items() if found == level}
