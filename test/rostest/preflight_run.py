"""The pre-flight check, run as a user runs it."""

import os
import subprocess

TIMEOUT = 60.0
LEVELS = ("OK", "WARNING", "MISSING")


class PreflightRun:
    """Its exit status, its findings' levels by what they are about, and all that it said."""

    def __init__(self, *arguments, **variables):
        command = ["rosrun", "embodied_active_learning", "preflight", *arguments]
        run = subprocess.run(
            command, env={**os.environ, **variables}, check=False, capture_output=True, text=True, timeout=TIMEOUT
        )
        self.status, self.output = run.returncode, run.stdout + run.stderr
        lines = [line for line in run.stdout.splitlines() if line[:8].strip() in LEVELS]
        self.findings = {line[8:32].strip(): line[:8].strip() for line in lines}

    def about(self, level):
        """What the findings of a level are about."""
        return {name for name, found in self.findings.items() if found == level}
